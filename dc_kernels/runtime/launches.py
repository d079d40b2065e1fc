"""Launches of Warp kernels on the CPU, bound once: a call costs what the compiled function does, or what has changed.

The memory that a launch is pointed at is read and written where it lies; only the caller keeps it alive.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from dc_kernels.runtime.building import block_size, load
from dc_kernels.runtime.capture import recording, refuse_recording
from dc_kernels.runtime.threads import run_shards, shard_worlds

# versions of Warp whose compiled functions are known to take bounds and a struct of the arguments
PACKED = ("1.19.",)


def descriptor(pointer: int, shape: tuple[int, ...], element: Any) -> Any:
    """Warp's descriptor of contiguous memory; a vector takes its last axis."""
    template = _template(shape[:-1] if hasattr(element, "_shape_") else shape, element)
    result = type(template).from_buffer_copy(template)
    result.data = pointer
    return result


def shared_array(memory: np.ndarray, element: Any, address: int) -> Any:
    """A Warp array in the memory of a contiguous numpy array, which it keeps alive.

    Args:
        memory: on the CPU.
        element: its type for Warp; one of a vector takes an axis of the memory.
        address: of the memory.
    """
    dimensions = memory.ndim - hasattr(element, "_shape_")
    shape, strides = memory.shape[:dimensions], memory.strides[:dimensions]
    if not wp.__version__.startswith(PACKED):
        return wp.array(memory, dtype=element, shape=shape, device="cpu", copy=False)
    # as Warp's constructor makes it, in a tenth of the time: a simulation has a hundred arrays
    attributes = _attributes(element, dimensions).copy()
    template = attributes["ctype"]
    native = type(template).from_buffer_copy(template)
    native.data = address
    for axis in range(dimensions):
        native.shape[axis], native.strides[axis] = shape[axis], strides[axis]
    attributes.update(ctype=native, ptr=address, shape=shape, strides=strides, _ref=memory)
    attributes.update(size=math.prod(shape), capacity=memory.nbytes)
    made = object.__new__(wp.array)
    made.__dict__ = attributes
    return made


@functools.lru_cache(256)
def _attributes(element: Any, dimensions: int) -> dict[str, Any]:
    """What Warp keeps of an array in the CPU's memory."""
    array = wp.array(ptr=0, dtype=element, shape=(0,) * dimensions, device="cpu")
    array.__ctype__()
    return dict(vars(array))


@functools.lru_cache(256)
def _template(shape: tuple[int, ...], element: Any) -> Any:
    """A descriptor of an array without memory."""
    return wp.array(ptr=0, dtype=element, shape=tuple(shape), device="cpu").__ctype__()


@functools.lru_cache(1024)
def _packed_type(fields: tuple[tuple[str, Any], ...]) -> Any:
    """The struct in which a compiled function takes its arguments."""
    return type("Packed", (ctypes.Structure,), {"_fields_": list(fields)})


def element_types(kernel: Any) -> dict[str, Any]:
    """Arguments of a kernel in order, each with the type of its elements; None for a scalar or a group."""
    return {argument.label: getattr(argument.type, "dtype", None) for argument in kernel.adj.args}


class _Recorded(NamedTuple):
    """What launches of a kernel over so many threads have in common, on the CPU."""

    attributes: dict[str, Any]
    bounds: Any
    types: list[Any]  # of the kernel's arguments, as Warp packs them


_recorded: dict[tuple[Any, int | tuple[int, ...]], _Recorded] = {}
RECORDED = 1024  # that are kept


def record(kernel: Any, dim: int | tuple[int, ...], arguments: Sequence[Any], device: str) -> Any:
    """A launch as Warp records it (``wp.Launch``), its kernel compiled and loaded."""
    load(kernel, device)
    quick = device == "cpu" and wp.__version__.startswith(PACKED)
    known = _recorded.get((kernel, dim)) if quick else None
    packed = None if known is None else _packed_arguments(kernel, arguments, known.types)
    if known is not None and packed is not None:  # as Warp makes it, in a tenth of the time
        bounds = type(known.bounds).from_buffer_copy(known.bounds)
        launch = object.__new__(wp.Launch)
        vars(launch).update(known.attributes, bounds=bounds, params=[bounds, *packed], fwd_args=list(arguments))
        return launch
    block = block_size(device)
    launch = wp.launch(kernel, dim=dim, inputs=list(arguments), device=device, block_dim=block, record_cmd=True)
    if quick:
        if len(_recorded) >= RECORDED:
            _recorded.clear()
        kept = {name: value for name, value in vars(launch).items() if name not in ("bounds", "params", "fwd_args")}
        bounds = type(launch.bounds).from_buffer_copy(launch.bounds)
        _recorded[kernel, dim] = _Recorded(kept, bounds, [type(value) for value in launch.params[1:]])
    return launch


def _packed_arguments(kernel: Any, arguments: Sequence[Any], types: Sequence[Any]) -> list[Any] | None:
    """Arguments as Warp packs them; None where one is of a type that Warp should look at, and maybe refuse."""
    packed = []
    for argument, value, kind in zip(kernel.adj.args, arguments, types, strict=True):
        if type(value) is int or (type(value) is float and kind in (ctypes.c_float, ctypes.c_double)):
            one = kind(value) if issubclass(kind, ctypes._SimpleCData) else None
        elif type(value) is wp.array:
            same = value.dtype is argument.type.dtype and value.ndim == argument.type.ndim
            one = value.__ctype__() if same and value.device.is_cpu else None
        else:
            one = getattr(value, "_ctype", None)  # of a struct
        if type(one) is not kind:
            return None
        packed.append(one)
    return packed


class Bound:
    """A recorded launch whose arguments stay packed, so that a call costs what has changed.

    Warp packs them anew at each launch, 4 us for twenty; with a version that is not in ``PACKED`` it still does. While
    the calling thread records a graph, a call becomes part of it.

    Attributes:
        kept: what must live as long as the launch, which has its memory by address alone.
    """

    def __init__(self, launch: Any) -> None:
        """``launch``: as ``record`` makes it, on the CPU."""
        self.launch, self.elements = launch, element_types(launch.kernel)
        self.kept: Any = None
        self._index = {name: i for i, name in enumerate(self.elements)}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._apart: set[str] = set()  # arguments whose rows do not follow each other
        self._moved = False
        self._views: dict[str, Any] = {}
        self._packed: Any = None
        if wp.__version__.startswith(PACKED):
            fields = tuple((name, type(value)) for name, value in zip(self.elements, launch.params[1:]))
            self._packed = _packed_type(fields)(*launch.params[1:])
            self._pointer = ctypes.byref(self._packed)
            self._bounds = ctypes.byref(launch.params[0])
            self._forward = launch.hooks.forward
            self._views = {name: getattr(self._packed, name) for name, element in self.elements.items() if element}

    @property
    def addresses(self) -> tuple[int, int, int] | None:
        """Addresses of the compiled function, its bounds and its packed arguments; None where Warp packs them."""
        if self._packed is None:
            return None
        function = ctypes.cast(self._forward, ctypes.c_void_p).value
        return function or 0, ctypes.addressof(self.launch.params[0]), ctypes.addressof(self._packed)

    def set(self, name: str, value: Any) -> None:
        """Set an argument, or the field of a struct ("struct.field"), to a number or a descriptor."""
        self._moved = True
        group, _, field = name.rpartition(".")
        if group:
            setattr(self._struct(group), field, value)
        elif self._packed is None:
            self.launch.set_param_at_index_from_ctype(self._index[name], value)
        else:
            setattr(self._packed, name, value)

    def point(self, name: str, pointer: int, shape: tuple[int, ...], apart: int = 0) -> None:
        """Set an argument, or the field of a struct, to contiguous memory; only the caller keeps it alive.

        Args:
            name: of the argument, or "struct.field".
            pointer: address of the memory.
            shape: its shape; where elements are vectors, theirs is the last axis.
            apart: bytes from a row to the next, where rows do not follow each other.
        """
        if self._packed is not None and self._shapes.get(name) == shape and not apart and name not in self._apart:
            self._views[name].data = pointer
            return
        group, _, field = name.rpartition(".")
        fields = self.launch.kernel.adj.args[self._index[group]].type.vars if group else {}
        array = descriptor(pointer, shape, fields[field].type.dtype if group else self.elements[name])
        self._apart.discard(name)
        if apart:
            array.strides[0] = apart
            self._apart.add(name)
        self.set(name, array)
        if group:
            self._views[name] = getattr(self._struct(group), field)
        self._shapes[name] = shape

    def give(self, name: str, value: Any) -> None:
        """Set an argument to a number or a contiguous numpy array, which only the caller keeps alive."""
        if isinstance(value, np.ndarray):
            self.point(name, value.ctypes.data, value.shape)
        else:
            self.set(name, value)

    def _struct(self, name: str) -> Any:
        """The memory of an argument that is a struct."""
        return self.launch.params[1 + self._index[name]] if self._packed is None else getattr(self._packed, name)

    def set_dim(self, dim: int) -> None:
        """Set the number of threads."""
        if dim != self.launch.bounds.size:
            self.launch.set_dim(dim)
            self._bounds = ctypes.byref(self.launch.params[0])

    def __call__(self) -> None:
        """Launch, or become part of the graph that this thread records.

        Raises:
            RuntimeError: in a recording, for a launch that was pointed at other memory since it was bound.
        """
        if recording():
            if self._moved:
                raise RuntimeError(
                    f"{self.launch.kernel.key} cannot be recorded in a graph: its memory is given at each call"
                )
            self.launch.launch()
        else:
            self.launch_now()

    def launch_now(self) -> None:
        """Launch where the calling thread is known to record no graph."""
        if self._packed is None:
            self.launch.launch()
        else:
            self._forward(self._bounds, self._pointer)


class Calls:
    """Calls of a kernel on tensors or numpy arrays, with other arguments each time.

    A call takes a launch that is not under way for each thread and gives it back: a new one takes Warp 100 us.
    """

    def __init__(self, kernel: Any) -> None:
        """``kernel``: of Warp, over worlds from ``world_offset`` on."""
        self.kernel, self.elements = kernel, element_types(kernel)
        self._free: list[Bound] = []

    def __call__(self, values: Mapping[str, Any], worlds: int, threads: int) -> None:
        """Launch on contiguous tensors and arrays, numbers and groups of them by name, threads on shares of the worlds.

        Raises:
            RuntimeError: in a recording.
        """
        refuse_recording("a call on arrays of its own", "their memory is given at each call")
        each = values["chunks"] if "chunks" in self.elements else 1
        launches = []
        for first, count in shard_worlds(worlds, threads) if threads > 1 else [(0, worlds)]:
            launch = self._take()
            for name in self.elements:
                if name == "world_offset":
                    launch.set(name, first)
                elif isinstance(values[name], Mapping):
                    for field, value in values[name].items():
                        self._give(launch, f"{name}.{field}", value)
                else:
                    self._give(launch, name, values[name])
            launch.set_dim(count * each)
            launches.append(launch)
        run_shards(launches, threads)
        self._free.extend(launches)

    def _give(self, launch: Bound, name: str, value: Any) -> None:
        """Set an argument to a number, a tensor, or a contiguous array."""
        if hasattr(value, "data_ptr"):
            if value.is_contiguous():
                launch.point(name, value.data_ptr(), value.shape)
            else:
                launch.point(name, value.data_ptr(), value.shape, value.stride(0) * value.element_size())
        elif isinstance(value, np.ndarray):
            launch.point(name, value.__array_interface__["data"][0], value.shape)
        else:
            launch.set(name, value)

    def _take(self) -> Bound:
        """A launch that no other call uses, whichever thread that is on."""
        try:
            return self._free.pop()
        except IndexError:
            pass
        return Bound(record(self.kernel, 1, [_anything(argument.type) for argument in self.kernel.adj.args], "cpu"))


def _anything(kind: Any) -> Any:
    """A value of an argument's type, to be set later: a struct of nothing, no array, or 0."""
    element = getattr(kind, "dtype", None)
    if element is not None:
        return _template((0,) * kind.ndim, element)
    return kind() if hasattr(kind, "vars") else 0
