"""The solver as a stage: other engines' contacts give a simulation's bits, closed forms, another method's results."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.model.config import ACCELERATIONS
from tests import backends
from tests.solve.piles import DT, EXACT, arrays_of, drop, pile, used


def assert_solved_alike(sim, given, stats):
    """Impulses, velocities and reports have the bits of the simulation's."""
    slots, bodies = used(sim), sim.model.body_count
    np.testing.assert_array_equal(given["impulse"][slots], sim.contacts.numpy("impulse")[slots])
    solved = sim.motion.numpy("solved")[:bodies]
    np.testing.assert_array_equal(given["velocity"], solved[:, :2])
    np.testing.assert_array_equal(given["angular_velocity"], solved[:, 2])
    for name in ("sweeps", "change", "residual"):
        np.testing.assert_array_equal(stats.numpy(name), sim.stats.numpy(name), err_msg=name)
    if sim.model.joint_count:
        np.testing.assert_array_equal(given["joints"]["joint_impulse"], sim.joints.numpy("joint_impulse"))


@pytest.mark.parametrize(
    ("dtype", "options", "backend"),
    [
        ("float32", {}, "warp"),
        ("float64", {}, "warp"),
        ("float32", {"discs": True}, "warp"),
        ("float32", {"joints": True}, "warp"),
        ("float64", {"joints": True}, "warp"),
        pytest.param("float32", {}, "taichi", marks=backends.NEEDS_TAICHI),
        pytest.param("float64", {"joints": True}, "taichi", marks=backends.NEEDS_TAICHI),
    ],
)
def test_a_simulations_contacts_give_its_bits(dtype, options, backend):
    sim = pile(dtype, **options)
    given = arrays_of(sim)
    for name in ("arm_a", "arm_b", "normal", "inv_mass"):  # which are only read
        given[name].flags.writeable = False
    solver = dc.ContactSolver(**given, config=sim.config, backend=backend)
    sim.solve()
    stats = solver.solve(DT)
    assert stats.numpy("sweeps").min() >= 10 and stats is solver.stats
    assert_solved_alike(sim, given, stats)


@pytest.mark.parametrize("backend", backends.COMPILED)
@pytest.mark.parametrize("acceleration", list(ACCELERATIONS))
@pytest.mark.parametrize("method", ["pgs", "jacobi"])
def test_all_methods_give_a_simulations_bits(method, acceleration, backend):
    config = dc.SolverConfig(method=method, acceleration=acceleration, omega=0.9, max_sweeps=60, tolerance=1e-6)
    sim = pile(config=config)
    given = arrays_of(sim, warm=False)
    sim.contacts.assign("impulse", np.zeros_like(sim.contacts.numpy("impulse")))
    sim.solve()
    assert_solved_alike(sim, given, dc.ContactSolver(**given, config=config, backend=backend).solve(DT))


@pytest.mark.parametrize("backend", backends.COMPILED)
@pytest.mark.parametrize("options", [{"schedule": "color"}, {"threads": 2}])
def test_schedules_and_threads_give_the_same_bits(monkeypatch, options, backend):
    monkeypatch.setattr("dc_kernels.runtime.stepping.WORTH_THREADS", 0)
    sim = pile(worlds=5, joints=True)
    given = arrays_of(sim)
    solver = dc.ContactSolver(**given, config=sim.config, backend=backend, **options)
    sim.solve()
    assert_solved_alike(sim, given, solver.solve(DT))


def test_the_oracle_agrees():
    sim = pile("float64", joints=True)
    one, two = arrays_of(sim), arrays_of(sim)
    config = dataclasses.replace(sim.config, max_sweeps=30, tolerance=0.0)
    dc.ContactSolver(**one, config=config).solve(DT)
    dc.ContactSolver(**two, config=config, backend="numpy").solve(DT)
    for name in ("impulse", "velocity", "angular_velocity"):
        np.testing.assert_allclose(two[name], one[name], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(two["color"], one["color"])
    assert np.abs(one["impulse"]).max() > 0.01


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize(
    ("changes", "velocity", "impulse"),
    [
        ({}, (1.5, 0.0), (4.0, 0.0)),
        ({"friction": 0.25}, (1.0, 0.0), (4.0, -1.0)),  # slides: the tangent is (n_y, -n_x) = (1, 0)
        ({"friction": 1.0}, (0.0, 0.0), (4.0, -3.0)),  # sticks
        ({"restitution": 0.5, "gravity": 9.81}, (1.5, 1.0), (6.0, 0.0)),
        ({"gap": np.array([0.01])}, (1.5, -1.0), (2.0, 0.0)),  # the gap may close in a step of 0.01 s
        ({"gap": np.array([0.03])}, (1.5, -2.0), (0.0, 0.0)),
        ({"inv_mass": np.zeros(2)}, (1.5, -2.0), (0.0, 0.0)),  # nothing moves
    ],
)
def test_one_contact_in_closed_form(dtype, changes, velocity, impulse):
    changes = {name: v.astype(dtype) if isinstance(v, np.ndarray) else v for name, v in changes.items()}
    given = drop(dtype, **changes)
    dc.ContactSolver(**given, config=EXACT).solve(DT)
    bound = 1e-12 if dtype == "float64" else 1e-6
    np.testing.assert_allclose(given["velocity"][1], velocity, atol=bound)
    np.testing.assert_allclose(given["impulse"][0], impulse, atol=4 * bound)
    np.testing.assert_array_equal(given["velocity"][0], 0.0)


@pytest.mark.parametrize("backend", backends.ALL)
@pytest.mark.parametrize("acceleration", ["none", "adaptive"])
def test_no_impulse_stays_where_nothing_moves(acceleration, backend):
    """What a start gives to a contact of two immovable bodies no sweep would mend."""
    given = drop("float32", inv_mass=np.zeros(2, np.float32), impulse=np.array([[5, 1]], np.float32))
    config = dc.SolverConfig(acceleration=acceleration)
    stats = dc.ContactSolver(**given, friction=0.5, config=config, backend=backend).solve(DT)
    np.testing.assert_array_equal(given["impulse"], 0.0)
    np.testing.assert_array_equal(given["velocity"][1], (1.5, -2.0))
    assert stats.numpy("residual")[0] == 0.0


def test_a_rolling_disc_in_closed_form():
    """A disc that slides without rolling, of inertia m r^2 / 2, rolls with 2/3 of its speed where friction suffices."""
    given = drop(point=np.array([[0.0, -0.5]]), inv_inertia=np.array([0.0, 1.0 / (2.0 * 0.125)]), friction=5.0)
    dc.ContactSolver(**given, config=EXACT, discs=True).solve(DT)
    np.testing.assert_allclose(given["velocity"][1], (1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(given["angular_velocity"][1], -1.0 / 0.5, atol=1e-12)


def test_a_bounce_goes_by_the_velocity_before_the_forces():
    given = drop(velocity_before=np.array([[0.0, 0.0], [1.5, -3.0]]), angular_velocity_before=np.zeros(2))
    dc.ContactSolver(**given, restitution=0.5, gravity=9.81, config=EXACT).solve(DT)
    np.testing.assert_allclose(given["velocity"][1], (1.5, 1.5), atol=1e-12)


@pytest.mark.parametrize("restitution", [0.5, np.float32(0.1), np.zeros(1), np.ones(1)], ids=str)
def test_bounces_need_gravity(restitution):
    """An array may come to hold any coefficient, as it is read at each call."""
    with pytest.raises(
        ValueError, match=r"gravity is None; it must be given .* unless restitution is the number 0 or 1"
    ):
        dc.ContactSolver(**drop(), restitution=restitution)
    for gravity in (0.0, 9.81, np.full(1, 9.81)):
        dc.ContactSolver(**drop(), restitution=restitution, gravity=gravity)


@pytest.mark.parametrize(("gravity", "bounces"), [(0.0, True), (9.81, False)])
def test_what_rests_under_gravity_does_not_bounce(gravity, bounces):
    """A step's fall of 0.1 m/s is far below 0.32 sqrt(gravity length_scale) = 1 m/s."""
    given = drop(velocity=np.array([[0.0, 0.0], [0.0, -0.1]]))
    dc.ContactSolver(**given, restitution=0.5, gravity=gravity, config=EXACT).solve(DT)
    np.testing.assert_allclose(given["velocity"][1, 1], 0.05 if bounces else 0.0, atol=1e-12)


@pytest.mark.parametrize("restitution", [0, 0.0, 1, 1.0, np.float32(1.0)])
def test_numbers_at_which_no_threshold_matters_need_no_gravity(restitution):
    given = drop()
    dc.ContactSolver(**given, restitution=restitution, config=EXACT).solve(DT)
    np.testing.assert_allclose(given["velocity"][1, 1], restitution * 2.0, atol=1e-12)


def test_a_joint_in_closed_form():
    """Two masses, 2 and 1 kg, that a joint holds apart: along it they end with the velocity of their centre of mass."""
    given = drop(
        inv_mass=np.array([0.5, 1.0]),
        velocity=np.array([[0.0, 1.0], [3.0, -1.0]]),
        position=np.array([[0.0, 0.0], [2.0, 0.0]]),
        angle=np.zeros(2),
        count=np.zeros(1, np.int32),
        joints={
            "joint_body_a": np.zeros(1, np.int32),
            "joint_body_b": np.ones(1, np.int32),
            "joint_anchor_a": np.zeros((1, 2)),
            "joint_anchor_b": np.zeros((1, 2)),
            "joint_length": np.full(1, 2.0),
            "joint_impulse": np.zeros(1),
        },
    )
    solver = dc.ContactSolver(**given, config=EXACT)
    solver.solve(1e-9)  # so short that the line does not turn
    np.testing.assert_allclose(given["velocity"], [[1.0, 1.0], [1.0, -1.0]], atol=1e-8)
    np.testing.assert_allclose(given["joints"]["joint_impulse"], -2.0, atol=1e-8)


def test_pivots_find_the_same_velocities():
    """The contacts in Delassus form, solved there, against the sweeps; impulses of redundant contacts may differ."""
    sim = pile("float64", joints=True)
    given = arrays_of(sim)
    positional = [given.pop(name) for name in ("body_a", "body_b", "point", "normal", "gap")]
    problem = delassus.from_contacts(*positional, dt=DT, world=1, **given)
    for name in ("row_start", "column", "block", "q", "mu", "slot"):
        np.testing.assert_array_equal(getattr(problem, name), getattr(delassus.from_world(sim, 1), name))
    kept = dc.ContactSolver(*positional, **given)
    for _ in range(2):  # the second time of arrays that have changed
        again = delassus.from_solver(kept, DT, world=1)
        np.testing.assert_array_equal(again.block, problem.block)
        np.testing.assert_array_equal(again.q[:, 1] - problem.q[:, 1], 0.0)
        given["inv_mass"] *= 2.0
        given["inv_inertia"] *= 2.0
        problem = dataclasses.replace(problem, block=2.0 * problem.block)
    given["inv_mass"] *= 0.25
    given["inv_inertia"] *= 0.25
    problem = dataclasses.replace(problem, block=0.25 * problem.block)
    with pytest.raises(TypeError, match=r"solver is .*; it must be a ContactSolver"):
        delassus.from_solver(sim, DT)
    wanted = delassus.solve(problem, tolerance=1e-11)
    assert wanted.converged
    config = dataclasses.replace(sim.config, tolerance=1e-13, max_sweeps=20_000)
    solver = dc.ContactSolver(*positional, **given, config=config)
    solver.solve(DT)
    found = np.zeros((problem.count, 2))
    found[~problem.bilateral] = given["impulse"][problem.slot[~problem.bilateral]]
    found[problem.bilateral, 0] = given["joints"]["joint_impulse"][problem.slot[problem.bilateral]]
    np.testing.assert_allclose(problem.velocity(found), problem.velocity(wanted.impulses), atol=1e-7)
