"""Groups of arrays as Warp structs, made from the tables of fields: kernels take these instead of single arrays."""

from functools import cache
from types import SimpleNamespace
from typing import Any

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


def scalar_struct(name: str, dtype: str, table: dict[str, Field]) -> Any:
    """The struct of a table whose fields are numbers and small vectors, as the settings and an iteration in flight."""
    return struct_of(name, dtype, {field.name: warp_dtype(field, FLOATS[dtype]) for field in table.values()})


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
        annotations = {
            field.name: wp.array(dtype=warp_dtype(field, FLOATS[dtype]), ndim=len(field.axes))
            for field in table.values()
        }
        types[name.capitalize()] = struct_of(name.capitalize(), dtype, annotations)
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
    struct = getattr(group_types(group.dtype.name), name.capitalize())()
    for field in group.table:
        setattr(struct, field, group.array(field))
    return struct


def scalars(name: str, dtype: str, values: dict[str, Any]) -> Any:
    """Numbers as one struct, "config" or "launch"."""
    struct = getattr(group_types(dtype), name.capitalize())()
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
