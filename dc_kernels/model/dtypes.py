"""Scalar types of the fields of ``model/fields.py``, and memory that is laid out as kernels need it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.fields import ITERATION, Field
from dc_kernels.model.settings import shown

FLOATS: dict[str, np.dtype] = {"float32": np.dtype(np.float32), "float64": np.dtype(np.float64)}
SMALL = 2**14  # bytes of an array that shares its memory with others: making each on its own takes longer
_NAMES = {dtype: name for name, dtype in FLOATS.items()}
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


def float_name(dtype: np.dtype) -> str:
    """The name of a dtype of ``FLOATS``, in a hundredth of the time that numpy takes for it."""
    return _NAMES[dtype]


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


class Element(NamedTuple):
    """An element of the array of a field."""

    axes: tuple[str, ...]
    """Axes of the array, without those within an element."""
    scalar: np.dtype
    """Type of its numbers."""
    shape: tuple[int, ...]
    """Shape of an element."""
    width: int
    """Size of an element [B]."""


_elements: dict[tuple[int, np.dtype], tuple[Mapping[str, Field], dict[str, Element]]] = {}


def elements(table: Mapping[str, Field], real: np.dtype) -> Mapping[str, Element]:
    """The elements of all arrays of a table, which does not change, by name; found once for each scalar."""
    key = id(table), real
    if key not in _elements:
        made = {}
        for name, field in table.items():
            scalar, shape = numpy_spec(field, real)
            made[name] = Element(field.axes, scalar, shape, scalar.itemsize * math.prod(shape))
        _elements[key] = table, made  # the table is kept, as its id is the key
    return _elements[key][1]


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype, alignment: int = 64) -> np.ndarray:
    """Zeros whose first byte is aligned for SIMD loads."""
    return _zeros([(shape, dtype, math.prod(shape) * dtype.itemsize)], alignment)[0]


def many_zeros(arrays: Sequence[tuple[tuple[int, ...], np.dtype]], alignment: int = 64) -> list[np.ndarray]:
    """Arrays of the given shapes and dtypes as ``aligned_zeros`` makes them; small ones share one piece of memory."""
    sized = [(shape, dtype, math.prod(shape) * dtype.itemsize) for shape, dtype in arrays]
    small = iter(_zeros([one for one in sized if one[2] <= SMALL], alignment))
    return [next(small) if one[2] <= SMALL else _zeros([one], alignment)[0] for one in sized]


def _zeros(arrays: Sequence[tuple[tuple[int, ...], np.dtype, int]], alignment: int) -> list[np.ndarray]:
    """Zeros of shapes, dtypes and bytes in one piece of memory, the first byte of each aligned."""
    room = sum(size + -size % alignment for _, _, size in arrays)
    raw = np.zeros(room + alignment, np.uint8)
    offset = -raw.__array_interface__["data"][0] % alignment
    made = []
    for shape, dtype, size in arrays:
        made.append(np.ndarray(shape, dtype, raw, offset))
        offset += size + -size % alignment
    return made
