"""The registry of backends: each is a table of kernels with the same names and arguments.

Kernels name their arguments after the arrays they take, so a launch is bound by name and host logic is written once.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from dc_kernels.runtime.building import building
from dc_kernels.runtime.capture import refuse_recording

BACKENDS = ("warp", "numpy")
Launch = Callable[[], None]
_made: dict[tuple[Any, ...], dict[str, Any]] = {}


def check_backend(backend: str) -> str:
    """The name of a backend.

    Raises:
        ValueError: for an unknown one.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend is {backend!r}; it must be one of {BACKENDS}")
    return backend


def kernel_file(backend: str, path: str) -> Any:
    """The module of kernels of a backend that stands at the host module's relative path, as "grid.transfer".

    Raises:
        ValueError: for an unknown backend.
    """
    return importlib.import_module(f"dc_kernels._{check_backend(backend)}.{path}")


def make_kernels(backend: str, path: str, *options: Any, factory: str = "kernels") -> dict[str, Any]:
    """The kernels of a file by name (see ``kernel_file``); one thread at a time defines those of Warp.

    Args:
        backend: "warp" or "numpy".
        path: of the file.
        options: what they are made for, as the factory takes it.
        factory: name of the function that makes them once.
    """
    key = (backend, path, factory, *options)
    if key not in _made:
        make = getattr(kernel_file(backend, path), factory)
        with building() if backend == "warp" else contextlib.nullcontext():
            _made[key] = make(*options)
    return _made[key]


def kernel_table(backend: str, dtype: str, variant: str, only_discs: bool) -> dict[str, Any]:
    """All kernels of a simulation by name.

    Args:
        backend: "warp", or "numpy": the oracle, never fast.
        dtype: "float32" or "float64".
        variant: layout of solver rows, a key of ``rows.COLUMNS``.
        only_discs: whether all that moves are discs about their centre of mass.
    """
    table: dict[str, Any] = {}
    for stage, *options in (
        ("solve.integrate",),
        ("collide.broadphase",),
        ("collide.narrowphase", only_discs),
        ("collide.contacts",),
        ("solve.rows", variant),
        ("solve.schedules", variant),
    ):
        table.update(make_kernels(backend, stage, dtype, *options))
    return table


def argument_names(kernel: Any) -> list[str]:
    """Names of a kernel's arguments in order, without the thread index of the numpy backend."""
    if hasattr(kernel, "adj"):
        return [argument.label for argument in kernel.adj.args]
    return list(inspect.signature(kernel).parameters)[1:]


def bind(kernel: Any, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> Launch:
    """A launch with its arguments taken by name and packed once; calling it costs 1 us on the warp backend.

    In a recording of the calling thread (``capture.recording``) it becomes part of the graph.
    """
    if dim == 0:
        return _nothing  # Warp records no launch of nothing
    if hasattr(kernel, "adj"):
        recorded = command(kernel, dim, values, device)
        if device != "cpu":
            return recorded.launch
        from dc_kernels.runtime.launches import Bound

        return Bound(recorded)
    arguments = [values[name] for name in argument_names(kernel)]

    def run() -> None:
        refuse_recording(kernel.__name__, "the numpy backend runs at once")
        extent = (dim,) if isinstance(dim, int) else dim
        if len(extent) == 1:
            for i in range(extent[0]):
                kernel(i, *arguments)
        else:
            for i in range(extent[0]):
                for j in range(extent[1]):
                    kernel((i, j), *arguments)

    return run


def command(kernel: Any, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> Any:
    """A launch of a Warp kernel as Warp records it (``wp.Launch``), its arguments taken by name."""
    from dc_kernels.runtime.launches import record

    return record(kernel, dim, [values[name] for name in argument_names(kernel)], device)


def _nothing() -> None:
    """A launch over nothing."""
