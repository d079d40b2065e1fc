"""Groups of arrays as Warp structs, made from the tables of fields: kernels take these instead of single arrays."""

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels.model.arrays import FLOATS, ArrayGroup, aligned_zeros, struct_dtype, warp_dtype
from dc_kernels.model.config import CONFIG
from dc_kernels.model.fields import CONTACTS, GROUPS, ITERATION, LAUNCH, ROW, SPAN, Field

# what the narrowphase finds of a contact; the rest is matched with the step before
FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")


_structs: dict[tuple[str, str], Any] = {}


def _struct_of(name: str, dtype: str, annotations: Mapping[str, Any]) -> Any:
    """The one Warp struct of a name and scalar type; it lies in a module of its own, so that all kernels share it."""
    if (name, dtype) not in _structs:
        module = wp.get_module(f"dc_kernels.groups.{dtype}")
        fields = type(name, (), {"__annotations__": dict(annotations), "__module__": __name__})
        _structs[name, dtype] = wp.struct(fields, module=module)
    return _structs[name, dtype]


def _class_name(name: str) -> str:
    """The struct of a group: "delassus_problem" is a ``DelassusProblem``."""
    return "".join(part.capitalize() for part in name.split("_"))


def scalar_struct(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of a table whose fields are numbers and small vectors, as the settings and an iteration in flight."""
    return _struct_of(name, dtype, {field.name: warp_dtype(field, FLOATS[dtype]) for field in table.values()})


def array_struct(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of a table whose fields are arrays."""
    real = FLOATS[dtype]
    types = {
        field.name: iteration_struct(dtype) if field.dtype == "iteration" else warp_dtype(field, real)
        for field in table.values()
    }
    return _struct_of(name, dtype, {n: wp.array(dtype=types[n], ndim=len(field.axes)) for n, field in table.items()})


@cache
def group_types(dtype: str) -> SimpleNamespace:
    """Types of a scalar's kernels: ``real``, ``vec2``, ``vec4``, the structs of ``GROUPS``, and those of scalars.

    The structs are ``Model``, ``State``, ``Joints``, ``Contacts``, ``Cache``, ``Pairs``, ``Rows``, ``Motion`` and
    ``Stats`` with an array for each field; ``Config``, ``Launch``, ``Contact``, ``Row`` and ``Span`` with numbers; and
    ``Iteration``, of which ``Stats.iteration`` holds one for each world.
    """
    contact = {name: CONTACTS[name] for name in FOUND}
    tables = {"Config": CONFIG, "Launch": LAUNCH, "Contact": contact, "Row": ROW, "Span": SPAN}
    types = {name: scalar_struct(name, dtype, table) for name, table in tables.items()}
    types["Iteration"] = iteration_struct(dtype)
    for name, table in GROUPS.items():
        types[_class_name(name)] = array_struct(_class_name(name), dtype, table)
    return SimpleNamespace(**vars(scalar_types(dtype)), **types)


@cache
def iteration_struct(dtype: str) -> Any:
    """The struct of ``ITERATION``."""
    struct = scalar_struct("Iteration", dtype, ITERATION)
    _check_layout(struct, struct_dtype(ITERATION, FLOATS[dtype]))
    return struct


def _check_layout(struct: Any, wanted: np.dtype) -> None:
    """Raise RuntimeError where the memory of a struct is not that of the structured NumPy dtype of its fields."""
    found = struct.numpy_dtype()
    offsets = [wanted.fields[name][1] for name in found["names"]]  # type: ignore[index]
    if offsets != found["offsets"] or wanted.itemsize != found["itemsize"]:
        raise RuntimeError(f"Warp lays out {struct.key} as {found}, NumPy as {wanted}: no view can serve both")


def array_group(group: ArrayGroup, name: str) -> Any:
    """The arrays of a group as kernels take them: one struct; it keeps the arrays alive."""
    struct = array_struct(_class_name(name), group.dtype.name, group.table)()
    for field in group.table:
        setattr(struct, field, group.array(field))
    return struct


def scalars(name: str, dtype: str, values: Mapping[str, Any], table: Mapping[str, Field]) -> Any:
    """Numbers as kernels take them: one struct, whose fields may be set later."""
    struct = scalar_struct(_class_name(name), dtype, table)()
    for key, value in values.items():
        setattr(struct, key, value)
    return struct


def struct_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[Any, np.ndarray]:
    """One struct of numbers in an array, as kernels write it, and its memory, a structured NumPy array to be kept."""
    struct, layout = _checked_struct(name, dtype, tuple(table.items()))
    memory = aligned_zeros((1,), layout)
    # by its address: given the memory itself, Warp derives the struct's layout anew each time
    return wp.array(ptr=memory.ctypes.data, dtype=struct, shape=(1,), device="cpu"), memory


@cache
def _checked_struct(name: str, dtype: str, rows: tuple[tuple[str, Field], ...]) -> tuple[Any, np.dtype]:
    table = dict(rows)
    struct, layout = scalar_struct(_class_name(name), dtype, table), struct_dtype(table, FLOATS[dtype])
    _check_layout(struct, layout)
    return struct, layout


def no_arrays(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """A group without arrays, for kernels that do not touch it."""
    return array_struct(_class_name(name), dtype, table)()


@cache
def contiguous_groups(dtype: str) -> Any:
    """The function ``contiguous``, to be called on each group at the top of a kernel; it has an overload for each.

    It tells the compiler that the arrays are contiguous; ``ArrayGroup`` makes no others. Warp tells it of arrays that
    are arguments of a kernel themselves, not of those in a struct, whose strides would be loaded and multiplied at each
    access: a broadphase would take a tenth longer.
    """
    for name, table in GROUPS.items():
        struct = getattr(group_types(dtype), _class_name(name))

        @wp.func_native(contiguity(table))
        def contiguous(group: struct): ...

    return contiguous


def contiguity(table: Mapping[str, Field]) -> str:
    """Native code that tells the compiler that elements of the arrays of ``group`` follow each other."""
    last = {field.name: len(field.axes) - 1 for field in table.values()}
    assumptions = (f"__builtin_assume(group.{n}.strides[{i}] == sizeof(*group.{n}.data));" for n, i in last.items())
    return "\n".join(["", *assumptions, ""])
