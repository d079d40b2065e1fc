"""Groups of arrays as Warp structs, made from the tables of fields: kernels take these instead of single arrays."""

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels.model.arrays import FLOATS, ArrayGroup, numpy_spec, warp_dtype
from dc_kernels.model.config import CONFIG
from dc_kernels.model.fields import CONTACTS, GROUPS, ITERATION, LAUNCH, ROW, SPAN, Field

# what the narrowphase finds of a contact; the rest is matched with the step before
FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")


def struct_of(name: str, dtype: str, annotations: dict[str, Any]) -> Any:
    """A Warp struct with the given fields; it lies in a module of its own, so that all kernels share one type."""
    module = wp.get_module(f"dc_kernels.groups.{dtype}")
    return wp.struct(type(name, (), {"__annotations__": annotations, "__module__": __name__}), module=module)


_structs: dict[tuple[str, str], Any] = {}


def scalar_struct(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of a table whose fields are numbers and small vectors, as the settings and an iteration in flight.

    It is made once for a name, which no other table may have.
    """
    if (name, dtype) not in _structs:
        annotations = {field.name: warp_dtype(field, FLOATS[dtype]) for field in table.values()}
        _structs[name, dtype] = struct_of(name, dtype, annotations)
    return _structs[name, dtype]


def array_struct(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of a table with an array for each field; made once for a name, which no other table may have."""
    if (name, dtype) not in _structs:
        annotations = {
            field.name: wp.array(dtype=warp_dtype(field, FLOATS[dtype]), ndim=len(field.axes))
            for field in table.values()
        }
        _structs[name, dtype] = struct_of(name, dtype, annotations)
    return _structs[name, dtype]


def struct_name(name: str) -> str:
    """The name of the struct of an argument: "delassus_problem" -> "DelassusProblem"."""
    return name.title().replace("_", "")


@cache
def group_types(dtype: str) -> SimpleNamespace:
    """Types of a scalar's kernels: ``real``, ``vec2``, ``vec4``, the structs of ``GROUPS``, and those of scalars.

    The structs are ``Model``, ``State``, ``Joints``, ``Contacts``, ``Cache``, ``Pairs``, ``Rows``, ``Motion`` and
    ``Stats`` with an array for each field; ``Config``, ``Launch``, ``Contact``, ``Row`` and ``Span`` with numbers; and
    ``Iteration``, of which ``Stats.iteration`` holds one for each world.
    """
    tables = {"Config": CONFIG, "Launch": LAUNCH, "Row": ROW, "Span": SPAN}
    types = {name: scalar_struct(name, dtype, table) for name, table in tables.items()}
    types["Iteration"] = iteration_struct(dtype)
    types["Contact"] = scalar_struct("Contact", dtype, {name: CONTACTS[name] for name in FOUND})
    for name, table in GROUPS.items():
        types[name.capitalize()] = array_struct(name.capitalize(), dtype, table)
    return SimpleNamespace(**vars(scalar_types(dtype)), **types)


@cache
def iteration_struct(dtype: str) -> Any:
    """The struct of ``ITERATION``; its memory is that of the structured NumPy dtype of the same fields."""
    struct = scalar_struct("Iteration", dtype, ITERATION)
    wanted, _ = numpy_spec(Field("iteration", "world", "iteration", "", ""), FLOATS[dtype])
    found = struct.numpy_dtype()
    if [wanted.fields[name][1] for name in found["names"]] != found["offsets"] or wanted.itemsize != found["itemsize"]:
        raise RuntimeError(f"Warp lays out Iteration as {found}, NumPy as {wanted}: no view can serve both")
    return struct


def array_group(group: ArrayGroup, name: str) -> Any:
    """The arrays of a group as kernels take them: one struct; it keeps the arrays alive."""
    struct = array_struct(struct_name(name), group.dtype.name, group.table)()
    for field in group.table:
        setattr(struct, field, group.array(field))
    return struct


def scalars(name: str, dtype: str, values: Mapping[str, Any], table: Mapping[str, Field] | None = None) -> Any:
    """Numbers as one struct: "config", "launch", or that of a table."""
    if table is None:
        struct = getattr(group_types(dtype), name.capitalize())()
    else:
        struct = scalar_struct(struct_name(name), dtype, table)()
    for key, value in values.items():
        setattr(struct, key, value)
    return struct


@cache
def contiguous_groups(dtype: str) -> Any:
    """The function ``contiguous``, to be called on each group at the top of a kernel; it has an overload for each.

    It tells the compiler that the arrays are contiguous; ``ArrayGroup`` makes no others. Warp tells it of arrays that
    are arguments of a kernel themselves, not of those in a struct, whose strides would be loaded and multiplied at each
    access: a broadphase would take a tenth longer.
    """
    for name, table in GROUPS.items():
        struct = getattr(group_types(dtype), name.capitalize())
        known = [field.name for field in table.values() if len(field.axes) == 1]
        assumptions = [f"__builtin_assume(group.{name}.strides[0] == sizeof(*group.{name}.data));" for name in known]

        @wp.func_native("\n".join(["", *assumptions, ""]))
        def contiguous(group: struct): ...

    return contiguous


def struct_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[Any, np.ndarray]:
    """One struct of numbers in an array, as kernels write it, and its memory, a structured NumPy array to be kept."""
    struct = scalar_struct(struct_name(name), dtype, table)
    memory = np.zeros(1, memory_dtype(struct))
    # by its address: given the memory itself, Warp derives the struct's layout anew each time
    return wp.array(ptr=memory.ctypes.data, dtype=struct, shape=(1,), device="cpu"), memory


@cache
def memory_dtype(struct: Any) -> np.dtype:
    """The structured NumPy dtype of a struct's memory."""
    return np.dtype(struct.numpy_dtype())


def no_arrays(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """A group without arrays, for kernels that don't touch it."""
    return array_struct(struct_name(name), dtype, table)()
