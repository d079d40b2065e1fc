"""Scalar types of the fields of ``model/fields.py``, and memory that is laid out as kernels need it."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
    if isinstance(dtype, str) and dtype in FLOATS:
        return FLOATS[dtype]
    if isinstance(dtype, np.dtype) and dtype in _NAMES:  # numpy takes longer for a name
        return dtype
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


class Plan:
    """Where the zeroed arrays of fields lie: small ones behind each other in one piece of memory, others in their own.

    Attributes:
        shapes: of the arrays, with those of their elements, by name.
        bytes: of all arrays.
        largest: name of the largest one; None where there is none.
    """

    def __init__(self, arrays: Mapping[str, tuple[tuple[int, ...], np.dtype]], alignment: int = 64) -> None:
        """Lay out arrays of these shapes and dtypes, by name, each with its first byte aligned for SIMD loads."""
        size = {name: math.prod(shape) * dtype.itemsize for name, (shape, dtype) in arrays.items()}
        self.shapes = {name: shape for name, (shape, _) in arrays.items()}
        self.bytes = sum(size.values())
        self.largest = max(size, key=size.__getitem__) if size else None
        self._alignment = alignment
        self._empty: tuple[dict[str, np.ndarray], dict[str, int]] | None = None
        self._pieces: list[tuple[int, list[tuple[str, tuple[int, ...], np.dtype, int]]]] = []
        small = [name for name in arrays if size[name] <= SMALL]
        for names in (small, *([name] for name in arrays if size[name] > SMALL)):
            offset, piece = 0, []
            for name in names:
                piece.append((name, *arrays[name], offset))
                offset += size[name] + -size[name] % alignment
            self._pieces.append((offset, piece))

    def zeros(self) -> tuple[Mapping[str, np.ndarray], Mapping[str, int]]:
        """Make the arrays, by name, and the address of each; those of plans without elements are made once."""
        if self.bytes or self._empty is None:
            found = self._zeros()
            if self.bytes:
                return found
            self._empty = found
        return self._empty

    def _zeros(self) -> tuple[dict[str, np.ndarray], dict[str, int]]:
        made, addresses = {}, {}
        for room, piece in self._pieces:
            raw = np.zeros(room + self._alignment, np.uint8)
            address = raw.__array_interface__["data"][0]
            first = -address % self._alignment
            for name, shape, dtype, offset in piece:
                array = np.ndarray(shape, dtype, raw, first + offset)
                made[name] = array.view(np.recarray) if dtype.names else array  # the oracle reads fields as attributes
                addresses[name] = address + first + offset
        return made, addresses


_plans: dict[tuple[Any, ...], Plan] = {}
_axes: dict[tuple[int, tuple[str, ...] | None], tuple[Mapping[str, Field], tuple[str, ...]]] = {}
PLANS = 1024  # that are kept: worlds that are made again and again are laid out once


def plan_of(
    table: Mapping[str, Field], real: np.dtype, sizes: Mapping[str, int], names: tuple[str, ...] | None = None
) -> Plan:
    """How arrays of some fields of a table, which does not change, lie in memory.

    Args:
        table: of the fields.
        real: float32 or float64.
        sizes: elements on each axis.
        names: of the fields; None: all.
    """
    which = id(table), names
    if which not in _axes:
        axes = dict.fromkeys(axis for name in (table if names is None else names) for axis in table[name].axes)
        _axes[which] = table, tuple(axes)  # the table is kept, as its id is the key
    key = (*which, real, *map(sizes.__getitem__, _axes[which][1]))
    if key not in _plans:
        found, arrays = elements(table, real), {}
        for name in table if names is None else names:
            one = found[name]
            arrays[name] = (*(sizes[axis] for axis in one.axes), *one.shape), one.scalar
        if len(_plans) >= PLANS:
            _plans.clear()
        _plans[key] = Plan(arrays)
    return _plans[key]


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype, alignment: int = 64) -> np.ndarray:
    """Zeros whose first byte is aligned for SIMD loads."""
    raw = np.zeros(math.prod(shape) * dtype.itemsize + alignment, np.uint8)
    return np.ndarray(shape, dtype, raw, -raw.__array_interface__["data"][0] % alignment)
