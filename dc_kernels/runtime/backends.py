"""The registry of backends: each has kernels with the names and arguments that host code launches, below its root.

Kernels name their arguments after the arrays they take, so a launch is bound by name and host logic is written once.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dc_kernels.model.settings import WrongType, check_choice, shown
from dc_kernels.runtime.building import building, start_warp
from dc_kernels.runtime.capture import refuse_recording

Launch = Callable[[], None]
_made: dict[tuple[Any, ...], dict[str, Any]] = {}


@dataclass(frozen=True)
class Backend:
    """What host code has to know of a backend beside its kernels."""

    root: str
    """Package of its kernels: their files stand at the paths of the host files that launch them."""
    on_numpy: bool
    """Whether its kernels take numpy arrays, on the CPU; else they take Warp's, on any of its devices."""
    compiled: bool = False
    """Whether its kernels are compiled, which one thread at a time does."""
    own_threads: bool = False
    """Whether a launch shares its work among ``threads`` threads of the backend's own; else the host makes several
    launches on Python's threads."""
    teams: bool = False
    """Whether threads of the host may share the loops of a kernel within one world (``sequences.Teams``)."""


BACKENDS = {
    "warp": Backend("dc_kernels._warp", on_numpy=False, compiled=True, teams=True),
    "numpy": Backend("dc_kernels._numpy", on_numpy=True),
    "taichi": Backend("dc_kernels._taichi", on_numpy=True, compiled=True, own_threads=True),
}


def check_backend(backend: str) -> str:
    """Return the name of a backend.

    Raises:
        ValueError: for an unknown one.
    """
    return backend if type(backend) is str and backend in BACKENDS else check_choice("backend", backend, BACKENDS)


def check_device(device: str, backend: str) -> str:
    """Return the name of a device of a backend.

    Raises:
        TypeError, ValueError: for one that is not there.
    """
    if not isinstance(device, str):
        raise WrongType(f"device is {shown(device)}; it must be a str, 'cpu' or 'cuda:0'")
    if on_numpy(backend) and device != "cpu":
        raise ValueError(f"device is {device!r}; the {backend} backend runs on 'cpu' only")
    if device != "cpu":
        import warp as wp

        start_warp()
        try:
            wp.get_device(device)
        except Exception as error:  # Warp raises different ones from version to version
            found = tuple(str(one) for one in wp.get_devices())
            raise ValueError(f"device is {device!r}; it must be one of {found}") from error
    return device


def on_numpy(backend: str) -> bool:
    """Tell whether the kernels of a backend take numpy arrays.

    Raises:
        ValueError: for an unknown backend.
    """
    return BACKENDS[check_backend(backend)].on_numpy


def host_threads(backend: str, threads: int) -> int:
    """Threads of Python that share the launches of a backend: one, where a launch has threads of its own."""
    return 1 if BACKENDS[check_backend(backend)].own_threads else threads


@functools.cache
def kernel_file(backend: str, path: str) -> Any:
    """The module of kernels of a backend that stands at the host module's relative path, as "grid.splat".

    Raises:
        ValueError: for an unknown backend, or one that has not got these kernels, naming those that have.
    """
    if not has_kernels(backend, path):
        having = tuple(name for name in BACKENDS if has_kernels(name, path))
        raise ValueError(f"backend is {backend!r}, which has no kernels of {path}; it must be one of {having}")
    return importlib.import_module(f"{BACKENDS[backend].root}.{path}")


def has_kernels(backend: str, path: str, factory: str | None = None) -> bool:
    """Whether a backend has a file of kernels (see ``kernel_file``), and in it a function that makes them.

    Raises:
        ValueError: for an unknown backend.
    """
    root = BACKENDS[check_backend(backend)].root
    try:
        found = importlib.util.find_spec(f"{root}.{path}") is not None
    except ModuleNotFoundError as error:  # of the folder
        if not (error.name or "").startswith(root):
            raise
        return False
    return found and (factory is None or hasattr(kernel_file(backend, path), factory))


def kernel_factory(backend: str, path: str, factory: str = "kernels") -> Callable[..., dict[str, Any]]:
    """The function of a file that makes kernels (see ``kernel_file``).

    Raises:
        ValueError: for a backend that has not got it, naming those that have.
    """
    make = getattr(kernel_file(backend, path), factory, None)
    if make is None:
        having = tuple(name for name in BACKENDS if has_kernels(name, path, factory))
        raise ValueError(f"backend is {backend!r}, which has no {factory} of {path}; it must be one of {having}")
    return make


def make_kernels(backend: str, path: str, *options: Any, factory: str = "kernels") -> dict[str, Any]:
    """The kernels of a file by name (see ``kernel_file``); one thread at a time defines those of Warp.

    Args:
        backend: its name.
        path: of the file.
        options: what they are made for, as the factory takes it.
        factory: name of the function that makes them once.

    Raises:
        ValueError: for a backend that has not got them, naming those that have.
    """
    key = (backend, path, factory, *options)
    if key not in _made:
        make = kernel_factory(backend, path, factory)
        with building() if BACKENDS[backend].compiled else contextlib.nullcontext():
            _made[key] = make(*options)
    return _made[key]


def markdown() -> str:
    """Which backend has which kernels, as a table for people: files below their roots, and what makes kernels there."""
    found: dict[tuple[str, str], list[str]] = {}
    for backend, known in BACKENDS.items():
        root = Path(__file__).parents[1] / known.root.rpartition(".")[2]
        for file in sorted(root.rglob("*.py")):
            path = file.relative_to(root).as_posix()
            for factory in re.findall(r"^def (\w*kernels)\(", file.read_text(encoding="utf-8"), re.MULTILINE):
                found.setdefault((path, factory), []).append(backend)
    rows = [f"| file | made by | {' | '.join(BACKENDS)} |", "| --- " * (2 + len(BACKENDS)) + "|"]
    for (path, factory), backends in sorted(found.items()):
        cells = " | ".join("yes" if backend in backends else "" for backend in BACKENDS)
        rows.append(f"| `{path}` | `{factory}` | {cells} |".replace("|  |", "| |").replace("|  |", "| |"))
    return "\n".join(rows)


def argument_names(kernel: Any) -> list[str]:
    """Names of a kernel's arguments in order, without the thread index of the numpy backend."""
    if hasattr(kernel, "adj"):
        return [argument.label for argument in kernel.adj.args]
    if hasattr(kernel, "bind"):
        return list(kernel.arguments)
    return list(inspect.signature(kernel).parameters)[1:]


def bind(kernel: Any, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> Launch:
    """Bind a launch, its arguments taken by name and packed once; calling it costs 1 us on the warp backend.

    In a recording of the calling thread (``capture.recording``) a launch of Warp's becomes part of the graph.

    Args:
        kernel: one of Warp's; or a Python function that is called with the index of each thread first; or an object
            with a method ``bind(dim, values, device)``, whose launch that returns, and the names ``arguments``.
        dim: threads, of one or two dimensions.
        values: arguments by name, and maybe others.
        device: of the arrays.
    """
    if dim == 0:
        return _nothing  # Warp records no launch of nothing
    if hasattr(kernel, "bind"):
        return kernel.bind(dim, values, device)
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
