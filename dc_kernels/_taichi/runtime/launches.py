"""Launches of Taichi kernels that are bound once: arguments are checked and packed, then a call costs microseconds.

A call compares the running program with the one that the launch was bound for, and binds anew where the user has
started another. Taichi's own calls, 20 times as slow, take the place of what its versions may lack.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.program import calm_threads, compiling, has_threads, program, running
from dc_kernels.runtime.capture import refuse_recording

MOST = 2**30  # numbers of an array: an index in int32, and lanes from there on (see ``lanes``)
NEVER = object()  # the program of what was not compiled yet
_parallel: weakref.WeakSet[Any] = weakref.WeakSet()  # launches that wait for threads of the program


class Argument(NamedTuple):
    """One argument of a compiled kernel."""

    name: str
    """As people know it: "motion.step_dt"."""
    annotation: Any
    """A scalar type, or that of an array."""
    value: Any
    """A number, or a numpy array of the shape that Taichi takes."""
    written: bool
    """Whether the kernel writes to it."""


def check_memory(arguments: Sequence[Argument]) -> None:
    """Refuse arrays that Taichi would read or write wrongly in silence.

    Raises:
        ValueError: naming the argument, for an array of another dtype or number of axes, with strides, read-only where
            the kernel writes, misaligned for the vectors that it is made of, or overlapping another where one of the
            two is written, or of more than ``MOST`` numbers.
    """
    spans = []
    for name, annotation, array, written in arguments:
        if not isinstance(array, np.ndarray):
            continue
        inner = annotation.dtype.get_shape() if hasattr(annotation.dtype, "get_shape") else ()
        scalar = ti.lang.util.to_numpy_type(annotation.dtype.dtype if inner else annotation.dtype)
        if array.dtype != scalar:
            raise ValueError(f"{name} has dtype {array.dtype}; it must be {np.dtype(scalar)}")
        axes = annotation.ndim + len(inner)
        if array.ndim != axes or array.shape[axes - len(inner) :] != tuple(inner):
            wanted = ", ".join(["any"] * annotation.ndim + [str(n) for n in inner])
            raise ValueError(f"{name} has shape {array.shape}; it must be ({wanted}{',' * (axes == 1)})")
        if not array.flags.c_contiguous:
            raise ValueError(f"{name} has strides {array.strides} for shape {array.shape}; it must be contiguous")
        if array.size > MOST:
            raise ValueError(
                f"{name} has {array.size} numbers; it may have {MOST}, as {ti.__name__} counts them in int32"
            )
        if written and not array.flags.writeable:
            raise ValueError(f"{name} is read-only; it must be writable")
        if array.size == 0:
            continue
        first = array.ctypes.data
        alignment = array.itemsize * int(np.prod(inner))
        if first % alignment:
            raise ValueError(
                f"{name} lies at address {first:#x}; its vectors must lie at multiples of {alignment} bytes"
            )
        spans.append((first, first + array.nbytes, name, written))
    spans.sort()
    reach: tuple[int, int, str, bool] | None = None
    last_written: tuple[int, int, str, bool] | None = None
    for span in spans:
        for other in (last_written, reach if span[3] else None):
            if other is not None and span[0] < other[1]:
                raise ValueError(f"{other[2]} and {span[2]} share memory, and the kernel writes to it; they must not")
        if reach is None or span[1] > reach[1]:
            reach = span
        if span[3] and (last_written is None or span[1] > last_written[1]):
            last_written = span


class Bound:
    """A launch whose arguments are packed; it keeps their memory alive."""

    def __init__(
        self,
        name: str,
        make: Callable[[bool], Any],
        arguments: Sequence[Argument],
        *,
        elements: Sequence[str] = (),
        real: Any,
        parallel: bool,
        deferred: bool = False,
        large: bool = False,
    ) -> None:
        """Check the arrays and compile what they need.

        Args:
            name: of the kernel.
            make: gives the kernel of ``ti.kernel``, which shares its work among the program's threads if told so.
            arguments: all of its arguments in order.
            elements: names of the arguments as host code has them, groups whole.
            real: Taichi's type of the numbers in the kernel's source.
            parallel: whether threads share the work, in a program that has them.
            deferred: compile when it is called first.
            large: compile with the options of large kernels, see ``program.compiling``.

        Raises:
            ValueError: see ``check_memory``.
        """
        check_memory(arguments)
        self.name, self.make, self.arguments, self.real, self.parallel = name, make, list(arguments), real, parallel
        self.elements, self.large = list(elements), large
        self._index = {argument.name: i for i, argument in enumerate(self.arguments)}
        if parallel:
            _parallel.add(self)
        self._prog: Any = NEVER
        if not deferred:
            self.prepare()

    def __call__(self) -> None:
        """Launch.

        Raises:
            RuntimeError: in a recording.
        """
        refuse_recording(self.name, "the taichi backend runs at once")
        if running() is not self._prog:
            self._pack()
        self._launch(self._data, self._context)

    def prepare(self) -> None:
        """Compile, unless that has been done."""
        if running() is not self._prog:
            self._pack()

    def give(self, name: str, value: Any) -> None:
        """Set an argument to a number or an array, which must share no memory with others if one of them is written.

        Raises:
            ValueError: see ``check_memory``.
        """
        i = self._index.get(name)
        if i is None:
            return  # the kernel makes no use of it
        argument = self.arguments[i]._replace(value=value)
        check_memory([argument])
        self.arguments[i] = argument
        if self._prog is NEVER:
            return
        if self._context is None:
            self._data[i] = value
        else:
            self._set(i)

    def forget(self) -> None:
        """Pack anew before the next call."""
        self._prog = NEVER

    def _pack(self) -> None:
        self._prog = prog = program()
        parallel = self.parallel and has_threads(prog)
        if parallel:
            calm_threads(prog)
        self.kernel = self.make(parallel)
        values = [argument.value for argument in self.arguments]
        with compiling(prog, self.real, large=self.large):
            try:
                compiled = _compile(self.kernel, prog, values)
            except (AttributeError, KeyError):  # another version of the compiler
                compiled = None
        if compiled is None:
            self._data, self._context, self._launch = values, None, self._call
            return
        self._data, self._context = compiled
        self._launch = prog.launch_kernel
        for i in range(len(self.arguments)):
            self._set(i)

    def _set(self, i: int) -> None:
        """Pack an argument."""
        _, annotation, value, _ = self.arguments[i]
        slot = i if ti.__name__ == "quadrants" else (i,)
        if isinstance(value, np.ndarray):
            shape = value.shape[: annotation.ndim]
            self._context.set_arg_external_array_with_shape(slot, value.ctypes.data, value.nbytes, shape, 0)
        elif annotation in (ti.f32, ti.f64):
            self._context.set_arg_float(slot, float(value))
        elif annotation in (ti.u32, ti.u64):
            self._context.set_arg_uint(slot, int(value))
        else:
            self._context.set_arg_int(slot, int(value))

    def _call(self, values: Sequence[Any], _: None) -> None:
        """Launch as Taichi does it for everybody."""
        with compiling(self._prog, self.real, large=self.large):
            self.kernel(*values)


def _compile(kernel: Any, prog: Any, values: Sequence[Any]) -> tuple[Any, Any]:
    """Compiled kernel and a context for its arguments."""
    primal = kernel._primal
    primal.raise_on_templated_floats = False  # which a call of Quadrants sets
    key = primal.ensure_compiled(*values)
    lowered = (primal.compiled_kernels if hasattr(primal, "compiled_kernels") else primal.materialized_kernels)[key]
    data = prog.compile_kernel(prog.config(), prog.get_device_caps(), lowered)
    return getattr(data, "compiled_kernel_data", data), lowered.make_launch_context()


def _forget_threads() -> None:
    """A forked process has none of its parent's threads: launches that wait for them would hang."""
    for launch in list(_parallel):
        launch.forget()


os.register_at_fork(after_in_child=_forget_threads)
