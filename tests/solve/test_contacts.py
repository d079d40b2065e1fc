"""The solver as a stage: other engines' bodies and contacts, on the arrays that they lie in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.model.config import ACCELERATIONS
from tests import backends
from tests.interrupting import interrupted
from tests.lending import Dlpack

DT = 0.01


def pile(dtype="float32", worlds=2, joints=False, discs=False, **options):
    """A simulation between ``collide`` and ``solve``: shapes fallen on a ground, some of them joined."""
    builder = dc.ModelBuilder()
    for w in range(worlds):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 6.0, 0.5, center=(0.0, -0.5), friction=0.6)
        rng = np.random.default_rng(w)
        before = None
        for i in range(12 + 5 * w):
            at = (-2.0 + 1.02 * (i % 4) + rng.uniform(-0.02, 0.02), 0.52 + 1.03 * (i // 4))
            body = builder.add_body(position=at, velocity=(rng.uniform(-1, 1), -1.0))
            if discs or i % 2:
                builder.add_disc(body, 0.5, friction=0.4, restitution=0.3 * (i % 3))
            else:
                builder.add_box(body, 0.45, 0.5, friction=0.7)
            if joints and before is not None and i % 3 == 0:
                builder.add_distance_joint(before, body, (0.1, 0.2), (-0.2, 0.1))
            before = body
    model, state, groups = builder.finalize(dtype=dtype)
    sim = dc.Simulation(model, state, groups, **options)
    sim.run(25, DT)
    sim.collide(DT)
    return sim


def arrays_of(sim, warm=True):
    """What a simulation's contacts, bodies and joints are for a ``ContactSolver``, all of it copied."""
    contacts, model, state = sim.contacts, sim.model, sim.state
    names = ("body_a", "body_b", "normal", "gap", "friction", "restitution", "arm_a", "arm_b", "impulse", "color")
    found = {name: contacts.numpy(name).copy() for name in names}
    if not warm:
        found["impulse"][...] = 0.0
    found |= {
        "point": None,
        "inv_mass": model.numpy("inv_mass").copy(),
        "inv_inertia": model.numpy("inv_inertia").copy(),
        "count": contacts.numpy("contact_count").copy(),
        "contact_start": contacts.numpy("contact_start").copy(),
        "body_start": model.numpy("body_start").copy(),
        "velocity": sim.motion.numpy("predicted")[: model.body_count, :2].copy(),
        "angular_velocity": sim.motion.numpy("predicted")[: model.body_count, 2].copy(),
        "velocity_before": state.numpy("velocity").copy(),
        "angular_velocity_before": state.numpy("angular_velocity").copy(),
        "length_scale": model.numpy("length_scale").copy(),
        "weight": sim.motion.numpy("weight").copy(),
        "gravity": np.hypot(*model.numpy("gravity").T),
        "discs": sim.variant == "discs",
    }
    if model.joint_count:
        found["position"], found["angle"] = state.numpy("position").copy(), state.numpy("angle").copy()
        lines = ("body_a", "body_b", "anchor_a", "anchor_b", "length", "impulse")
        found["joints"] = {f"joint_{name}": sim.joints.numpy(f"joint_{name}").copy() for name in lines}
        found["joint_start"] = model.numpy("joint_start").copy()
    return found


def used(sim):
    """Slots of the contacts."""
    start, count = sim.contacts.numpy("contact_start"), sim.contacts.numpy("contact_count")
    return np.concatenate([np.arange(a, a + n) for a, n in zip(start, count)])


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


# ---------------------------------------------------------------------- closed forms and another method


def drop(dtype="float64", **changes):
    """A point mass of 2 kg that falls on the ground, body 0, at (1.5, -2) m/s; arguments by name."""
    real = np.dtype(dtype)
    found = {
        "body_a": np.zeros(1, np.int32),
        "body_b": np.ones(1, np.int32),
        "point": np.zeros((1, 2), real),
        "normal": np.array([[0, 1]], real),
        "gap": np.zeros(1, real),
        "inv_mass": np.array([0, 0.5], real),
        "inv_inertia": np.zeros(2, real),
        "position": np.zeros((2, 2), real),
        "velocity": np.array([[0, 0], [1.5, -2]], real),
        "angular_velocity": np.zeros(2, real),
        "impulse": np.zeros((1, 2), real),
    }
    return found | changes


EXACT = dc.SolverConfig(tolerance=1e-13)


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


# ---------------------------------------------------------------------- bad input


@pytest.mark.parametrize("backend", backends.ALL)
@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("body_a", 0, 9, r"body_a\[0\] is 9; it must be a body of its world 0 \(bodies 0 .. 1\)"),
        ("body_b", 0, -1, r"body_b\[0\] is -1; it must be a body of its world"),
        ("body_b", 0, 0, r"body_b\[0\] is 0; it must be another body than body A"),
        ("normal", (0, 1), 2.0, r"normal\[0\] is \(0.0, 2.0\); it must be a unit vector"),
        ("normal", (0, 1), np.nan, r"normal\[0\] is \(0.0, nan\); it must be a unit vector"),
        ("point", (0, 1), np.inf, r"point\[0, 1\] is inf; it must be finite"),
        ("gap", 0, np.nan, r"gap\[0\] is nan; it must be finite"),
        ("friction", 0, -0.1, r"friction\[0\] is -0.1; it must be finite and >= 0"),
        ("restitution", 0, 1.5, r"restitution\[0\] is 1.5; it must be in \[0, 1\]"),
        ("inv_mass", 1, -1.0, r"inv_mass\[1\] is -1.0; it must be in \[0, 8e\+37\]"),
        ("inv_mass", 1, 1e38, r"inv_mass\[1\] is 1e\+38; it must be in \[0, 8e\+37\]"),
        ("inv_inertia", 0, np.inf, r"inv_inertia\[0\] is inf; it must be in \[0, 8e\+37\]"),
        ("position", (1, 0), np.nan, r"position\[1, 0\] is nan; it must be finite"),
        ("velocity", (1, 0), np.nan, r"velocity\[1, 0\] is nan; it must be finite"),
        ("angular_velocity", 1, np.inf, r"angular_velocity\[1\] is inf; it must be finite"),
        ("impulse", (0, 0), np.nan, r"impulse\[0, 0\] is nan; it must be finite"),
        ("count", 0, 2, r"count\[0\] is 2; it must lie in \[0, 1\], the room of world 0"),
        ("count", 0, -1, r"count\[0\] is -1; it must lie in \[0, 1\]"),
    ],
)
def test_values_out_of_range_are_named_and_nothing_is_written(name, index, value, message, backend):
    given = drop(friction=np.full(1, 0.5), restitution=np.zeros(1), count=np.ones(1, np.int32))
    solver = dc.ContactSolver(**given, gravity=9.81, backend=backend)
    good = given[name][index]
    given[name][index] = value
    before = {key: array.copy() for key, array in given.items()}
    with pytest.raises(ValueError, match=message):
        solver.solve(DT)
    for key, array in given.items():
        np.testing.assert_array_equal(array, before[key])
    given[name][index] = good
    solver.solve(DT)
    np.testing.assert_allclose(given["velocity"][1], (0.5, 0.0), atol=1e-3)


def test_a_disc_has_no_normal_arm():
    given = drop(point=np.array([[0.1, -0.5]]), inv_inertia=np.ones(2))
    with pytest.raises(ValueError, match="discs is True, but a contact of world 0 has an arm"):
        dc.ContactSolver(**given, discs=True).solve(DT)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"normal": np.zeros((1, 2), int)}, "normal has dtype int64; it must be float32 or float64"),
        ({"normal": np.zeros((1, 3))}, r"normal has shape \(1, 3\); it must be \(1, 2\)"),
        ({"body_a": np.zeros(1, np.int64)}, "body_a has dtype int64; it must be int32"),
        ({"gap": np.zeros(1, np.float32)}, "gap has dtype float32; it must be float64"),
        ({"inv_mass": np.zeros(4)[::2]}, "inv_mass has strides"),
        ({"impulse": np.zeros((3, 2))}, r"impulse has shape \(3, 2\); it must be \(1, 2\)"),
        ({"velocity": np.broadcast_to(0.0, (2, 2))}, "velocity has strides"),
        ({"point": None}, "either point or both of arm_a and arm_b"),
        ({"arm_a": np.zeros((1, 2))}, "either point or both"),
        ({"position": None}, "point needs position"),
        ({"body_start": [0, 3]}, r"body_start\[1\] is 3; it must be"),
        ({"body_start": [0, 1, 2]}, "contact_start is of 1 worlds, body_start of 2"),
        ({"length_scale": 0.0}, r"length_scale\[0\] is 0.0; it must be finite and > 0"),
        ({"weight": np.ones(3)}, r"weight has shape \(3,\)"),
        ({"schedule": "lanes"}, "schedule is 'lanes'"),
        ({"backend": "cuda"}, "backend is 'cuda'"),
        ({"threads": 0}, "threads is 0"),
        ({"friction": "high"}, "friction"),
        ({"friction": -1.0}, "^friction is -1.0; it must be finite and >= 0"),
        ({"restitution": 1.5, "gravity": 9.8}, r"^restitution is 1.5; it must be in \[0, 1\]"),
        ({"joints": {"joint_body_a": np.zeros(1, np.int32)}}, "joints need position and angle"),
        ({"joints": {"spring": 1}, "angle": np.zeros(2)}, "spring is unknown; joints have joint_body_a, .* as rows"),
        ({"joints": {"joint_frequency": np.ones(1)}, "angle": np.zeros(2)}, "joint_frequency is unknown; joints have"),
        ({"joints": [3], "angle": np.zeros(2)}, r"joints is a list; it must be a Mapping"),
        ({"config": dc.SolverConfig(contact_events=True)}, "contact_events is True; only a Simulation tells of events"),
        ({"config": dc.SolverConfig(contact_switches=True)}, "contact_switches is True; only a Simulation"),
        ({"velocity_before": np.zeros((2, 2))}, "velocity_before and angular_velocity_before go together"),
    ],
)
def test_arguments_are_checked_when_they_are_given(changes, message):
    with pytest.raises(ValueError, match=message):
        dc.ContactSolver(**drop(**changes)).solve(DT)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, None, "1"])
def test_time_steps_are_checked(dt):
    with pytest.raises(ValueError, match="dt is"):
        dc.ContactSolver(**drop()).solve(dt)


def test_no_contacts_and_no_worlds():
    given = drop()
    empty = {name: np.zeros((0, *given[name].shape[1:]), given[name].dtype) for name in CONTACTS_ONLY}
    solver = dc.ContactSolver(**(given | empty))
    assert solver.solve(DT).numpy("sweeps")[0] == 0
    np.testing.assert_array_equal(given["velocity"][1], (1.5, -2.0))
    nothing = {name: array[:0].copy() for name, array in given.items()} | empty
    none = dc.ContactSolver(**nothing, body_start=[0], contact_start=[0])
    assert len(none.solve(DT, np.zeros((0, 2))).numpy("sweeps")) == 0


CONTACTS_ONLY = ("body_a", "body_b", "point", "normal", "gap", "impulse")


def test_whatever_stands_in_any_array_is_named_or_harmless():
    """Wrong numbers put into any array at random: an error that names an array, or finite velocities."""
    draw = np.random.default_rng(5)
    good = arrays_of(pile(joints=True))
    fixed = ("contact_start", "body_start", "joint_start", "length_scale", "weight", "gravity")
    held = {name: array.copy() if isinstance(array, np.ndarray) else array for name, array in good.items()}
    held["joints"] = {name: array.copy() for name, array in good["joints"].items()}
    solver = dc.ContactSolver(**held)
    arrays = {name: array for name, array in held.items() if isinstance(array, np.ndarray) and name not in fixed}
    arrays |= held["joints"]
    named = set()
    for _ in range(300):
        for name, array in arrays.items():
            array[...] = {**good, **good["joints"]}[name]
        for name in draw.choice(list(arrays), 2):
            place = tuple(draw.integers(0, n) for n in arrays[name].shape)
            numbers = [-(2**31), 2**31 - 1, -1, 0, 63, 64, 200]
            odd = numbers if arrays[name].dtype.kind == "i" else [np.nan, np.inf, -np.inf, 1e38, -1.0, 0.0, -1e30]
            arrays[name][place] = draw.choice(odd)
        try:
            solver.solve(DT)
            solver.solve(kept=True)
        except ValueError as error:
            # a place or an anchor of 1e38 is a number: what becomes of it is found out
            named.add("ran off" if "ran off" in str(error) else str(error).split("[")[0])
        else:
            assert np.isfinite(held["velocity"]).all() and all(
                np.isfinite(held["impulse"][a : a + n]).all() for a, n in zip(held["contact_start"], held["count"])
            )
    assert len(named) > 15 and named <= {*arrays, "ran off"}


@pytest.mark.parametrize(
    ("name", "other"), [("impulse", "point"), ("velocity", "position"), ("angular_velocity", "inv_inertia")]
)
def test_what_is_written_shares_no_memory_with_what_is_read(name, other):
    given = drop()
    given[other] = given[name]
    before = given[name].copy()
    with pytest.raises(ValueError, match=f"{name} shares memory with {other}; it is written to"):
        dc.ContactSolver(**given).solve(DT)
    np.testing.assert_array_equal(given[name], before)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gap": None}, "gap is missing; it must be an array"),
        ({"inv_inertia": 0.5}, r"inv_inertia is a float; it must be a numpy array"),
        ({"point": True}, r"point is a bool; it must be a numpy array"),
        ({"gap": np.ma.masked_array(np.zeros(1), [True])}, "gap is a MaskedArray; it must be a numpy array"),
        ({"friction": 10**400}, r"friction is 1000.*; it"),
        ({"length_scale": "12"}, r"length_scale is '12'; it must be a number or have shape \(1,\)"),
        ({"body_start": 2.5}, r"body_start is 2\.5; it must"),
        (
            {"joints": {"joint_body_a": np.zeros(1, np.int32)}, "angle": np.zeros(2)},
            "joint_body_b is missing; it must be an array",
        ),
    ],
)
def test_what_is_no_array_is_refused(changes, message):
    with pytest.raises((ValueError, TypeError, OverflowError), match=message):
        dc.ContactSolver(**drop(**changes)).solve(DT)


def test_arrays_of_a_call_share_no_memory():
    solver, spin, whole = dc.ContactSolver(**drop()), np.zeros(2), np.zeros((3, 2))
    with pytest.raises(ValueError, match="impulse shares memory with velocity; it is written to"):
        solver.solve(DT, whole[:2], impulse=whole[1:2])
    velocity = whole[:2]
    solver.solve(DT, velocity, spin, whole[2:], velocity_before=velocity, angular_velocity_before=spin)
