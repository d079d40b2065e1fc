"""Allocation of the arrays of ``model/fields.py``, their containers, and zero-copy views.

One buffer serves every user: on the CPU an array is allocated once, 64-byte aligned, and seen as
``wp.array``, ``numpy.ndarray`` or ``torch.Tensor`` without a copy.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeVar
from weakref import WeakSet

import numpy as np

from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import Block, Plan, elements, float_dtype, float_name, plan_of
from dc_kernels.model.fields import CONTACTS, MODEL, ROLLING, STATE, TRAITS, Field
from dc_kernels.model.rules import Number, Unit
from dc_kernels.model.settings import UnknownName, WrongType, counted, shown
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.model.worlds import Segments, WorldViews, by_world, locked
from dc_kernels.runtime.backends import kernel_file, on_numpy
from dc_kernels.runtime.building import start_warp
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.memory import LARGE, check_memory

if TYPE_CHECKING:
    from typing_extensions import Self

Group = TypeVar("Group", bound="ArrayGroup")


def to_numpy(array: Any) -> np.ndarray:
    """Return a numpy array: the same memory on the CPU, a copy from a GPU; what is no array gives a TypeError."""
    return array if isinstance(array, np.ndarray) else _array(array).numpy()


def to_torch(array: Any) -> Any:
    """Return a torch tensor on the same memory (any device).

    Raises:
        ImportError: naming the extra, without torch.
        TypeError: it is no array.
    """
    torch = require("torch", "pipeline")
    if isinstance(array, np.ndarray):
        return torch.from_numpy(array)
    import warp as wp

    return wp.to_torch(_array(array), requires_grad=False)


def _array(array: Any) -> Any:
    """Return an array; a simulation or a group has arrays, and is none."""
    if not (hasattr(array, "shape") and hasattr(array, "numpy")):
        raise WrongType(f"array is {shown(array)}; it must be an array of Warp or NumPy, such as a field of sim.state")
    return array


def kernel_array(array: np.ndarray, backend: str) -> Any:
    """Return an array of the same memory as an argument of a backend's kernels."""
    if on_numpy(backend):
        return array
    import warp as wp

    start_warp()
    return wp.array(array, dtype=wp.dtype_from_numpy(array.dtype), device="cpu", copy=False)


def kernel_arrays(arrays: Mapping[str, np.ndarray], backend: str) -> dict[str, Any]:
    """Return arrays of the same memory, by name, as arguments of a backend's kernels."""
    return {name: kernel_array(array, backend) for name, array in arrays.items()}


def kernel_vectors(array: np.ndarray, backend: str) -> Any:
    """Return an array (n, k) of the same memory as a kernel argument: vectors of length k for Warp."""
    if on_numpy(backend):
        return array
    import warp as wp

    start_warp()
    dtype = wp.types.vector(array.shape[1], wp.dtype_from_numpy(array.dtype))
    return wp.array(array, dtype=dtype, shape=(len(array),), device="cpu", copy=False)


class Fielded(Protocol):
    """Anything with fields as numpy arrays: a group of arrays, or values for one."""

    def numpy(self, name: str) -> np.ndarray:
        """The array of a field."""


class ArrayGroup:
    """Named arrays allocated from a table of fields; attributes read them, ``assign`` writes values."""

    table: Mapping[str, Field] = {}
    live: Container[str] | None = None
    """Fields that may be written while a simulation uses the group, and act at its next step; None: all that do not
    lead kernels through memory."""
    segments: Mapping[str, Segments] | None = None
    """Elements of each world by axis; None before a simulation uses the group."""
    changeable: tuple[str, ...] = ()
    """Fields that ``Simulation.change_model`` writes while a simulation uses the group."""
    sizes: dict[str, int]
    dtype: np.dtype
    device: str
    backend: str
    version: int
    """Number of times that arrays were reallocated."""
    fixed: bool
    """Whether a simulation uses the arrays: those that it has checked, or from which it derives data, are read-only."""
    whole: Block | None
    """The memory of all arrays, where they lie as they were allocated together on the CPU; else None."""
    blocks: dict[str, Block]
    """Where each array lies that has the memory which was allocated for it on the CPU, and no other, by name."""

    def __init__(self, sizes: Mapping[str, int], dtype: Any, device: str = "cpu", backend: str = "warp") -> None:
        """Allocate every field of the table, zeroed.

        Args:
            sizes: elements on each axis that the table names.
            dtype: float32 or float64, the scalar of "real", "vec2" and "vec4" fields.
            device: "cpu" or a CUDA device of Warp; "cpu" only for the numpy backend.
            backend: a name in ``runtime.backends.BACKENDS``.
        """
        # past ``__setattr__``, as a simulation has a dozen groups
        vars(self).update(sizes=dict(sizes), dtype=float_dtype(dtype), device=device, backend=backend)
        vars(self).update(version=0, fixed=False, blocks={}, whole=None)
        self._allocate(self._planned())

    @cached_property
    def users(self) -> WeakSet[Any]:
        """The simulations that use the group."""
        return WeakSet()

    def __setattr__(self, name: str, value: Any) -> None:
        """Set what a group is known by; kernels would go on with the array that a field had, and see no other name.

        Raises:
            AttributeError: for a field, saying how its values are written; for a name that means nothing.
        """
        if name in self.table and value is not self.__dict__.get(name):
            kind = type(self).__name__.lower()
            raise AttributeError(
                f"{kind}.{name} cannot be replaced, as kernels hold its memory; write into it: "
                f'{kind}.assign("{name}", values), or {kind}.numpy("{name}")[...] = values on a CPU'
            )
        said = name in ArrayGroup.__annotations__ or name in type(self).__annotations__
        if not (said or name[:1] == "_" or name in self.table):
            raise AttributeError(f"{type(self).__name__.lower()} has no {name}; it has {', '.join(self.table)}")
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        """Return the array of a field as the backend's array type, made at its first use."""
        block = self.__dict__.get("blocks", {}).get(name)
        if block is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        made = block.array(name)
        if not on_numpy(self.backend):
            from dc_kernels.runtime.launches import shared_array

            types = kernel_file(self.backend, "groups").field_types(self.table, self.dtype)
            made = shared_array(made, types[name], block.address(name))
        return self.__dict__.setdefault(name, made)  # the same for all threads that ask at once

    def _allocate(self, plan: Plan) -> None:
        """Make the zeroed arrays of a plan; none are left of those before."""
        if not on_numpy(self.backend):
            start_warp()
        if self.device != "cpu":
            import warp as wp

            types = kernel_file(self.backend, "groups").field_types(self.table, self.dtype)
            found = elements(self.table, self.dtype)
            for name, shape in plan.shapes.items():
                axes = shape[: len(found[name].axes)]
                self.share(name, wp.zeros(axes, dtype=types[name], device=self.device))
            return
        block = plan.zeros()
        for name in self.__dict__.keys() & plan.shapes.keys():
            del self.__dict__[name]
        self.blocks.update(dict.fromkeys(plan.shapes, block))
        self.whole = block if len(plan.shapes) == len(self.table) else None

    def share(self, name: str, array: Any) -> None:
        """Let a field lie in another array, laid out as its own; launches bound before keep the old one."""
        self.blocks.pop(name, None)
        self.whole = None
        self.__dict__[name] = array

    def plan(self) -> Plan:
        """How the arrays lie in memory; that of groups of equal sizes is one object."""
        return plan_of(self.table, self.dtype, self.sizes)

    def copy(self) -> Self:
        """Return a copy with its own memory, which no simulation uses yet."""
        if self.whole is None:
            return _filled(*self._parts())
        made = type(self)(self.sizes, self.dtype, self.device, self.backend)
        if made.whole is not None:
            made.whole.take(self.whole)
        return made

    def __copy__(self) -> Self:
        """See ``copy``: two groups of one memory would be written to at once."""
        return self.copy()

    def __deepcopy__(self, memo: Any) -> Self:
        """See ``copy``."""
        return self.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values; what is read back is as ``copy`` gives it, on a device of that name."""
        return _filled, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        """What ``_filled`` makes a group of."""
        values = {name: self.memory(name) for name in self.table}
        return type(self), self.sizes, float_name(self.dtype), self.device, self.backend, values

    def _planned(self, names: Iterable[str] | None = None) -> Plan:
        """How some fields, None: all, are to lie; a MemoryError, naming the largest array, where there is no room."""
        plan = plan_of(self.table, self.dtype, self.sizes, None if names is None else tuple(names))
        if plan.bytes >= LARGE and plan.largest is not None and self.device == "cpu":
            sizes = ", ".join(f"{axis} {self.sizes[axis]}" for axis in self.table[plan.largest].axes)
            check_memory(f"{type(self).__name__}.{plan.largest} ({sizes}) with what goes with it", plan.bytes)
        return plan

    def reallocate(self, names: Iterable[str], **sizes: int) -> None:
        """Replace arrays by zeroed ones of other sizes; views taken before are stale.

        Args:
            names: fields to allocate anew.
            sizes: new elements on the axes by their names.
        """
        before = dict(self.sizes)
        self.sizes.update(sizes)
        try:
            plan = self._planned(names)
        except MemoryError:
            self.sizes = before
            raise
        self.version += 1
        self._allocate(plan)

    def renew(self, **sizes: int) -> dict[str, Any]:
        """Allocate every array anew; those whose axes keep their sizes keep their values.

        Launches in a graph that was recorded before go on with the arrays that they had, all of one layout.

        Args:
            sizes: new elements on the axes by their names.

        Returns:
            The arrays before, by name.
        """
        changed = {axis for axis, size in sizes.items() if size != self.sizes[axis]}
        before = {name: getattr(self, name) for name in self.table}
        self.reallocate(self.table, **sizes)
        for name, field in self.table.items():
            if changed.isdisjoint(field.axes):
                if isinstance(before[name], np.ndarray) or self.device == "cpu":
                    self.memory(name)[...] = to_numpy(before[name])
                else:
                    getattr(self, name).assign(before[name])
        return before

    def array(self, name: str) -> Any:
        """The array of a field."""
        return getattr(self, name)

    def numpy(self, name: str) -> np.ndarray:
        """Return the array of a field as numpy (see ``to_numpy``).

        It is read-only if kernels use its values as memory addresses, or if ``assign`` refuses the field.
        """
        array = self.memory(name)
        if self.fixed and not self.writable(name):
            return locked(array, self._in_use(name))
        if self.table[name].points:
            array = array.view()  # without words: a model is made of many of them
            array.flags.writeable = False
        return array

    def memory(self, name: str) -> np.ndarray:
        """Return the array of a field as writable numpy: the memory itself on a CPU, a copy from a GPU."""
        block = self.blocks.get(name) if isinstance(name, str) else None
        return to_numpy(getattr(self, self.field(name).name)) if block is None else block.array(name)

    def field(self, name: str) -> Field:
        """The field of a name; raises ``UnknownName``, naming those that there are."""
        if not isinstance(name, str) or name not in self.table:
            kind = type(self).__name__.lower()
            raise UnknownName(f"name is {shown(name)}, no field of {kind}; it must be one of {', '.join(self.table)}")
        return self.table[name]

    def views(self) -> dict[str, np.ndarray]:
        """Return all arrays as numpy, by name."""
        return {name: self.numpy(name) for name in self.table}

    def worlds(self, name: str) -> WorldViews:
        """Return the array of a field world by world, in the same memory on the CPU.

        It has the shape (W, n, ...) if each world has n elements; otherwise it is a list of W arrays (n, ...), as for
        contacts, of which each world shows those in use.

        Raises:
            ValueError: the field is unknown or not divided among worlds, or no simulation uses the group.
        """
        field = self.field(name)
        counted = "contact_count" in self.table
        slots = (self.numpy("contact_start"), self.numpy("contact_count")) if counted else None
        label = f"{type(self).__name__.lower()}.{name}"
        return by_world(label, field, self.numpy(name), self.segments, slots)

    def __repr__(self) -> str:
        """Sizes, scalar, backend and device."""
        axes = dict.fromkeys(axis for field in self.table.values() for axis in field.axes if axis in self.sizes)
        counts = [counted(self.sizes[axis], axis) for axis in axes if not axis.endswith("+1")]
        return f"<{type(self).__name__}: {', '.join(counts)}; {self.dtype.name}, {self.backend} on {self.device}>"

    def writable(self, name: str) -> bool:
        """Whether ``assign`` takes values of a field now."""
        return not self.fixed or (not self.table[name].points if self.live is None else name in self.live)

    def _in_use(self, name: str) -> str:
        """Why a field of a group that a simulation uses is not written to, and how it is changed."""
        return _in_use(type(self).__name__.lower(), name, name in self.changeable)

    def assign(self, name: str, values: Any) -> None:
        """Copy values into a field.

        Raises:
            UnknownName: (a ``ValueError`` and ``KeyError``) the field is unknown; the error names the existing ones.
            ValueError: the shape differs, values are not finite, or an integer dtype would lose bits; a simulation has
                checked the field or derived data from it (``writable``); in a group that a simulation uses, a number
                is out of the field's range. The error names the field.
        """
        rule = self.field(name).rule
        if not self.writable(name):
            raise ValueError(self._in_use(name))
        element = elements(self.table, self.dtype)[name]
        shape = (*(self.sizes[axis] for axis in element.axes), *element.shape)
        array = check_values(name, values, shape, element.scalar)
        if (self.fixed or self.table is STATE) and isinstance(rule, Number | Unit):  # nobody looks at it again
            check_rule(name, array, rule)
        self.fill(name, array)

    def fill(self, name: str, values: np.ndarray) -> None:
        """Copy values of a field's own shape and dtype into it, whatever they are: ``assign`` looks at them."""
        if self.device == "cpu":
            self.memory(name)[...] = values
        else:
            getattr(self, name).assign(values)

    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return self.plan().bytes

    def nbytes_by_axis(self) -> dict[str, int]:
        """Bytes by the axis that the arrays run along."""
        total: dict[str, int] = {}
        for name, one in elements(self.table, self.dtype).items():
            per = self.table[name].per
            total[per] = total.get(per, 0) + one.width * math.prod(self.sizes[axis] for axis in one.axes)
        return total


@cache
def _in_use(kind: str, name: str, changeable: bool) -> str:
    way = f"sim.change_model({name}=values) changes it there; or " if changeable else ""
    return (
        f"{name} is in use by a simulation, which has checked it and derived others from it; {way}write into a "
        f"copy, {kind}.copy(), and make a new simulation of that"
    )


def _filled(
    kind: type[Group],
    sizes: Mapping[str, int],
    dtype: str,
    device: str,
    backend: str,
    values: Mapping[str, np.ndarray],
) -> Group:
    """Allocate a group of a kind and fill it with values."""
    made = kind(sizes, dtype, device, backend)
    for name in made.table:
        made.fill(name, values[name])
    return made


class Model(ArrayGroup):
    """The constant data of a scene: bodies, shapes, worlds (``model.fields.MODEL``)."""

    table = MODEL
    live = ("gravity", "origin")
    traits = tuple(name for name, field in MODEL.items() if field.per in TRAITS)
    changeable = (
        *traits,
        *("gravity", "origin", "length_scale", "cell_size", "body_type", "mass", "inertia", "inv_mass", "inv_inertia"),
        *("shape_radius", "shape_friction", "shape_restitution", "shape_category", "shape_mask", "vertices"),
    )

    def __init__(self, sizes: Mapping[str, int], *memory: Any) -> None:
        """Allocate the arrays (see ``ArrayGroup``); optional fields are empty unless ``sizes`` has their axis."""
        super().__init__({**dict.fromkeys(TRAITS, 0), **sizes}, *memory)

    @property
    def world_count(self) -> int:
        """Number of worlds."""
        return self.sizes["world"]

    @property
    def body_count(self) -> int:
        """Number of bodies of all worlds."""
        return self.sizes["body"]

    @property
    def shape_count(self) -> int:
        """Number of shapes of all worlds."""
        return self.sizes["shape"]

    @property
    def joint_count(self) -> int:
        """Number of joints of all worlds."""
        return int(self.numpy("joint_start")[-1])


class State(ArrayGroup):
    """The data that evolve in time: positions, velocities, time (``model.fields.STATE``)."""

    table = STATE


class Contacts(ArrayGroup):
    """The contacts of the present step and the impulses that persist (``model.fields.CONTACTS``)."""

    table = CONTACTS

    def __init__(self, sizes: Mapping[str, int], dtype: Any, device: str = "cpu", backend: str = "warp") -> None:
        """Allocate (see ``ArrayGroup``); none resists rolling unless ``sizes`` has that axis too."""
        super().__init__({ROLLING: 0, **sizes}, dtype, device, backend)
