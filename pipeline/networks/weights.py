"""Weights of a network that kernels have a copy of: whether torch has changed them since."""

from __future__ import annotations

from typing import Any


def as_arrays(layer: Any) -> tuple[Any, Any]:
    """Return weights and biases of a layer as arrays on its memory."""
    return layer.weight.detach().numpy(), layer.bias.detach().numpy()


def runs_as_written(model: Any, kind: type, *methods: str) -> bool:
    """Tell whether a module does in some methods what ``kind`` says, and nothing is hooked in before or after.

    Not where a class that is derived, or the object itself, has another of these methods.
    """
    other = any(getattr(type(model), name) is not getattr(kind, name) or name in vars(model) for name in methods)
    hooked = any(part._forward_hooks or part._forward_pre_hooks for part in model.modules())
    return not other and not hooked


class Watch:
    """Tells whether parameters or buffers of a module have changed since it was asked last."""

    def __init__(self, model: Any) -> None:
        """Take them as they are; None: there are none."""
        self._tensors = [] if model is None else [*model.parameters(), *model.buffers()]
        self._versions = self._seen()

    def _seen(self) -> tuple[int, ...]:
        """Return what torch counts the changes of each tensor by."""
        return tuple(tensor._version for tensor in self._tensors)

    def changed(self) -> bool:
        """Tell whether one has changed since the last call."""
        before, self._versions = self._versions, self._seen()
        return before != self._versions
