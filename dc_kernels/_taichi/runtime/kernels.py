"""Kernels over worlds from functions of one: the same names and arguments as in the other backends, groups whole.

    @kernel
    def displace(tid, launch: t.Launch, model: t.Model, state: t.State, motion: t.Motion):
        w = tid + launch.world_offset
        ...

Arguments without an annotation come first: the indices of a thread, one or two. The source of what Taichi compiles is
written here: a loop over the threads, and of each group the fields that the function and what it calls use.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from dc_kernels._taichi.groups import SHARED, GroupType, seen
from dc_kernels._taichi.runtime.access import Array, Group, uses_of
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.launches import Argument, Bound
from dc_kernels._taichi.runtime.sources import define
from dc_kernels.runtime.interop import host_view
from dc_kernels.solve.integrate import PADDING

NDARRAY = type(ti.types.ndarray(dtype=ti.f32, ndim=1))


class Fields:
    """What a group stands for in a kernel: an attribute for each field that the kernel uses."""

    _is_wrapped_kernel = True  # Taichi warns of other Python functions that a kernel calls

    def __init__(self, **fields: Any) -> None:
        """``fields``: Taichi's arrays and numbers."""
        vars(self).update(fields)


class Kernel:
    """A kernel over worlds, compiled when it is first bound.

    Attributes:
        func: the function of one thread, for functions and kernels that call it.
        arguments: names of the arguments, as in the other backends.
        real: Taichi's type of the numbers in its source.
        axes: how many indices a thread has.
    """

    def __init__(self, function: Any) -> None:
        """``function``: of one thread, see the module."""
        self.__name__, self.__doc__ = function.__name__, function.__doc__
        parameters = inspect.signature(function).parameters
        self.func = ti.func(function)
        self._types = {name: p.annotation for name, p in parameters.items() if p.annotation is not p.empty}
        self._indices = [name for name in parameters if name not in self._types]
        self.arguments = list(self._types)
        given = {name: Group(name) for name in self.arguments if isinstance(self._types[name], GroupType)}
        arrays = {name: Array(name, "") for name in self.arguments if isinstance(self._types[name], NDARRAY)}
        self._uses = uses_of(function, {**given, **arrays})
        self._made: dict[tuple[Any, ...], Any] = {}
        real = [kind.dtype for kind in self._types.values() if isinstance(kind, GroupType)]
        self.real = ti.f64 if "float64" in real else ti.f32
        self.axes = len(self._indices)

    def bind(self, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> KernelLaunch:
        """A launch over so many threads (see ``runtime.backends.bind``).

        ``threads`` among the values, if there, is the number of threads of Taichi's pool that share the first axis; a
        forked process has none of them and works alone. With ``deferred`` among them the kernel is compiled when it is
        first called, or ``prepare`` asks for it.

        Raises:
            ValueError: for an array that kernels cannot take as it is, naming it.
        """
        extent = (dim,) if isinstance(dim, int) else dim
        if len(extent) != len(self._indices):
            raise ValueError(f"{self.__name__} runs over {len(self._indices)} axes; dim is {dim}")
        shards = min(int(values.get("threads", 1)), extent[0])
        given, constants = {}, {}
        for array in self._flat():
            value, annotation = self._value(array, values)
            if self._is_constant(array):
                constants[array] = value
                continue
            name = ".".join(filter(None, array))
            given[array] = Argument(name, annotation, value, array in self._uses.written)
        return KernelLaunch(self, extent, given, constants, shards=shards, deferred=bool(values.get("deferred")))

    def call(self, names: Mapping[Array, str], parallel: bool) -> list[str]:
        """Source of the arguments of the function of one thread, behind its indices; groups are put together.

        Args:
            names: what the compiled kernel calls each array and number.
            parallel: whether there is a variable ``shard``: threads share no cache line of a padding body.
        """
        given = []
        for argument in self.arguments:
            if not isinstance(self._types[argument], GroupType):
                given.append(names[Array(argument, "")])
                continue
            values = {array.field: names[array] for array in self._flat() if array.group == argument}
            if parallel and argument == "launch" and "padding_body" in values:
                values["padding_body"] += f" + {PADDING} * shard"
            given.append(f"Fields({', '.join(f'{field}={value}' for field, value in values.items())})")
        return given

    def _flat(self) -> list[Array]:
        """Arrays and numbers that the compiled kernel takes, in order."""
        scalars = [Array(n, "") for n, kind in self._types.items() if not isinstance(kind, GroupType)]
        return list(dict.fromkeys([*scalars, *self._uses.used]))

    def _is_constant(self, array: Array) -> bool:
        """Whether a number is compiled in."""
        kind = self._types[array.group]
        return isinstance(kind, GroupType) and array.field in kind.constants

    def _annotation(self, array: Array) -> Any:
        kind = self._types[array.group]
        return kind.annotation(array.field) if array.field else kind

    def _value(self, array: Array, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """What is given for an argument of the compiled kernel, and its type."""
        value, annotation = values[array.group], self._annotation(array)
        if array.field:
            value = getattr(value, array.field)
        if not isinstance(annotation, NDARRAY):
            return value.item() if isinstance(value, np.generic) else value, annotation
        value = host_view(".".join(filter(None, array)), value)
        if array.field:
            kind = self._types[array.group]
            value = seen(kind.name, kind.table[array.field], value)
        return value, annotation

    def compiled(self, constants: Mapping[Array, Any], other: Mapping[Array, Array], parallel: bool) -> Any:
        """The kernel of Taichi with these numbers in it, for threads of its pool or the one that launches it.

        Args:
            constants: numbers that are compiled in.
            other: arrays that are others, see ``shared``.
            parallel: for threads of the pool.
        """
        key = (parallel, *constants.values(), *other)
        if key not in self._made:
            types = [self._annotation(array) for array in self._flat()]
            scope = {"ti": ti, "types": types, "stage": self.func, "Fields": Fields}
            self._made[key] = define(self._source(constants, other, parallel), self.__name__, scope)
        return self._made[key]

    def _source(self, constants: Mapping[Array, Any], other: Mapping[Array, Array], parallel: bool) -> str:
        """Source of the kernel: its loop, and the call of the function with its groups put together."""
        flat = self._flat()
        names = named(flat, constants, other)
        given = [*self._indices, *self.call(names, parallel)]
        annotations = [*(f"dim{i}: ti.i32" for i in range(len(self._indices))), "shards: ti.i32"]
        annotations += [
            f"{names[array]}: types[{i}]" for i, array in enumerate(flat) if array not in {**constants, **other}
        ]
        lines = ["@ti.kernel", f"def {self.__name__}({', '.join(annotations)}):"]
        if parallel:
            lines += [
                "    ti.loop_config(block_dim=1)",
                "    for shard in range(shards):",
                "        size, more = dim0 // shards, dim0 % shards",
                "        first = shard * size + ti.min(shard, more)",
                "        last = first + size + ti.cast(shard < more, ti.i32)",
                f"        for {self._indices[0]} in range(first, last):",
            ]
        else:
            lines += ["    ti.loop_config(serialize=True)", f"    for {self._indices[0]} in range(dim0):"]
        for i, index in enumerate(self._indices[1:], 1):
            lines.append(f"{' ' * (4 + len(lines[-1]) - len(lines[-1].lstrip()))}for {index} in range(dim{i}):")
        indent = " " * (4 + len(lines[-1]) - len(lines[-1].lstrip()))
        return "\n".join([*lines, f"{indent}stage({', '.join(given)})", ""])


def shared(given: Mapping[Array, Argument]) -> dict[Array, Array]:
    """Arrays of ``SHARED`` that are the very memory of another one that is given, and that one."""
    found = {}
    for array, argument in given.items():
        other = SHARED.get((array.group, array.field))
        whole = given.get(Array(*other)) if other is not None else None
        if other is not None and whole is not None and whole.value.ctypes.data == argument.value.ctypes.data:
            found[array] = Array(*other)
    return found


def named(arrays: Iterable[Array], constants: Mapping[Array, Any], other: Mapping[Array, Array]) -> dict[Array, str]:
    """What a kernel's source calls arrays and numbers: by group and field, numbers that are compiled in as they are."""
    names = {array: "__".join(filter(None, array)) for array in arrays}
    return {
        **names,
        **{array: names[whole] for array, whole in other.items()},
        **{a: repr(v) for a, v in constants.items()},
    }


def merged(given: Mapping[Array, Argument], other: Mapping[Array, Array]) -> dict[Array, Argument]:
    """Arguments without those that are others, which are written where either is."""
    written = {whole for array, whole in other.items() if given[array].written}
    return {a: one._replace(written=one.written or a in written) for a, one in given.items() if a not in other}


class Either:
    """Two kernels of the same name and arguments, of which a launch takes one by what it is given.

    So a kernel that writes an array in one case only leaves that array alone, and unlooked at, in the other.
    """

    def __init__(self, decide: Callable[[Mapping[str, Any]], bool], one: Kernel, other: Kernel) -> None:
        """``decide``: from the values of a launch, whether it takes the first kernel."""
        self._decide, self._kernels = decide, (other, one)
        self.__name__, self.arguments = one.__name__, one.arguments

    def bind(self, dim: int | tuple[int, int], values: Mapping[str, Any], device: str) -> KernelLaunch:
        """See ``Kernel.bind``."""
        return self._kernels[self._decide(values)].bind(dim, values, device)


class KernelLaunch(Bound):
    """A bound launch of one kernel.

    Attributes:
        source: the kernel.
        extent: threads along each axis.
        given: its arguments by what they stand for in the kernel.
        constants: numbers that are compiled in.
    """

    def __init__(
        self,
        kernel: Kernel,
        extent: tuple[int, ...],
        given: Mapping[Array, Argument],
        constants: Mapping[Array, Any],
        *,
        shards: int,
        deferred: bool,
    ) -> None:
        """See ``Kernel.bind``; ``shards``: of the first axis, each a thread's."""
        self.source, self.extent, self.given, self.constants = kernel, extent, given, constants
        arguments = [Argument(f"dim{i}", ti.i32, n, False) for i, n in enumerate(extent)]
        other = shared(given)
        arguments += [Argument("shards", ti.i32, shards, False), *merged(given, other).values()]
        super().__init__(
            kernel.__name__,
            functools.partial(kernel.compiled, constants, other),
            arguments,
            elements=kernel.arguments,
            real=kernel.real,
            parallel=shards > 1,
            deferred=deferred,
        )


def kernel(function: Any) -> Kernel:
    """Make a kernel of a function of one thread (see the module)."""
    return Kernel(function)
