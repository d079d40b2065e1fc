"""The registry of backends: each is a table of kernels with the same names and arguments.

Kernels name their arguments after the arrays they take, so a launch is bound by name and host logic is written once.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import itertools
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

BACKENDS = ("warp", "numpy")
Launch = Callable[[], None]
_capturing = threading.Lock()


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
        table.update(kernel_file(backend, stage).kernels(dtype, *options))
    return table


def argument_names(kernel: Any) -> list[str]:
    """Names of a kernel's arguments in order, without the thread index of the numpy backend."""
    if hasattr(kernel, "adj"):
        return [argument.label for argument in kernel.adj.args]
    return list(inspect.signature(kernel).parameters)[1:]


def bind(kernel: Any, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> Launch:
    """A launch with its arguments taken by name and packed once; calling it costs 2-3 us on the warp backend."""
    if dim == 0:
        return lambda: None  # Warp records no launch of nothing
    if hasattr(kernel, "adj"):
        return command(kernel, dim, values, device).launch
    arguments = [values[name] for name in argument_names(kernel)]

    def run() -> None:
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
    """A recorded launch of a Warp kernel, of which arguments can be changed."""
    import warp as wp

    arguments = [values[name] for name in argument_names(kernel)]
    return wp.launch(kernel, dim=dim, inputs=arguments, device=device, record_cmd=True)


def in_turn(launches: list[Launch]) -> Launch:
    """One call that makes several."""

    def run() -> None:
        for launch in launches:
            launch()

    return run


def recorded(launches: list[Launch], backend: str, device: str = "cpu") -> Launch:
    """Launches as one call; those of Warp on a CPU as a graph: 2 us for one of 20 arguments, by itself 7."""
    if backend != "warp" or device != "cpu":
        return in_turn(launches)
    import warp as wp

    # Warp has one capture at a time, whichever thread began it
    with _capturing, wp.ScopedCapture(device="cpu") as capture:
        for launch in launches:
            launch()
    return functools.partial(wp.capture_launch, capture.graph)


@functools.cache
def thread_pool(threads: int) -> ThreadPoolExecutor:
    """The pool of so many threads that calls without a simulation of their own share."""
    return ThreadPoolExecutor(threads)


def run_shards(launches: Sequence[Launch], threads: int) -> None:
    """Run launches that write disjoint memory, on a pool of threads if there are several of both."""
    if threads == 1 or len(launches) < 2:
        in_turn(list(launches))()
    else:
        list(thread_pool(threads).map(lambda launch: launch(), launches))


def shard_worlds(worlds: int, threads: int) -> list[tuple[int, int]]:
    """First world and number of worlds of each thread's share."""
    edges = np.linspace(0, worlds, min(max(threads, 1), max(worlds, 1)) + 1).astype(int)
    return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]
