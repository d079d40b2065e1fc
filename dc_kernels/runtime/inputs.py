"""Checks of the arrays that users hand to kernels as they are: nothing is copied, and all that is wrong is said."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import FLOATS
from dc_kernels.model.rules import TIME_STEP
from dc_kernels.model.settings import (
    Count,
    Limits,
    NotNegative,
    Positive,
    Whole,
    WrongType,
    checker,
    numeric,
    shown,
    with_article,
)
from dc_kernels.runtime.interop import host_view

check_count = checker(Count)
"""Returns a number of threads or bins, at least 1, or raises an error with the name."""
check_whole = checker(Whole)
"""Returns a number of steps or worlds, at least 0, or raises an error with the name."""
check_positive = checker(Positive)
"""Returns a number > 0, or raises an error with the name."""
check_not_negative = checker(NotNegative)
"""Returns a finite number >= 0, or raises an error with the name."""
check_finite = checker(Annotated[float, Limits()])
"""Returns a finite number, or raises an error with the name."""
check_truth = checker(bool)
"""Returns True or False, or raises an error with the name."""
check_path = checker(Path)
"""Returns a path, or raises an error with the name."""
check_mapping = checker(Mapping)
"""Returns values by name, or raises an error with the name of the argument."""
check_maybe_callable = checker(Callable[..., Any] | None)
"""Returns what can be called, or None, or raises an error with the name."""
check_callable = checker(Callable[..., Any])
"""Returns what can be called, or raises an error with the name."""
MAX_INDEX = 2**31 - 1  # of a point: kernels count in int32


def check_file(name: str, file: Any, method: Literal["read", "write"]) -> Any:
    """Return a path, or a binary file that is open and has the method.

    Raises:
        TypeError: with the name, for anything else, a text file among it.
    """
    if not callable(getattr(file, method, None)):
        return check_path(name, file)
    if isinstance(file, io.TextIOBase):
        raise WrongType(f"{name} is a {type(file).__name__}, a file of text; it must be a binary file, or a path")
    return file


def check_simulation(name: str, sim: Any, parts: Sequence[str] = ("model", "state", "contacts", "phase")) -> None:
    """Raise a TypeError for what lacks attributes that a ``Simulation`` has."""
    if isinstance(sim, type) or not all(hasattr(sim, part) for part in parts):
        raise WrongType(f"{name} is {shown(sim)}; it must be a Simulation")


def check_layout(
    name: str, array: Any, shape: tuple[int | None, ...], dtype: Any = None, *, writes: bool = False
) -> np.ndarray:
    """A contiguous array in the CPU's memory as numpy, whatever it holds.

    Args:
        name: of the argument.
        array: to check: numpy, ``wp.array`` or torch tensor, which are seen as numpy without a copy.
        shape: as it must be, None where any length will do.
        dtype: as it must be; None for float32 or float64.
        writes: whether it will be written to.

    Raises:
        ValueError: naming the argument, and what it is and must be.
    """
    lent, array = array, host_view(name, array)
    if not isinstance(array, np.ndarray) or isinstance(array, np.ma.MaskedArray):  # whose mask would be lost
        raise WrongType(
            f"{name} is {with_article(type(array).__name__)}; it must be a numpy array, wp.array or torch tensor"
        )
    if array.dtype not in FLOATS.values() if dtype is None else array.dtype != dtype:
        raise ValueError(f"{name} has dtype {array.dtype}; it must be {dtype or ' or '.join(FLOATS)}")
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape}; it must be ({wanted}{',' * (len(shape) == 1)})")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} has strides {array.strides} for shape {array.shape}; it must be contiguous")
    if writes and not array.flags.writeable:
        # versions before 1.0 cannot say that memory may be written to, and numpy takes it for read-only
        way = "" if lent is array else f" (by DLPack before 1.0? then give torch.from_dlpack({name}))"
        raise ValueError(f"{name} is read-only{way}; it must be writable")
    return array


def refuse_overlap(written: Mapping[str, np.ndarray], read: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays that are written to while their memory, or a part of it, is also that of another.

    Args:
        written: contiguous arrays by name; the same under two names is one too many.
        read: arrays that are only read, which may be each other's.

    Raises:
        ValueError: naming both.
    """
    spans = [(*_span(array), name, name in written) for group in (written, read) for name, array in group.items()]
    any_end, any_name, written_end, written_name = 0, "", 0, ""
    for low, high, name, writes in sorted(span for span in spans if span[0] < span[1]):
        if low < written_end or (writes and low < any_end):
            one, other = (name, any_name) if writes else (written_name, name)
            raise ValueError(f"{one} shares memory with {other}; it is written to and must have memory of its own")
        if high > any_end:
            any_end, any_name = high, name
        if writes and high > written_end:
            written_end, written_name = high, name


def _span(array: np.ndarray) -> tuple[int, int]:
    """First byte of an array in memory, and one past its last."""
    first = array.__array_interface__["data"][0]
    if not array.size:
        return first, first
    return first, first + array.itemsize + sum((n - 1) * step for n, step in zip(array.shape, array.strides))


def check_array(
    name: str,
    array: Any,
    shape: tuple[int | None, ...],
    dtype: Any = None,
    *,
    low: float | None = None,
    closed: bool = True,
) -> np.ndarray:
    """Return an array that passes ``check_layout`` and holds neither NaN nor inf, nor anything below ``low``.

    ``low`` itself is allowed if ``closed``.

    Raises:
        ValueError: naming the array and, for a bad value, its index.
    """
    array = check_layout(name, array, shape, dtype)
    # a finite sum has finite terms, one that is not may have overflowed; looking at each takes ten times as long
    with np.errstate(over="ignore", invalid="ignore"):
        good = bool(np.isfinite(array.sum()))
    if good and low is not None and array.size:
        least = array.min()
        good = least >= low if closed else least > low
    if not good:
        fine, limit = np.isfinite(array), "finite"
        if low is not None:
            fine &= array >= low if closed else array > low
            limit += f" and {'>=' if closed else '>'} {low:g}"
        bad = np.argwhere(~fine)
        if len(bad):
            index = tuple(int(i) for i in bad[0])
            raise ValueError(f"{name}[{', '.join(map(str, index))}] is {array[index]}; it must be {limit}")
    return array


def _check_finite(name: str, array: np.ndarray) -> None:
    """Raise ValueError, naming the index, for NaN or inf."""
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(array.sum()):
            return
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise ValueError(f"{name}[{', '.join(map(str, index))}] is {array[index]}; it must be finite")


def check_points(name: str, points: Any, dims: tuple[int, ...] = (2,)) -> np.ndarray:
    """Finite points (n, d), d one of ``dims``, of float32 or float64.

    Raises:
        ValueError: naming the argument and the first bad index.
    """
    points = host_view(name, points)
    if isinstance(points, np.ndarray):
        if points.ndim != 2 or points.shape[1] not in dims:
            raise ValueError(f"{name} has shape {points.shape}; it must be {' or '.join(f'(n, {d})' for d in dims)}")
        if len(points) > MAX_INDEX:
            raise ValueError(f"{name} has {len(points)} points; it may have {MAX_INDEX}")
    return check_array(name, points, (None, None))


def check_places(name: str, points: Any) -> np.ndarray:
    """Finite points of a plane, (n, 2), float32 or float64; of points (n, 3) a view that passes over z, whatever it is.

    Raises:
        ValueError: naming the argument and the first bad index.
    """
    points = host_view(name, points)
    if isinstance(points, np.ndarray) and points.ndim == 2 and points.shape[1] == 3:
        points = check_layout(name, points, (None, 3))
        _check_finite(name, points[:, :2])
        if len(points) > MAX_INDEX:
            raise ValueError(f"{name} has {len(points)} points; it may have {MAX_INDEX}")
        return points[:, :2]
    return check_points(name, points)


def check_start(name: str, start: Any, count: int, what: str = "points") -> np.ndarray:
    """Offsets of the worlds' points, (W + 1,) int64; None is one world with all of them.

    Args:
        name: of the argument.
        start: first point of each world, and their number.
        count: number of points.
        what: what is counted, in errors.

    Raises:
        ValueError: naming the first bad index.
    """
    if start is None:
        return np.array([0, count])
    array = numeric(name, start, "(W + 1,) integers", "iu")
    if array.ndim != 1 or len(array) < 1:
        raise ValueError(f"{name} has shape {array.shape}; it must be (W + 1,) integers")
    if array[0] != 0:
        raise ValueError(f"{name}[0] is {array[0]}; it must be 0")
    if array[-1] != count:
        raise ValueError(f"{name}[{len(array) - 1}] is {array[-1]}; it must be the number of {what}, {count}")
    falls = np.flatnonzero(array[1:] < array[:-1])
    if len(falls):
        w = int(falls[0]) + 1
        raise ValueError(f"{name}[{w}] is {array[w]}; it must be at least {name}[{w - 1}], {array[w - 1]}")
    return array.astype(np.int64)


def check_bins(bins: Any, point_bin: Any, count: int) -> np.ndarray:
    """The bin of each point, int32; a dummy where there is one bin.

    Raises:
        ValueError: for bins < 1, another shape, or a bin out of range.
    """
    bins = check_count("bins", bins)
    if point_bin is None:
        if bins > 1:
            raise ValueError(f"bins is {bins}, so point_bin must say which one each point belongs to")
        return np.zeros(1, np.int32)
    array = check_values("point_bin", numeric("point_bin", point_bin, "integers", "iu"), (count,), np.dtype(np.int32))
    bad = np.flatnonzero((array < 0) | (array >= bins))
    if len(bad):
        raise ValueError(f"point_bin[{bad[0]}] is {array[bad[0]]}; it must lie in [0, {bins - 1}]")
    return array if bins > 1 else np.zeros(1, np.int32)


def check_index(name: str, index: np.ndarray, count: int) -> np.ndarray:
    """Indices, if all lie in [0, count - 1].

    Raises:
        ValueError: naming the first that does not.
    """
    bad = np.argwhere((index < 0) | (index >= count))
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        raise ValueError(f"{name}[{', '.join(map(str, at))}] is {index[at]}; it must lie in [0, {count - 1}]")
    return index


def check_worlds(name: str, worlds: Any, count: int) -> np.ndarray | None:
    """Indices of worlds, (k,) int64, of a mask (W,) bool, of indices, or of one; None for None, which means all.

    Raises:
        TypeError, ValueError: naming the first index that is not there, or is there twice.
    """
    if worlds is None:
        return None
    given = numeric(name, host_view(name, worlds), "a mask of bool, or integers", "biu")
    if given.dtype.kind == "b":
        if given.shape != (count,):
            raise ValueError(f"{name} is a mask of shape {given.shape}; it must be ({count},)")
        return np.flatnonzero(given)
    if given.ndim > 1:
        raise ValueError(f"{name} has shape {given.shape}; it must be one index, or (k,)")
    chosen = given.reshape(-1)
    bad = (chosen < 0) | (chosen >= count)
    if not bad.any() and len(chosen) > 1:
        order = np.argsort(chosen, kind="stable")
        bad[order[1:]] = chosen[order[1:]] == chosen[order[:-1]]
    if bad.any():
        i = int(bad.argmax())
        raise ValueError(f"{name}[{i}] is {chosen[i]}; it must lie in [0, {count - 1}] and be there once")
    return chosen.astype(np.int64)


def check_slots(name: str, slots: Any, worlds: int) -> np.ndarray:
    """Slots to reserve for each world, (W,) int64, from one number for all or one for each.

    Raises:
        ValueError: naming the first that is not an integer in [0, 2^31 - 1].
    """
    array = numeric(name, slots, f"an integer or ({worlds},)", "iu")
    if array.shape not in ((), (worlds,)):
        raise ValueError(f"{name} has shape {array.shape}; it must be an integer or ({worlds},)")
    array = np.array(np.broadcast_to(array, (worlds,)), np.int64)
    bad = np.flatnonzero((array < 0) | (array > MAX_INDEX))
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] is {array[bad[0]]}; it must lie in [0, {MAX_INDEX}]")
    return array


def check_time_step(dt: float | np.ndarray, worlds: int, dtype: np.dtype) -> None:
    """Raise ValueError for a time step [s] that is not finite and positive, or underflows a scalar type.

    Args:
        dt: of all worlds, or of each, (W,).
        worlds: how many there are.
        dtype: of the simulation.
    """
    value = numeric("dt", dt, f"a number or have shape {(worlds,)}").astype(np.float64)
    if value.ndim and value.shape != (worlds,):
        raise ValueError(f"dt has shape {value.shape}; it must be a number or have shape {(worlds,)}")
    good = (value > 0.0) & (value < float("inf"))
    if not good.all():
        at = int(good.argmin())
        wrong = f"dt[{at}] is {value[at]}" if value.ndim else f"dt is {shown(dt)}"
        raise ValueError(f"{wrong}; it must be finite and > 0 [s]")
    with np.errstate(over="ignore", under="ignore"):
        narrow = value.astype(dtype)
    if not (narrow.all() and np.isfinite(narrow).all()):
        raise ValueError(f"dt is {shown(dt)}; it does not fit {dtype.name}")
    if not ((value >= TIME_STEP.low) & (value <= TIME_STEP.high)).all():
        raise ValueError(f"dt is {shown(dt)}; it must be {TIME_STEP.limits} s")
