"""Groups of arrays and numbers for kernels: types that name their tables, and objects with an attribute for each field.

A kernel's argument ``model: t.Model`` stands for as many arguments of what Taichi compiles as it has fields that the
kernel uses.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_kernels._taichi.common import integer_types, scalar_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.config import CONFIG
from dc_kernels.model.dtypes import FLOATS, aligned_zeros, numpy_spec, struct_dtype
from dc_kernels.model.fields import CONTACTS, ITERATION, LAUNCH, ROW, SPAN, Field, field_table
from dc_kernels.model.groups import GROUPS

# what the narrowphase finds of a contact; the rest is matched with the step before
_FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")
FOUND = {name: CONTACTS[name] for name in _FOUND}
LANED = {"rows": ("column", "body", "impulse", "change", "before", "direction", "past")}
"""Fields that kernels see as vectors of ``LANES`` numbers, rows being solved in SIMD lanes; by the group's name."""
LANES = 8
WIDE = {"points": ("place",)}
"""Vectors that may be the first numbers of longer rows, and lie at any address: one more axis; by the group's name."""
SHARED = {("rows", "row_impulse"): ("joints", "joint_impulse"), ("rows", "row_color"): ("joints", "joint_color")}
"""Fields that may be the very memory of another, which a kernel then must see by one name, the latter."""
LAUNCHES = LAUNCH | field_table(("cut", "cut word", "int32", "1", "what ``runtime.signals`` names the words of"))
"""Numbers of a launch, and the memory that ends its sweeping."""
VECTORS = (2, 4, 8)  # lengths of vectors that lie in memory as Taichi loads them; others are one more axis


class GroupType(ti.template):
    """Annotation of an argument that is a group of arrays and numbers."""

    def __init__(self, name: str, dtype: str, table: Mapping[str, Field], constants: tuple[str, ...] = ()) -> None:
        """``name``: of the group; ``dtype``: what "real" is; ``table``: its fields; ``constants``: compiled in."""
        super().__init__()
        self.name, self.dtype, self.table, self.constants = name, dtype, table, constants

    def annotation(self, field: str) -> Any:
        """Taichi's type of a field: of an array, or of a number or small vector that a launch is given."""
        return field_type(self.name, self.table[field], self.dtype)


@cache
def _group_type(name: str, dtype: str, table: int, constants: tuple[str, ...]) -> GroupType:
    return GroupType(name, dtype, _tables[table], constants)


_tables: dict[int, Mapping[str, Field]] = {}


def struct_type(name: str, dtype: str, table: Mapping[str, Field], constants: tuple[str, ...] = ()) -> GroupType:
    """The type of a group: an array for each field of its table, and a number for each without axes.

    Args:
        name: of the group.
        dtype: "float32" or "float64": what "real" is.
        table: fields by name; each object is a table of its own.
        constants: numbers among them that are compiled in, for ``ti.static`` to look at: a kernel for each value.
    """
    _tables[id(table)] = table
    return _group_type(name, dtype, id(table), constants)


@cache
def element_type(dtype: str, name: str) -> Any:
    """The struct of numbers of one contact, row, span or iteration: a number or small vector for each field."""
    table = {"contact": FOUND, "row": ROW, "span": SPAN, "iteration": ITERATION}[name]
    return ti.types.struct(**{field.name: _element(field, dtype) for field in table.values()})


def _element(field: Field, dtype: str) -> Any:
    """Taichi's type of one element of a field."""
    scalar, shape = numpy_spec(field, FLOATS[dtype])
    kind = {"float32": ti.f32, "float64": ti.f64, **integer_types()}[scalar.name]
    return ti.types.vector(shape[0], kind) if shape else kind


@cache
def field_type(group: str, field: Field, dtype: str) -> Any:
    """Taichi's type of a field of a group.

    A vector of another length than ``VECTORS``, or of ``WIDE``, is one more axis; a struct of numbers is seen as words
    of four bytes.
    """
    if field.dtype == "iteration":
        return ti.types.ndarray(dtype=ti.i32, ndim=2)
    element, axes = _element(field, dtype), len(field.axes)
    if not axes:
        return element
    if field.name in LANED.get(group, ()):
        return ti.types.ndarray(dtype=ti.types.vector(LANES, element), ndim=1)
    if hasattr(element, "get_shape") and (element.get_shape()[0] not in VECTORS or field.name in WIDE.get(group, ())):
        return ti.types.ndarray(dtype=element.dtype, ndim=axes + 1)
    return ti.types.ndarray(dtype=element, ndim=axes)


def seen(group: str, field: Field, array: np.ndarray) -> np.ndarray:
    """The memory of a field's array in the shape of ``field_type``."""
    if field.name in LANED.get(group, ()):
        return array[: len(array) // LANES * LANES].reshape(-1, LANES)
    if field.name in WIDE.get(group, ()) and array.strides == (3 * array.itemsize, array.itemsize):
        return np.lib.stride_tricks.as_strided(array, (len(array), 3), writeable=array.flags.writeable)
    if array.dtype.names:
        return array.view(np.ndarray).view(np.int32).reshape(len(array), -1)
    return array


@cache
def group_types(dtype: str) -> SimpleNamespace:
    """Types of a scalar's kernels: ``real``, ``vec2``, ``vec4``, those of the groups, and structs of numbers.

    The groups are ``Model``, ``State``, ``Joints``, ``Contacts``, ``Cache``, ``Pairs``, ``Rows``, ``Motion`` and
    ``Stats`` with an array for each field, and ``Config`` and ``Launch`` with numbers and the array ``launch.cut``; the
    structs ``Contact``, ``Row``, ``Span`` and ``Iteration``.
    """
    groups = {"config": CONFIG, "launch": LAUNCHES, **GROUPS}
    types = {name.capitalize(): struct_type(name, dtype, table) for name, table in groups.items()}
    types |= {name.capitalize(): element_type(dtype, name) for name in ("contact", "row", "span", "iteration")}
    return SimpleNamespace(**vars(scalar_types(dtype)), **types)


def group(name: str, dtype: str, table: Mapping[str, Field], values: Mapping[str, Any]) -> SimpleNamespace:
    """An object that holds values by name, which may be set again before a launch is bound; it keeps arrays alive.

    Args:
        name: of the group.
        dtype: "float32" or "float64".
        table: its fields; one that no value is given for is 0 or an array of nothing.
        values: numbers, and arrays of any kind on the CPU, which are used where they lie.
    """
    made = SimpleNamespace(**values)
    for key, field in table.items():
        if key not in values:
            scalar, inner = numpy_spec(field, FLOATS[dtype])
            setattr(made, key, aligned_zeros((*(0 for _ in field.axes), *inner), scalar) if field.axes else 0)
    return made


def array_group(arrays: Any, name: str) -> Any:
    """The arrays of a ``model.arrays.ArrayGroup`` as kernels take them: that itself."""
    return arrays


def element_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[np.ndarray, np.ndarray]:
    """An array of one struct of numbers, as kernels take it, and as NumPy sees it: the same."""
    values = aligned_zeros((1,), struct_dtype(table, FLOATS[dtype]))
    return values, values
