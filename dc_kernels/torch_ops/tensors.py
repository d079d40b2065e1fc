"""Checks of tensors before an operator sees them, whose own errors name no argument."""

from __future__ import annotations

from typing import Any

from dc_kernels.model.settings import WrongType, numeric, shown
from dc_kernels.runtime.optional import require

torch = require("torch", "pipeline")


def check_tensors(**tensors: Any) -> None:
    """Raise an error for what is no tensor, or for tensors that are not all on one device.

    Raises:
        TypeError, ValueError: naming the argument.
    """
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise WrongType(f"{name} is {shown(tensor)}; it must be a torch tensor")
    check_devices(**tensors)


def check_devices(**tensors: Any) -> None:
    """Raise a ValueError, naming the argument, for tensors that are not all on one device."""
    (first, one), *others = tensors.items()
    for name, tensor in others:
        if tensor.device != one.device:
            raise ValueError(f"{name} is on {tensor.device}; it must be on {one.device}, as {first} is")


def given_tensor(name: str, values: Any) -> Any:
    """Return integers of a user, or None, as a tensor; a tensor is returned as it is.

    Raises:
        TypeError: naming the argument.
    """
    if values is None or isinstance(values, torch.Tensor):
        return values
    return torch.from_numpy(numeric(name, values, "integers", "iu").copy())
