"""Launches of Taichi kernels: memory used where it lies, what is refused by name, and what a kernel is found to use."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp as wp

from dc_kernels.model.dtypes import aligned_zeros, struct_dtype
from dc_kernels.model.fields import ITERATION
from dc_kernels.runtime.backends import argument_names, bind
from dc_kernels.solve.integrate import PADDING

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)

from dc_kernels._taichi.elements import element_functions
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime import launches
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel

T = group_types("float64")


@ti.func
def store(w, value, target: ti.template()):
    target[w] = value


@kernel
def move(tid, launch: T.Launch, factor: ti.f64, state: T.State, motion: T.Motion):
    """Uses one number, reads three arrays and writes two, one of them in a function."""
    w = tid + launch.world_offset
    state.velocity[w] = 0.1 * factor * state.force[w] + motion.predicted[w][0]
    store(w, ti.f64(state.velocity[w][0]) + motion.step_dt[w], state.time)


@kernel
def add(i, j, x: ti.types.ndarray(dtype=ti.f32, ndim=1), y: ti.types.ndarray(dtype=ti.f32, ndim=1), out: T.Rows):
    """Two axes, arrays beside a group, and rows in lanes."""
    out.column[i][j] = x[i] + y[j]


def arrays(count=4):
    state = SimpleNamespace(
        velocity=aligned_zeros((count, 2), np.dtype(np.float64)), force=np.ones((count, 2)), time=np.zeros(count)
    )
    motion = SimpleNamespace(
        predicted=aligned_zeros((count, 4), np.dtype(np.float64)), step_dt=np.full(count, 0.5), summed=None
    )
    return {"launch": SimpleNamespace(world_offset=0), "factor": 3.0, "state": state, "motion": motion}


def frozen(array):
    array.flags.writeable = False
    return array


def test_only_what_is_used_is_taken():
    assert argument_names(move) == ["launch", "factor", "state", "motion"]
    launch = bind(move, 4, arrays(), "cpu")
    found = {argument.name: argument.written for argument in launch.arguments}
    assert found == {
        "dim0": False,
        "shards": False,
        "factor": False,
        "launch.world_offset": False,
        "state.velocity": True,
        "state.force": False,
        "motion.predicted": False,
        "motion.step_dt": False,
        "state.time": True,
    }


def test_memory_of_numpy_torch_and_warp_is_used_where_it_lies():
    given = arrays()
    given["state"].force = torch.from_numpy(given["state"].force)
    given["state"].time = wp.array(given["state"].time, dtype=wp.float64, device="cpu", copy=False)
    velocity = given["state"].velocity
    launch = bind(move, 4, given, "cpu")
    launch()
    taken = {argument.name: argument.value for argument in launch.arguments}
    assert taken["state.velocity"].ctypes.data == velocity.ctypes.data
    assert taken["state.force"].ctypes.data == given["state"].force.data_ptr()
    assert taken["state.time"].ctypes.data == given["state"].time.ptr
    assert (velocity == 0.1 * 3.0).all()  # a number in the source is a float64
    np.testing.assert_array_equal(given["state"].time.numpy(), 0.1 * 3.0 + 0.5)


def test_two_axes_and_lanes():
    x, y = np.arange(3, dtype=np.float32), np.arange(8, dtype=np.float32)
    column = aligned_zeros((24,), np.dtype(np.float64))
    bind(add, (3, 8), {"x": x, "y": y, "out": SimpleNamespace(column=column)}, "cpu")()
    np.testing.assert_array_equal(column.reshape(3, 8), x[:, None] + y)
    with pytest.raises(ValueError, match="add runs over 2 axes; dim is 3"):
        bind(add, 3, {}, "cpu")


def test_a_kernel_calls_the_functions_of_others():
    @kernel
    def twice(tid, launch: T.Launch, state: T.State, motion: T.Motion):
        """Moves a world by one factor, then by another."""
        move.func(tid, launch, 1.0, state, motion)
        state.force[tid] = state.velocity[tid]
        move.func(tid, launch, factor=3.0, state=state, motion=motion)

    given = arrays()
    launch = bind(twice, 4, given, "cpu")
    launch()
    assert "state.force" in {argument.name for argument in launch.arguments if argument.written}
    assert (given["state"].velocity == 0.1 * 3.0 * 0.1).all()


def test_each_thread_has_a_padding_body_of_its_own():
    @kernel
    def pad(tid, launch: T.Launch, stats: T.Stats):
        """Keeps the index of the padding body."""
        stats.sweeps[tid] = launch.padding_body

    sweeps = np.zeros(5, np.int32)
    values = {"launch": SimpleNamespace(padding_body=100), "stats": SimpleNamespace(sweeps=sweeps)}
    for threads, found in ((1, [100] * 5), (2, [100, 100, 100, 100 + PADDING, 100 + PADDING])):
        bind(pad, 5, {**values, "threads": threads}, "cpu")()
        assert sweeps.tolist() == found


def test_what_is_only_read_may_be_shared_and_read_only():
    given = arrays()
    x = frozen(np.arange(8, dtype=np.float32))
    column = aligned_zeros((64,), np.dtype(np.float64))
    bind(add, (8, 8), {"x": x, "y": x, "out": SimpleNamespace(column=column)}, "cpu")()
    assert column[9] == 2.0
    frozen(given["state"].force)
    bind(move, 4, given, "cpu")()


REFUSED = {
    "shared": (
        "state",
        "force",
        lambda s: s.velocity,
        "state.velocity and state.force share memory|and state.velocity",
    ),
    "overlapping": (
        "state",
        "time",
        lambda s: s.velocity.reshape(-1)[2:6],
        "state.velocity and state.time share memory",
    ),
    "strided": ("state", "time", lambda s: np.zeros(8)[::2], r"state.time has strides \(16,\)"),
    "read-only": ("state", "time", lambda s: frozen(np.zeros(4)), "state.time is read-only; it must be writable"),
    "another dtype": (
        "state",
        "time",
        lambda s: np.zeros(4, np.float32),
        "state.time has dtype float32; it must be float64",
    ),
    "an axis more": (
        "state",
        "time",
        lambda s: np.zeros((4, 1)),
        r"state.time has shape \(4, 1\); it must be \(any,\)",
    ),
    "long vectors": (
        "state",
        "force",
        lambda s: np.zeros((4, 3)),
        r"state.force has shape \(4, 3\); it must be \(any, 2\)",
    ),
    "a gradient": (
        "state",
        "force",
        lambda s: torch.zeros(4, 2, requires_grad=True),
        "state.force requires a gradient",
    ),
    "misaligned": (
        "motion",
        "predicted",
        lambda s: aligned_zeros((20,), np.dtype(np.float64))[2:18].reshape(4, 4),
        "motion.predicted lies at address .*; its vectors must lie at multiples of 32 bytes",
    ),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_memory_that_taichi_would_misuse_is_refused_by_name(case):
    group, field, make, message = REFUSED[case]
    given = arrays()
    setattr(given[group], field, make(given["state"]))
    with pytest.raises(ValueError, match=message):
        bind(move, 4, given, "cpu")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_structs_are_read_and_written_as_words(dtype):
    t, words = group_types(dtype), element_functions("iteration", dtype)

    @kernel
    def swap(tid, stats: t.Stats):
        """Exchanges the first two structs, and adds to the second."""
        one = words.load(stats.iteration, 0)
        two = words.load(stats.iteration, 1)
        one.sweeps += 1
        one.rate[2] += 0.1
        words.store(stats.iteration, 0, two)
        words.store(stats.iteration, 1, one)

    given = aligned_zeros((2,), struct_dtype(ITERATION, np.dtype(dtype)))
    draw = np.random.default_rng(5)
    for name in given.dtype.names:
        given[name] = draw.integers(-(2**31), 2**31, given[name].shape) / (1 if given[name].dtype.kind == "i" else 7.0)
    want = given[::-1].copy()
    want["sweeps"][1] += 1
    want["rate"][1, 2] += want["rate"].dtype.type(0.1)
    bind(swap, 1, {"stats": SimpleNamespace(iteration=given.view(np.recarray))}, "cpu")()
    for name in given.dtype.names:
        np.testing.assert_array_equal(given[name], want[name], err_msg=name)


def test_plain_calls_do_where_the_compiler_lacks_a_method(monkeypatch):
    def lacking(*given):
        raise AttributeError("make_launch_context")

    monkeypatch.setattr(launches, "_compile", lacking)
    given = arrays()
    launch = bind(move, 4, given, "cpu")
    launch()
    assert (given["state"].velocity == 0.1 * 3.0).all()


def test_a_group_must_be_taken_apart_or_passed_whole():
    def alias(tid, state: T.State):
        other = state
        other.time[tid] = 0.0

    with pytest.raises(TypeError, match="alias, line 2: the group state must be given to a function"):
        kernel(alias)


def test_a_recording_refuses_the_launch():
    launch = bind(move, 4, arrays(), "cpu")
    with wp.ScopedCapture(device="cpu"), pytest.raises(RuntimeError, match="move cannot be recorded in a graph"):
        launch()
