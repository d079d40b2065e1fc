"""Checks of the arrays that users hand to kernels as they are: nothing is copied, all that is wrong is said."""

from __future__ import annotations

from typing import Any

import numpy as np

from .arrays import check_values


def check_points(points: Any, name: str = "points") -> np.ndarray:
    """Points (n, 2) of float32 or float64, contiguous and finite.

    Raises:
        ValueError: naming the field and the first bad index.
    """
    if not isinstance(points, np.ndarray):
        raise ValueError(f"{name} is a {type(points).__name__}; it must be a numpy array (n, 2)")
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{name} has shape {points.shape}; it must be (n, 2)")
    return check_floats(points, name)


def check_layout(array: Any, name: str, shape: tuple[int, ...] | None = None, dtype: Any = None) -> np.ndarray:
    """A contiguous numpy array of float32 or float64, or of the dtype and shape that are given.

    Raises:
        ValueError: naming the field and what is wrong with it.
    """
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} is a {type(array).__name__}; it must be a numpy array")
    wanted = (np.dtype(np.float32), np.dtype(np.float64)) if dtype is None else (np.dtype(dtype),)
    if array.dtype not in wanted:
        raise ValueError(f"{name} has dtype {array.dtype}; it must be {' or '.join(map(str, wanted))}")
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; it must be {shape}")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} has strides {array.strides}; it must be contiguous")
    return array


def check_floats(array: Any, name: str, shape: tuple[int, ...] | None = None, dtype: Any = None) -> np.ndarray:
    """The same, without NaN or inf.

    Raises:
        ValueError: naming the field and what is wrong with it.
    """
    check_layout(array, name, shape, dtype)
    if not np.isfinite(array.sum()):  # a sum may overflow, so look again; it costs a tenth of looking at each
        check_values(name, array, array.shape, array.dtype)
    return array


def check_start(start: Any, count: int, name: str = "start") -> tuple[np.ndarray, np.ndarray]:
    """First point and number of points of each world, from offsets (W + 1,); None is one world with all of them.

    Raises:
        ValueError: naming the first bad index.
    """
    if count > 2**31 - 1:
        raise ValueError(f"there are {count} points; there may be 2^31 - 1")
    if start is None:
        return np.zeros(1, np.int32), np.full(1, count, np.int32)
    offsets = np.asarray(start)
    if offsets.ndim != 1 or len(offsets) < 1 or offsets.dtype.kind not in "iu":
        raise ValueError(f"{name} has shape {offsets.shape} and dtype {offsets.dtype}; it must be (W + 1,) integers")
    if offsets[0] != 0 or offsets[-1] != count:
        raise ValueError(f"{name} runs from {offsets[0]} to {offsets[-1]}; it must run from 0 to {count}")
    falls = np.flatnonzero(np.diff(offsets) < 0)
    if len(falls):
        i = int(falls[0])
        raise ValueError(f"{name}[{i + 1}] is {offsets[i + 1]}; it must not be below {name}[{i}] = {offsets[i]}")
    return offsets[:-1].astype(np.int32), np.diff(offsets).astype(np.int32)


def check_bins(bins: int, point_bin: Any, count: int) -> np.ndarray:
    """The bin of each point, int32; a dummy where there is one bin.

    Raises:
        ValueError: for bins < 1, another shape, or a bin out of range.
    """
    if not isinstance(bins, int | np.integer) or bins < 1:
        raise ValueError(f"bins is {bins!r}; it must be an integer of at least 1")
    if point_bin is None:
        if bins > 1:
            raise ValueError(f"bins is {bins}, so point_bin must say which one each point belongs to")
        return np.zeros(1, np.int32)
    array = check_values("point_bin", point_bin, (count,), np.dtype(np.int32))
    bad = np.flatnonzero((array < 0) | (array >= bins))
    if len(bad):
        raise ValueError(f"point_bin[{bad[0]}] is {array[bad[0]]}; it must lie in [0, {bins - 1}]")
    return array if bins > 1 else np.zeros(1, np.int32)
