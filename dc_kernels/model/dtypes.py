"""Scalar types of the fields of ``model/fields.py``, and memory that is laid out as kernels need it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.fields import ITERATION, Field
from dc_kernels.model.settings import shown

FLOATS: dict[str, np.dtype] = {"float32": np.dtype(np.float32), "float64": np.dtype(np.float64)}
_COMPONENTS = {"vec2": 2, "vec2d": 2, "vec3": 3, "vec3i": 3, "vec4": 4, "vec8": 8}


def float_dtype(dtype: Any) -> np.dtype:
    """float32 or float64 as a numpy dtype.

    Raises:
        ValueError: for any other dtype.
    """
    try:
        name = None if dtype is None else np.dtype(dtype).name  # None would be float64
    except (TypeError, ValueError, SyntaxError):  # what numpy knows no dtype of
        name = None
    if name not in FLOATS:
        raise ValueError(f"dtype is {shown(dtype) if name is None else repr(name)}; it must be one of {tuple(FLOATS)}")
    return FLOATS[name]


def numpy_spec(field: Field, real: np.dtype) -> tuple[np.dtype, tuple[int, ...]]:
    """Scalar dtype and trailing shape of a field: ("vec2", float32) -> (float32, (2,))."""
    if field.dtype == "iteration":
        return struct_dtype(ITERATION, real), ()
    components = _COMPONENTS.get(field.dtype)
    shape = () if components is None else (components,)
    if field.dtype == "vec2d":
        return np.dtype(np.float64), shape
    if field.dtype == "vec3i":
        return np.dtype(np.int32), shape
    if components is not None or field.dtype == "real":
        return real, shape
    return np.dtype(field.dtype), shape


def struct_dtype(table: Mapping[str, Field], real: np.dtype) -> np.dtype:
    """The structured dtype of a table whose fields are numbers and small vectors, laid out as C does."""
    return np.dtype([(name, *numpy_spec(field, real)) for name, field in table.items()], align=True)


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype, alignment: int = 64) -> np.ndarray:
    """Zeros whose first byte is aligned for SIMD loads."""
    count = math.prod(shape)
    raw = np.zeros(count * dtype.itemsize + alignment, np.uint8)
    offset = -raw.__array_interface__["data"][0] % alignment  # raw.ctypes.data takes ten times as long
    return raw[offset : offset + count * dtype.itemsize].view(dtype).reshape(shape)
