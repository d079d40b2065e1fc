"""Groups of arrays and numbers as Warp structs, made from the tables of fields: one argument of a kernel for many."""

import ctypes
import itertools
from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels.model.config import CONFIG
from dc_kernels.model.dtypes import FLOATS, PLANS, Block, Plan, aligned_zeros, float_name, numpy_spec, struct_dtype
from dc_kernels.model.fields import CONTACTS, ITERATION, LAUNCH, ROW, SPAN, Field
from dc_kernels.model.groups import GROUPS
from dc_kernels.runtime.building import building
from dc_kernels.runtime.launches import shared_array

# what the narrowphase finds of a contact; the rest is matched with the step before
_FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")
FOUND = {name: CONTACTS[name] for name in _FOUND}


class _Made(NamedTuple):
    struct: Any
    table: Mapping[str, Field]  # kept alive, as its id is the key
    layout: np.dtype | None  # of an element, as NumPy sees it


_made: dict[tuple[str, str, int, bool], _Made] = {}


def struct_type(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of a group: an array for each field of its table, and a number for each without axes.

    Args:
        name: of the group: the struct of "delassus_problem" is a ``DelassusProblem``.
        dtype: "float32" or "float64": what "real" is.
        table: fields by name; each object is a table of its own.
    """
    return _struct(name, dtype, table, False).struct


def element_type(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """The struct of one element of a table's arrays: a number or small vector for each field."""
    return _struct(name, dtype, table, True).struct


@cache
def field_type(field: Field, dtype: str) -> Any:
    """The Warp type of one element of a field."""
    if field.dtype == "iteration":
        return element_type("iteration", dtype, ITERATION)
    scalar, shape = numpy_spec(field, FLOATS[dtype])
    base = wp.dtype_from_numpy(scalar)
    return wp.types.vector(shape[0], base) if shape else base


_types: dict[tuple[int, np.dtype], tuple[Mapping[str, Field], dict[str, Any]]] = {}


def field_types(table: Mapping[str, Field], real: np.dtype) -> Mapping[str, Any]:
    """The Warp types of the elements of all fields of a table, which does not change, by name."""
    key = id(table), real
    if key not in _types:
        # the table is kept, as its id is the key
        _types[key] = table, {name: field_type(field, float_name(real)) for name, field in table.items()}
    return _types[key][1]


def _struct(name: str, dtype: str, table: Mapping[str, Field], element: bool) -> _Made:
    """Look up what is made once, so that all kernels and arrays share one type; threads may ask at once."""
    key = (name, dtype, id(table), element)
    if key not in _made:
        with building():
            if key not in _made:
                _made[key] = _define(name, dtype, table, element)
    return _made[key]


def _define(name: str, dtype: str, table: Mapping[str, Field], element: bool) -> _Made:
    annotations = {field.name: field_type(field, dtype) for field in table.values()}
    if not element:
        axes = {field.name: len(field.axes) for field in table.values()}
        annotations = {n: wp.array(dtype=t, ndim=axes[n]) if axes[n] else t for n, t in annotations.items()}
    label = "".join(part.capitalize() for part in name.split("_"))
    fields = type(label, (), {"__annotations__": annotations, "__module__": __name__})
    # in a module of its own, so that all kernels share it
    struct = wp.struct(fields, module=wp.get_module(f"dc_kernels.groups.{dtype}"))
    if not element:
        return _Made(struct, table, None)
    layout = struct_dtype(table, FLOATS[dtype])
    _check_layout(struct, layout)
    return _Made(struct, table, layout)


def _check_layout(struct: Any, wanted: np.dtype) -> None:
    """Raise RuntimeError where the memory of a struct is not that of the structured NumPy dtype of its fields."""
    found = struct.numpy_dtype()
    offsets = [wanted.fields[name][1] for name in found["names"]]  # type: ignore[index]
    if offsets != found["offsets"] or wanted.itemsize != found["itemsize"]:
        raise RuntimeError(f"Warp lays out {struct.key} as {found}, NumPy as {wanted}: no view can serve both")


@cache
def group_types(dtype: str) -> SimpleNamespace:
    """Types of a scalar's kernels: ``real``, ``vec2``, ``vec4``, the structs of ``GROUPS``, and those of numbers.

    The structs are ``Model``, ``State``, ``Joints``, ``Contacts``, ``Cache``, ``Pairs``, ``Rows``, ``Motion`` and
    ``Stats`` with an array for each field; ``Config``, ``Launch``, ``Contact``, ``Row`` and ``Span`` with numbers; and
    ``Iteration``, of which ``Stats.iteration`` holds one for each world.
    """
    groups = {"config": CONFIG, "launch": LAUNCH, **GROUPS}
    elements = {"contact": FOUND, "row": ROW, "span": SPAN, "iteration": ITERATION}
    types = {name.capitalize(): struct_type(name, dtype, table) for name, table in groups.items()}
    types |= {name.capitalize(): element_type(name, dtype, table) for name, table in elements.items()}
    return SimpleNamespace(**vars(scalar_types(dtype)), **types)


def group(name: str, dtype: str, table: Mapping[str, Field], values: Mapping[str, Any]) -> Any:
    """A struct that holds values by name, which may be set again later; it keeps arrays alive.

    Args:
        name: of the group, see ``struct_type``.
        dtype: "float32" or "float64".
        table: its fields; one that no value is given for is 0 or an array of nothing.
        values: numbers, ``wp.array``, or numpy arrays, which are used where they lie.
    """
    kind = struct_type(name, dtype, table)
    numbers = {key: value for key, value in values.items() if isinstance(value, float | int)}
    attributes = _blank(kind)
    if attributes is None:
        struct = kind()
        for key, value in numbers.items():
            setattr(struct, key, value)
    else:  # as Warp makes and fills it, in a tenth of the time
        struct = object.__new__(kind.instance_type)
        struct.__dict__.update(attributes, _ctype=kind.ctype(**numbers), **numbers)
    for key, value in values.items():
        if key not in numbers:
            setattr(struct, key, _shared(value, table[key]) if isinstance(value, np.ndarray) else value)
    return struct


@cache
def _blank(struct: Any) -> dict[str, Any] | None:
    """The attributes of a struct that holds nothing; None for one with vectors, which are a part of its memory."""
    attributes = {key: value for key, value in vars(struct()).items() if key != "_ctype"}
    return None if any(isinstance(value, ctypes.Array) for value in attributes.values()) else attributes


def _shared(array: np.ndarray, field: Field) -> wp.array:
    """The memory of an array for Warp; its dtype is what it has, so that the struct refuses a wrong one."""
    element, shape = wp.dtype_from_numpy(array.dtype), array.shape
    if array.ndim == len(field.axes):
        return wp.array(array, dtype=element, shape=shape, device="cpu", copy=False)
    element = wp.types.vector(shape[-1], element)
    if array.flags.c_contiguous:
        return wp.array(array, dtype=element, shape=shape[:-1], device="cpu", copy=False)
    shared = wp.array(ptr=array.ctypes.data, dtype=element, shape=shape[:-1], strides=array.strides[:-1], device="cpu")
    shared._kept = array  # given an address, Warp keeps nothing alive
    return shared


class _Template(NamedTuple):
    """A group's struct whose arrays lie nowhere yet."""

    native: bytes  # as kernels take it
    where: slice | np.ndarray  # words of it that hold the addresses, field after field
    struct: Any  # class of it


_templates: dict[tuple[int, Plan], _Template] = {}


def _template(struct: Any, arrays: Any, plan: Plan) -> _Template:
    """The struct of a group with arrays of these sizes: those of equal worlds differ in nothing but addresses."""
    key = id(struct), plan
    template = _templates.get(key)
    if template is None:  # and not looked up again: another thread may have forgotten it meanwhile
        if len(_templates) >= PLANS:
            _templates.clear()
        blank, where = struct(), []
        for field in arrays.table:
            array = getattr(arrays, field).__ctype__()
            setattr(blank.__ctype__(), field, type(array).from_buffer_copy(array))
            getattr(blank.__ctype__(), field).data = 0
            where.append((getattr(struct.ctype, field).offset + type(array).data.offset) // 8)
        kept = type(struct.key, (_Filled, struct.instance_type), {})
        template = _templates[key] = _Template(bytes(blank.__ctype__()), _evenly(where), kept)
    return template


def _evenly(places: list[int]) -> slice | np.ndarray:
    """Places as a slice, where they follow each other evenly: it is written to in a fraction of the time."""
    steps = {second - first for first, second in itertools.pairwise(places)} or {1}
    return slice(places[0], places[-1] + 1, steps.pop()) if places and len(steps) == 1 else np.array(places, np.int64)


class _Filled:
    """A struct of arrays of the CPU's memory, which are made for Warp when Python asks for them; kernels need none."""

    _blocks: dict[str, Block]
    _types: Mapping[str, Any]

    def __getattr__(self, name: str) -> Any:
        block = self.__dict__.get("_blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        made = shared_array(block.array(name), self._types[name], block.address(name))
        return self.__dict__.setdefault(name, made)


def array_group(arrays: Any, name: str) -> Any:
    """The arrays of a ``model.arrays.ArrayGroup`` as kernels take them (see ``group``)."""
    struct = struct_type(name, float_name(arrays.dtype), arrays.table)
    if arrays.device != "cpu":
        made = struct()
        for field in arrays.table:
            setattr(made, field, arrays.array(field))
        return made
    whole, blocks = arrays.whole, arrays.blocks.copy()
    template = _template(struct, arrays, arrays.plan() if whole is None else whole.plan)
    native = struct.ctype.from_buffer_copy(template.native)
    if whole is None:
        addresses = [blocks[field].address(field) if field in blocks else 0 for field in arrays.table]
    else:
        addresses = whole.addresses()
    np.frombuffer(native, np.uint64)[template.where] = addresses
    made = object.__new__(template.struct)
    made.__dict__.update(_ctype=native, _blocks=blocks, _types=field_types(arrays.table, arrays.dtype))
    if len(blocks) < len(arrays.table):
        for field in arrays.table:
            if field not in blocks:
                setattr(made, field, arrays.array(field))
    return made


def element_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[Any, np.ndarray]:
    """An array of one struct of numbers, as kernels write it, and its memory, a structured NumPy array to be kept."""
    struct, _, layout = _struct(name, dtype, table, True)
    memory = aligned_zeros((1,), layout)
    # by its address: given the memory itself, Warp derives the struct's layout anew each time
    return wp.array(ptr=memory.ctypes.data, dtype=struct, shape=(1,), device="cpu"), memory


@cache
def contiguous_groups(dtype: str) -> Any:
    """The function ``contiguous``, to be called on each group at the top of a kernel; it has an overload for each.

    It tells the compiler that the arrays are contiguous; ``ArrayGroup`` makes no others. Warp tells it of arrays that
    are arguments of a kernel themselves, not of those in a struct, whose strides would be loaded and multiplied at each
    access: a broadphase would take a tenth longer.
    """
    for name, table in GROUPS.items():
        struct = struct_type(name, dtype, table)

        @wp.func_native(contiguity(table))
        def contiguous(group: struct): ...

    return contiguous


def contiguity(table: Mapping[str, Field]) -> str:
    """Native code that tells the compiler that elements of the arrays of ``group`` follow each other."""
    last = {field.name: len(field.axes) - 1 for field in table.values() if field.axes}
    assumptions = (f"__builtin_assume(group.{n}.strides[{i}] == sizeof(*group.{n}.data));" for n, i in last.items())
    return "\n".join(["", *assumptions, ""])
