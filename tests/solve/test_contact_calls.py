"""The solver as a stage: calls on other engines' bodies and contacts, on the arrays that they lie in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus
from tests import backends
from tests.interrupting import interrupted
from tests.lending import Dlpack
from tests.solve.piles import DT, EXACT, arrays_of, drop, pile, used

# ---------------------------------------------------------------------- calls


@pytest.mark.parametrize("backend", backends.ALL)
def test_kept_rows_give_the_bits_of_a_whole_call(backend):
    sim = pile(worlds=2)
    one, two = arrays_of(sim), arrays_of(sim)
    config = dataclasses.replace(sim.config, max_sweeps=12)
    whole, kept = (dc.ContactSolver(**given, config=config, backend=backend) for given in (one, two))
    whole.solve(DT)
    kept.pack(DT)
    assert not np.shares_memory(kept.contacts.numpy("impulse"), two["impulse"])
    np.testing.assert_array_equal(two["velocity"], arrays_of(sim)["velocity"])  # nothing is solved yet
    for name in ("body_a", "normal", "gap", "inv_mass"):
        two[name][...] = 99  # kept rows do not look
    kept.solve(kept=True)
    for name in ("impulse", "velocity", "angular_velocity"):
        np.testing.assert_array_equal(one[name], two[name])
    kept.solve(kept=True)  # from the solution: little changes
    assert np.abs(two["velocity"] - one["velocity"]).max() < 0.1


def test_contacts_change_from_call_to_call_within_their_room():
    """A solver with more room than contacts, refilled step after step, does what one made anew would do."""
    sim = pile(worlds=3)
    first = arrays_of(sim)
    room = np.array([0, 80, 160, 240], np.int32)
    held = {name: np.zeros((240, *first[name].shape[1:]), first[name].dtype) for name in CONTACT_ARRAYS}
    bodies = {name: first[name].copy() for name in BODY_ARRAYS}
    rest = {"point": None, "body_start": first["body_start"], "length_scale": first["length_scale"]}
    rest |= {
        "weight": first["weight"],
        "gravity": first["gravity"],
        "config": sim.config,
        "count": np.zeros(3, np.int32),
    }
    solver = dc.ContactSolver(**held, **bodies, **rest, contact_start=room)
    counts = set()
    for _ in range(6):
        given = arrays_of(sim)
        for name, array in bodies.items():
            array[...] = given[name]
        rest["count"][...] = given["count"]
        counts |= set(given["count"].tolist())
        for w, n in enumerate(given["count"]):
            for name, array in held.items():
                array[room[w] : room[w] + n] = given[name][given["contact_start"][w] :][:n]
                array[room[w] + n : room[w + 1]] = -77  # what is beyond the count is not looked at
        stats = solver.solve(DT)
        sim.solve()
        slots = np.concatenate([room[w] + np.arange(n) for w, n in enumerate(given["count"])])
        np.testing.assert_array_equal(held["impulse"][slots], sim.contacts.numpy("impulse")[used(sim)])
        np.testing.assert_array_equal(stats.numpy("sweeps"), sim.stats.numpy("sweeps"))
        sim.advance()
        sim.collide(DT)
    assert len(counts) > 3


CONTACT_ARRAYS = (
    *("body_a", "body_b", "normal", "gap", "friction", "restitution"),
    *("arm_a", "arm_b", "impulse", "color"),
)
BODY_ARRAYS = ("inv_mass", "inv_inertia", "velocity", "angular_velocity", "velocity_before", "angular_velocity_before")


def as_torch(array):
    return pytest.importorskip("torch").from_numpy(array)


def as_warp(array):
    dtype = wp.dtype_from_numpy(array.dtype)
    if array.ndim > 1:
        dtype = wp.types.vector(array.shape[1], dtype)
    return wp.array(array, dtype=dtype, shape=(len(array),), device="cpu", copy=False)


@pytest.mark.parametrize("library", [as_torch, as_warp, Dlpack])
def test_arrays_of_other_libraries_are_used_where_they_lie(library):
    sim = pile(joints=True)
    one, two = arrays_of(sim), arrays_of(sim)
    dc.ContactSolver(**one).solve(DT)
    plain = ("point", "discs", "length_scale", "weight", "joints")
    wrapped = {
        name: array if name in plain or name.endswith("start") else library(array) for name, array in two.items()
    }
    wrapped["joints"] = {name: library(array) for name, array in two["joints"].items()}
    calls = ("velocity", "angular_velocity", "impulse")
    call = {name: wrapped.pop(name) for name in calls}
    dc.ContactSolver(**wrapped).solve(DT, **call)
    for name in (*calls, "color"):
        np.testing.assert_array_equal(one[name], two[name], err_msg=name)
    np.testing.assert_array_equal(one["joints"]["joint_impulse"], two["joints"]["joint_impulse"])


@pytest.mark.parametrize("backend", backends.ALL)
def test_arrays_may_be_others_at_each_call(backend):
    given = drop("float32")
    solver = dc.ContactSolver(**{k: v for k, v in given.items() if "velocity" not in k}, backend=backend)
    with pytest.raises(ValueError, match="velocity is missing"):
        solver.solve(DT)
    for speed in (1.0, 2.0, 3.0):
        velocity, impulse = np.array([[0, 0], [0, -speed]], np.float32), np.zeros((1, 2), np.float32)
        solver.solve(DT, velocity, np.zeros(2, np.float32), impulse)
        np.testing.assert_allclose(impulse[0], (2.0 * speed, 0.0), rtol=1e-6)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-6)
        velocity[1, 1] = -1.0
        solver.solve(kept=True)
        np.testing.assert_allclose(impulse[0], (2.0, 0.0), rtol=1e-6)
    before = {"velocity_before": np.float32([[0, 0], [0, -3]]), "angular_velocity_before": np.zeros(2, np.float32)}
    solver.contacts.numpy("restitution")[...] = 1.0
    velocity = np.array([[0, 0], [0, -1]], np.float32)
    solver.solve(DT, velocity, **before)
    np.testing.assert_allclose(velocity[1], (0.0, 3.0), rtol=1e-6)


@backends.NEEDS_TAICHI
def test_memory_that_taichi_cannot_load_vectors_from_is_refused_and_the_call_before_stands():
    given = drop("float32")
    solver = dc.ContactSolver(**given, backend="taichi")
    solver.solve(DT)
    shifted = np.zeros(5, np.float32)[1:].reshape(2, 2)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"exchange.velocity lies at address .* at multiples of 8 bytes"):
            solver.solve(DT, shifted)
    given["velocity"][1] = (0.0, -3.0)
    solver.solve(DT)
    np.testing.assert_allclose(given["velocity"][1], 0.0, atol=1e-6)


def test_a_tensor_may_have_other_memory_at_each_call():
    torch = pytest.importorskip("torch")
    solver = dc.ContactSolver(**{k: v for k, v in drop("float32").items() if "velocity" not in k})
    velocity, spin = torch.zeros(2, 2), torch.zeros(2)
    for speed in (1.0, 2.0):
        velocity.data = torch.tensor([[0.0, 0.0], [0.0, -speed]])
        solver.solve(DT, velocity, spin)
        np.testing.assert_allclose(velocity.numpy(), 0.0, atol=1e-6)


@backends.NEEDS_TAICHI
def test_taichi_has_no_delassus_problem_and_names_who_has():
    with pytest.raises(ValueError, match=r"backend is 'taichi', .* it must be one of \('warp', 'numpy'\)"):
        delassus.from_solver(dc.ContactSolver(**drop(), backend="taichi"), DT)


@backends.NEEDS_TAICHI
def test_taichi_ends_a_solve_of_endless_sweeps_where_it_is_interrupted():
    given = drop("float32")
    solver = dc.ContactSolver(**given, backend="taichi")
    solver.solve(DT)
    endless = dc.SolverConfig(min_sweeps=2**31 - 1, max_sweeps=2**31 - 1)
    with interrupted():
        solver.solve(DT, config=endless)
    assert solver.solve(DT).numpy("sweeps")[0] < 1000


def test_impulses_of_its_own_warm_start_the_next_call():
    given = drop()
    del given["impulse"]
    solver = dc.ContactSolver(**given, config=EXACT)
    solver.solve(DT)
    np.testing.assert_allclose(solver.exchange.numpy("impulse"), [[4.0, 0.0]], atol=1e-12)
    given["velocity"][1, 1] = -2.0
    solver.solve(kept=True)
    np.testing.assert_allclose(solver.exchange.numpy("impulse"), [[4.0, 0.0]], atol=1e-12)


def test_colours_are_kept_and_mended():
    sim = pile(worlds=1)
    given = arrays_of(sim)
    sim.solve()
    solver = dc.ContactSolver(**given)
    solver.solve(DT)
    slots = used(sim)
    np.testing.assert_array_equal(given["color"][slots], sim.contacts.numpy("color")[slots])
    given["color"][...] = 0  # all but one contact of a body are to change
    stats = solver.solve(DT)
    assert stats.numpy("residual")[0] < 1e-2
    moves = given["inv_mass"] > 0
    for body in np.flatnonzero(moves):
        at = slots[(given["body_a"][slots] == body) | (given["body_b"][slots] == body)]
        assert len(set(given["color"][at].tolist())) == len(at)
    given["color"][...] = 1000
    solver.solve(DT)
    assert given["color"][slots].max() < 20


def test_settings_of_one_solve_and_of_all():
    given = drop()
    solver = dc.ContactSolver(**given)
    assert solver.solve(DT, config=dataclasses.replace(solver.config, max_sweeps=3)).numpy("sweeps")[0] == 3
    with pytest.raises(ValueError, match=r"config.method is 'jacobi', the solver's is 'pgs'"):
        solver.solve(DT, config=dc.SolverConfig(method="jacobi"))
    solver.config = dc.SolverConfig(method="jacobi", history=True, max_sweeps=7, tolerance=0.0)
    with pytest.raises(ValueError, match="kept needs the rows"):
        solver.solve(kept=True)
    assert solver.solve(DT).numpy("sweeps")[0] == 7 and solver.stats.history.shape == (1, 7)
    with pytest.raises(TypeError, match="config is"):
        solver.config = 3
    with pytest.raises(TypeError, match="config is"):
        solver.solve(DT, config=3)


def test_a_call_becomes_part_of_a_graph():
    sim = pile(joints=True)
    one, two = arrays_of(sim), arrays_of(sim)
    alone, solver = dc.ContactSolver(**one), dc.ContactSolver(**two, threads=2)
    start = two["velocity"].copy()
    with wp.ScopedCapture(device="cpu") as capture:
        solver.solve(DT)
        solver.solve(kept=True)
    np.testing.assert_array_equal(two["velocity"], start)
    for _ in range(3):
        wp.capture_launch(capture.graph)
        alone.solve(DT)
        alone.solve(kept=True)
        for name in ("velocity", "angular_velocity", "impulse"):
            np.testing.assert_array_equal(one[name], two[name])
            one[name][...] *= 0.5
            two[name][...] *= 0.5
    two["velocity"][5] = np.nan
    before = two["impulse"].copy()
    wp.capture_launch(capture.graph)
    assert (solver.state.numpy("flags") != 0).tolist() == [True, False]
    first = two["contact_start"][1]
    np.testing.assert_array_equal(two["impulse"][:first], before[:first])
    assert (two["impulse"][first:] != before[first:]).any()
    for options in ({"backend": "numpy"}, {"schedule": "color"}):
        other = dc.ContactSolver(**arrays_of(sim), **options)
        with wp.ScopedCapture(device="cpu"), pytest.raises(RuntimeError, match="cannot be recorded"):
            other.solve(DT)


def test_a_graph_takes_the_arrays_of_its_call():
    given = drop("float32")
    solver = dc.ContactSolver(**given)
    solver.solve(DT)
    other = np.array([[0, 0], [0, -7]], np.float32)
    solver.solve(DT, np.array([[0, 0], [0, -5]], np.float32))  # bound to one array, pointed at a second
    with wp.ScopedCapture(device="cpu") as capture:
        solver.solve(DT, other)
    wp.capture_launch(capture.graph)
    np.testing.assert_allclose(other[1], 0.0, atol=1e-5)
    np.testing.assert_allclose(given["impulse"][0], (14.0, 0.0), rtol=1e-5)
