"""Scalar types of the fields of ``model/fields.py``, and memory that is laid out as kernels need it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.fields import ITERATION, Field
from dc_kernels.model.settings import shown

FLOATS: dict[str, np.dtype] = {"float32": np.dtype(np.float32), "float64": np.dtype(np.float64)}
ALIGNMENT = 64  # bytes: that of the widest SIMD loads
SMALL = 2**14  # bytes of an array that shares its memory with others: making each on its own takes longer
HUGE = 2**22  # bytes of arrays that share it too, as NumPy asks Linux for pages of 2 MB from there on
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

    Where they are large together, all lie in one piece: a processor finds its large pages at once, while the pages of
    some hundred arrays that a step goes through side by side are more than it remembers.

    Attributes:
        shapes: of the arrays, with those of their elements, by name.
        bytes: of all arrays.
        largest: name of the largest one; None where there is none.
        pieces: size of each piece, with what aligns the arrays in it [B].
        places: number of its piece, shape, dtype and first byte within the piece, of each array by name.
    """

    def __init__(self, arrays: Mapping[str, tuple[tuple[int, ...], np.dtype]]) -> None:
        """Lay out arrays of these shapes and dtypes, by name, each with its first byte aligned for SIMD loads."""
        size = {name: math.prod(shape) * dtype.itemsize for name, (shape, dtype) in arrays.items()}
        self.shapes = {name: shape for name, (shape, _) in arrays.items()}
        self.bytes = sum(size.values())
        self.largest = max(size, key=size.__getitem__) if size else None
        self.pieces: list[int] = []
        places = {}
        limit = SMALL if self.bytes < HUGE else self.bytes
        small = [name for name in arrays if size[name] <= limit]
        for names in (small, *([name] for name in arrays if size[name] > limit)):
            offset = 0
            for name in names:
                places[name] = len(self.pieces), *arrays[name], offset
                offset += size[name] + -size[name] % ALIGNMENT
            self.pieces.append(offset)
        self.places = {name: places[name] for name in arrays}
        self._piece = np.array([piece for piece, *_ in self.places.values()], np.int64)
        self._offset = np.array([offset for *_, offset in self.places.values()], np.uint64)
        self._empty: Block | None = None

    def zeros(self) -> Block:
        """Make the arrays; those of a plan without elements are made once."""
        if self.bytes:
            return Block(self)
        if self._empty is None:
            self._empty = Block(self)
        return self._empty

    def addresses(self, first: list[int]) -> np.ndarray:
        """The address of each array, (n,) uint64, from that of each piece."""
        if len(first) == 1:
            return self._offset + np.uint64(first[0])
        return np.array(first, np.uint64)[self._piece] + self._offset


class Block:
    """The memory of the arrays of a plan, zeroed at first; NumPy sees each from when it is first asked for.

    Attributes:
        plan: how the arrays lie.
        seen: what was asked for by name.
    """

    def __init__(self, plan: Plan) -> None:
        """Allocate."""
        self.plan = plan
        self.seen: dict[str, np.ndarray] = {}
        self._raw = [np.zeros(size + ALIGNMENT, np.uint8) for size in plan.pieces]
        lie = [raw.__array_interface__["data"][0] for raw in self._raw]
        self._skipped = [-address % ALIGNMENT for address in lie]
        self._first = [address + skipped for address, skipped in zip(lie, self._skipped)]

    def array(self, name: str) -> np.ndarray:
        """An array; it is the same one for all threads that ask at once."""
        found = self.seen.get(name)
        if found is not None:
            return found
        piece, shape, dtype, offset = self.plan.places[name]
        made = np.ndarray(shape, dtype, self._raw[piece], self._skipped[piece] + offset)
        # the oracle reads fields of elements as attributes
        return self.seen.setdefault(name, made.view(np.recarray) if dtype.names else made)

    def address(self, name: str) -> int:
        """Where an array lies."""
        piece, _, _, offset = self.plan.places[name]
        return self._first[piece] + offset

    def addresses(self) -> np.ndarray:
        """Where the arrays lie, in the order of the plan, (n,) uint64."""
        return self.plan.addresses(self._first)

    def content(self) -> tuple[bytes, ...]:
        """What all arrays hold."""
        return tuple([piece.tobytes() for piece in self._pieces()])

    def take(self, other: Block) -> None:
        """Take over what a block of an equal plan holds."""
        for piece, source in zip(self._pieces(), other._pieces(), strict=True):
            piece[:] = source

    def put(self, content: tuple[bytes, ...]) -> None:
        """Take over what ``content`` of a block of an equal plan told."""
        for piece, values in zip(self._pieces(), content, strict=True):
            piece[:] = np.frombuffer(values, np.uint8)

    def _pieces(self) -> list[np.ndarray]:
        """The bytes of each piece."""
        return [raw[first : first + n] for raw, first, n in zip(self._raw, self._skipped, self.plan.pieces)]


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
    plan = _plans.get(key)
    if plan is None:  # and not looked up again: another thread may have forgotten it meanwhile
        found, arrays = elements(table, real), {}
        for name in table if names is None else names:
            one = found[name]
            arrays[name] = (*(sizes[axis] for axis in one.axes), *one.shape), one.scalar
        if len(_plans) >= PLANS:
            _plans.clear()
        plan = _plans[key] = Plan(arrays)
    return plan


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Zeros whose first byte is aligned for SIMD loads."""
    raw = np.zeros(math.prod(shape) * dtype.itemsize + ALIGNMENT, np.uint8)
    return np.ndarray(shape, dtype, raw, -raw.__array_interface__["data"][0] % ALIGNMENT)
