"""Taichi's running program: started if there is none, the user's own beside it unharmed, in any process and thread.

Taichi has one program in a process, which the user may have started with ``ti.init``, and may start anew. Kernels run
in whichever is there; they are compiled with options of their own, and the program's are put back.
"""

import contextlib
import ctypes
import importlib
import io
import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from dc_kernels._taichi.runtime.compiler import impl, ti
from dc_kernels._taichi.runtime.frontend import reading
from dc_kernels.runtime.building import building

OPTIONS = {
    "fast_math": False,  # the bits of the other backends
    "real_matrix_scalarize": False,  # vectors stay vectors: rows are solved in SIMD lanes
    "make_cpu_multithreading_loop": False,  # else fewer than 512 shards of worlds run on one thread
    "debug": False,
    "check_out_of_bound": False,
}
"""What kernels are compiled with, whatever the program was started with."""
OF_LARGE = {"opt_level": 0}
"""What large kernels are compiled with beside that: LLVM finds common expressions as well, and Taichi's own pass for
them takes time that grows with the square of a kernel's size, 28 of a step's 37 s. Steps are 2 % slower without it."""
DEFAULTS = ("default_fp", "default_ip", "short_circuit_operators")
"""What else of a running program decides how a source is compiled: types of its numbers, and how "and" is."""
PATIENCE = 10_000_000  # turns that a thread waits for the others, some 0.1 s
TRIES = 20
_ours: Any = None  # the program that was started here
_calmed: Any = None  # the program whose threads ``calm_threads`` has set
_library: Any = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.ucrtbase  # type: ignore[attr-defined, unused-ignore]
_numbers = ctypes.create_string_buffer(256)  # a floating-point environment: a fenv_t has 8 to 32 bytes
_inherited: Any = None  # the program that a forked process has of its parent, without its threads


def _caller() -> Any:
    """What puts a call of C's ``fesetenv`` into a kernel; None where the compiler has no such thing."""
    with contextlib.suppress(ImportError, AttributeError):
        builder = importlib.import_module(f"{ti.__name__}.lang.source_builder").SourceBuilder()
        builder.mode, builder.so = "so", _library
        call = builder.fesetenv
        call._is_wrapped_kernel = True  # or a warning tells of it
        return call
    return None


_set_numbers = _caller()


def program() -> Any:
    """The program that is running on the CPU, started without a line of output if there is none.

    Raises:
        RuntimeError: where the user's runs on another device.
    """
    if running() is None:
        with building():
            if running() is None:
                _start()
    prog = running()
    if prog.config().arch not in (ti.x64, ti.arm64):
        name = prog.config().arch.name
        raise RuntimeError(
            f"{ti.__name__} runs on {name}; backend='taichi' needs {ti.__name__}.init(arch=cpu), or none"
        )
    return prog


def running() -> Any:
    """The program that is running, or None; what was compiled for another one is gone."""
    runtime = impl.get_runtime()
    return runtime._prog if hasattr(runtime, "_prog") else runtime.prog  # Quadrants raises an error where there is none


def has_threads(prog: Any) -> bool:
    """Whether a program has the threads that a parallel loop waits for: in a forked process its parent's has none."""
    return prog is not _inherited


@contextlib.contextmanager
def compiling(prog: Any, real: Any, *, large: bool = False) -> Iterator[None]:
    """Compile one thread at a time with ``OPTIONS``, numbers of a source being of type ``real``, or int32.

    ``large`` takes those ``OF_LARGE`` kernels too.

    Raises:
        RuntimeError: where the program was started on another thread and has not compiled anything there yet.
    """
    with building():
        runtime, config = impl.get_runtime(), prog.config()
        wanted = OPTIONS | (OF_LARGE if large else {})
        options = {name: value for name, value in wanted.items() if hasattr(config, name)}
        before = {name: getattr(config, name) for name in options}
        defaults = {name: getattr(runtime, name) for name in DEFAULTS}
        # a configuration gives its types away by reference: what stands there before is not kept by taking it
        options |= {"default_fp": real, "default_ip": ti.i32}
        before |= {name: defaults[name] for name in ("default_fp", "default_ip")}
        for name, value in options.items():
            setattr(config, name, value)
        runtime.default_fp, runtime.default_ip, runtime.short_circuit_operators = real, ti.i32, True
        try:
            with reading():
                yield
        except RuntimeError as error:
            if "main_thread_id" in str(error):
                raise RuntimeError(
                    f"{ti.__name__}.init was called on another thread than {threading.current_thread().name}, which "
                    "comes first with a kernel; run any kernel on that thread before"
                ) from error
            raise
        finally:
            for name, value in before.items():
                setattr(config, name, value)
            for name, value in defaults.items():
                setattr(runtime, name, value)


@contextlib.contextmanager
def _subnormals_kept() -> Iterator[None]:
    """Put this thread's floating-point environment back, in which ``ti.init`` flushes subnormal numbers to zero.

    All that this process computes on it from then on, with NumPy and Warp too, would have other bits.
    """
    _library.fegetenv(_numbers)
    try:
        yield
    finally:
        _library.fesetenv(_numbers)


def _start() -> None:
    """Start a program of our own, which keeps compiled kernels beside Warp's."""
    global _ours
    import warp as wp

    folder = os.path.join(wp.config.kernel_cache_dir, ti.__name__)
    with contextlib.redirect_stdout(io.StringIO()), _subnormals_kept():
        ti.init(arch=ti.cpu, log_level=ti.WARN, offline_cache=True, offline_cache_file_path=folder)
    _ours = running()
    _first()  # the thread that started a program has to be the first that compiles


def calm_threads(prog: Any) -> None:
    """Put back the floating-point environment of the pool's threads too, in a program of our own."""
    global _calmed
    if prog is not _ours or prog is _calmed or _set_numbers is None:
        return
    count = prog.config().cpu_max_num_threads
    with compiling(prog, ti.f32):
        cached = prog.config().offline_cache
        prog.config().offline_cache = False  # the address of a function of C holds in this process only
        try:
            for _ in range(TRIES):
                waited = np.zeros(count + 1, np.int32)
                _calm(ctypes.addressof(_numbers), count, waited)
                if waited[1:].max() < PATIENCE:
                    break
        finally:
            prog.config().offline_cache = cached
    _calmed = prog


@ti.kernel
def _calm(numbers: ti.i64, count: ti.i32, waited: ti.types.ndarray(dtype=ti.i32, ndim=1)):
    """Each thread takes one turn, as none ends before all have begun."""
    ti.loop_config(block_dim=1)
    for i in range(count):
        _set_numbers(args=(numbers,), outputs=())
        ti.atomic_add(waited[0], 1)
        turns = 0
        while turns < PATIENCE and ti.atomic_or(waited[0], 0) < count:
            turns += 1
        waited[1 + i] = turns


@ti.kernel
def _first():
    """Nothing."""


def _inherit() -> None:
    global _inherited
    _inherited = running()


os.register_at_fork(after_in_child=_inherit)
