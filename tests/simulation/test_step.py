"""Stepping: phases, growing capacity, worlds that blow up, snapshots, far-away worlds, kinds of bodies."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import measure
from dc_kernels.runtime import stepping
from dc_kernels.runtime.sequences import Rounds

DT = 0.01
GROUND = ((-2.0, 4.0), (-2.0, 0.0), (2.0, 0.0), (2.0, 4.0))
STATE = ("position", "angle", "velocity", "angular_velocity")


def add_world(builder, seed, count=16, origin=(0.0, 0.0)):
    """Discs that fall into a box of segments; returns the first disc's body."""
    rng = np.random.default_rng(seed)
    builder.add_world(origin=origin)
    ground = builder.add_body(origin, type=dc.BodyType.STATIC)
    builder.add_chain(ground, GROUND)
    x, y = rng.uniform(-1.6, 1.6, count), 0.25 + 0.11 * np.arange(count)
    positions = np.stack((x, y), axis=1) + origin
    return int(builder.add_discs(positions, rng.uniform(0.12, 0.2, count), friction=0.4)[0])


def simulation(seeds=(0, 1, 2), dtype="float32", count=16, **options):
    builder = dc.ModelBuilder()
    for seed in seeds:
        add_world(builder, seed, count)
    return dc.Simulation(*builder.finalize(dtype), **options)


def of_world(sim, w):
    """What a world is: its state, time, and contacts with their impulses, as bytes; -0 counts as 0."""
    first, last = sim.model.numpy("body_start")[w : w + 2]
    arrays = [sim.state.numpy(name)[first:last] for name in STATE]
    slots, world = measure.contact_slots(sim.contacts)
    arrays += [sim.contacts.numpy(name)[slots[world == w]] for name in ("key", "impulse", "color", "age")]
    arrays.append(sim.state.numpy("time")[w : w + 1])
    return [(a + np.zeros(1, a.dtype)).tobytes() for a in arrays]


def all_worlds(sim):
    return [of_world(sim, w) for w in range(sim.model.world_count)]


# ---------------------------------------------------------------- capacity


@pytest.mark.parametrize("options", [{}, {"threads": 2}, {"schedule": "color"}])
def test_growing_equals_having_had_the_room(options):
    roomy = simulation(pairs_per_shape=50.0, contacts_per_body=50.0)
    reserved = roomy.capacity()
    roomy.run(120, DT)
    assert {k: v["reserved"] for k, v in roomy.capacity().items()} == {k: v["reserved"] for k, v in reserved.items()}
    tight = simulation(pairs_per_shape=0.0, contacts_per_body=0.0, **options)
    assert tight.capacity()["contacts"]["reserved"] == 0
    tight.run(120, DT)
    assert all_worlds(tight) == all_worlds(roomy)
    assert not tight.state.numpy("flags").any()
    for use in tight.capacity().values():
        assert use["reserved"] >= use["used"] > 0
        assert use["peak_of_a_world"] <= use["reserved"]


@pytest.mark.parametrize(("field", "value"), [("pairs_per_shape", "pairs"), ("contacts_per_body", "contacts")])
def test_overflow_raises_and_keeps_the_state(field, value):
    sim = simulation(on_overflow="raise", **{field: 0.5})
    steps = 0
    with pytest.raises(OverflowError, match=rf"world \d needs \d+ {value}, \d+ are reserved"):
        while True:
            before = [sim.state.numpy(name).copy() for name in (*STATE, "time", "flags")]
            sim.step(DT)
            steps += 1
    for name, values in zip((*STATE, "time", "flags"), before):
        assert (sim.state.numpy(name) == values).all(), name
    np.testing.assert_allclose(sim.state.numpy("time"), steps * DT, rtol=1e-5)
    with pytest.raises(OverflowError):  # it says so each time
        sim.step(DT)
    # with room, the run goes on as if nothing had been
    sim.on_overflow = "grow"
    sim.run(100 - steps, DT)
    reference = simulation()
    reference.run(100, DT)
    assert all_worlds(sim) == all_worlds(reference)


def test_overflow_in_one_shard_stops_the_others_too():
    """The step was not taken: also not by worlds that another thread runs."""
    builder = dc.ModelBuilder()
    add_world(builder, 0, count=1)
    add_world(builder, 1, count=20)
    sim = dc.Simulation(*builder.finalize("float32"), threads=2, on_overflow="raise", pairs_per_shape=0.4)
    before = all_worlds(sim)
    with pytest.raises(OverflowError, match="world 1"):
        sim.step(DT)
    assert all_worlds(sim) == before


# ---------------------------------------------------------------- worlds that blow up


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["velocity", "angular_velocity", "force", "position", "angle"])
def test_a_world_that_is_not_finite_is_flagged_and_frozen(name, value):
    sim, reference = (simulation() for _ in range(2))
    for s in (sim, reference):
        s.run(30, DT)
    body = int(sim.model.numpy("body_start")[1]) + 3
    sim.state.numpy(name)[body] = value
    frozen = of_world(sim, 1)
    for s in (sim, reference):
        s.run(30, DT)
    assert sim.state.numpy("flags").tolist() == [0, dc.Flag.NONFINITE, 0]
    after = of_world(sim, 1)
    assert after[:4] == frozen[:4]  # state
    assert after[-1] == frozen[-1]  # time
    assert [of_world(sim, w) for w in (0, 2)] == [of_world(reference, w) for w in (0, 2)]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_huge_velocities_end_in_a_flag_at_a_finite_state(dtype):
    sim, reference = (simulation(dtype=dtype) for _ in range(2))
    body = int(sim.model.numpy("body_start")[1]) + 3
    sim.state.numpy("velocity")[body] = np.finfo(dtype).max / 2
    sim.state.numpy("force")[body] = np.finfo(dtype).max / 2
    for s in (sim, reference):
        s.run(200, DT)
    assert sim.state.numpy("flags").tolist() == [0, dc.Flag.NONFINITE, 0]
    for name in STATE:
        assert np.isfinite(sim.state.numpy(name)).all(), name
    assert [of_world(sim, w) for w in (0, 2)] == [of_world(reference, w) for w in (0, 2)]


@pytest.mark.parametrize("speed", [1e4, 1e9, 1e15])
def test_fast_bodies_cost_no_more_than_others(speed):
    """A body that leaves at any speed neither hangs the broadphase nor asks for room."""
    sim = simulation()
    body = int(sim.model.numpy("body_start")[1]) + 3
    sim.state.numpy("velocity")[body] = (0.0, speed)
    sim.run(20, DT)
    assert sim.state.numpy("flags")[[0, 2]].tolist() == [0, 0]
    assert sim.capacity()["pairs"]["peak_of_a_world"] <= 19 * 18 / 2
    assert np.isfinite(sim.state.numpy("position")).all()


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize("dt", [0.0, -0.01, float("nan"), float("inf"), 1e-60])
def test_time_steps_that_make_no_sense(dt):
    sim = simulation(seeds=(0,))
    before = all_worlds(sim)
    for call in (lambda: sim.step(dt), lambda: sim.run(3, dt), lambda: sim.collide(dt)):
        with pytest.raises(ValueError, match="dt is"):
            call()
    assert all_worlds(sim) == before


@pytest.mark.parametrize("dt", [[DT, 0.0], [DT, np.nan], [DT], [[DT, DT]]])
def test_time_steps_of_worlds_that_make_no_sense(dt):
    sim = simulation(seeds=(0, 1))
    before = all_worlds(sim)
    with pytest.raises(ValueError, match=r"dt\[1\] is|dt has shape"):
        sim.collide(np.array(dt))
    assert all_worlds(sim) == before


def test_each_world_may_have_a_time_step_of_its_own():
    steps = np.array([DT, 0.5 * DT])
    both, alone = simulation(seeds=(0, 1)), [simulation(seeds=(seed,)) for seed in (0, 1)]
    for _ in range(80):
        both.collide(steps)
        both.solve()
        both.advance()
    for sim, dt in zip(alone, steps.tolist(), strict=True):
        sim.run(80, dt)
    assert [of_world(both, w) for w in (0, 1)] == [of_world(sim, 0) for sim in alone]


def test_negative_number_of_steps():
    with pytest.raises(ValueError, match="steps is -1"):
        simulation(seeds=(0,)).run(-1, DT)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threads": 0}, "threads is 0"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"schedule": "body"}, "schedule is 'body'"),
        ({"on_overflow": "ignore"}, "on_overflow is 'ignore'"),
        ({"pairs_per_shape": -1.0}, "pairs_per_shape is -1.0"),
        ({"contacts_per_body": float("nan")}, "contacts_per_body is nan"),
    ],
)
def test_options_out_of_range_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        simulation(seeds=(0,), **options)


def test_arrays_of_another_model_dtype_or_backend():
    builder, other = dc.ModelBuilder(), dc.ModelBuilder()
    add_world(builder, 0)
    add_world(other, 0, count=5)
    model, state, joints = builder.finalize("float32")
    for groups, message in (
        (builder.finalize("float64"), "state.dtype is float64"),
        (builder.finalize("float32", backend="numpy"), "state.backend is numpy"),
        (other.finalize("float32"), "state has 6 on axis 'body'; it must be the model's 17"),
    ):
        with pytest.raises(ValueError, match=message):
            dc.Simulation(model, groups[1], joints)
    with pytest.raises(ValueError, match=r"joints\.dtype is float64"):
        dc.Simulation(model, state, builder.finalize("float64")[2])
    a, b = other.add_body((0, 0), mass=1.0), other.add_body((1, 0), mass=1.0)
    other.add_distance_joint(a, b)
    with pytest.raises(ValueError, match="joints has 1"):
        dc.Simulation(model, state, other.finalize("float32")[2])
    with pytest.raises(ValueError, match="joints has 0"):
        dc.Simulation(*other.finalize("float32")[:2])
    state.numpy("velocity")[4, 1] = np.nan
    with pytest.raises(ValueError, match=r"state\.velocity\[4, 1\] is nan"):
        dc.Simulation(model, state, joints)


def test_phases_in_the_wrong_order():
    sim = simulation(seeds=(0,))
    with pytest.raises(ValueError, match=r"solve\(\) needs collide"):
        sim.solve()
    with pytest.raises(ValueError, match=r"advance\(\) needs solve"):
        sim.advance()
    sim.collide(DT)
    with pytest.raises(ValueError, match=r"advance\(\) needs solve"):
        sim.advance()
    sim.solve()
    sim.advance()
    with pytest.raises(ValueError, match=r"solve\(\) needs collide"):
        sim.solve()


# ---------------------------------------------------------------- phases


def test_phases_equal_a_step_and_repeat():
    stepped, phased, repeated = (simulation() for _ in range(3))
    for _ in range(60):
        stepped.step(DT)
        phased.collide(DT)
        phased.solve()
        phased.advance()
        repeated.collide(DT)
        state = [repeated.state.numpy(name).copy() for name in STATE]
        contacts = all_worlds(repeated)
        repeated.collide(DT)
        assert all_worlds(repeated) == contacts
        start = repeated.contacts.numpy("impulse").copy()
        repeated.solve()
        repeated.contacts.numpy("impulse")[:] = start
        repeated.solve()
        assert all((repeated.state.numpy(n) == v).all() for n, v in zip(STATE, state))
        repeated.advance()
    assert all_worlds(stepped) == all_worlds(phased) == all_worlds(repeated)


def test_callback_and_start_see_every_step():
    sim, plain = simulation(seeds=(0,)), simulation(seeds=(0,))
    times, starts = [], []
    sim.run(
        5,
        DT,
        start=lambda s: starts.append(int(s.contacts.numpy("contact_count")[0])),
        callback=lambda s: times.append(float(s.state.numpy("time")[0])),
    )
    plain.run(5, DT)
    np.testing.assert_allclose(times, DT * np.arange(1, 6), rtol=1e-5)
    assert len(starts) == 5
    assert all_worlds(sim) == all_worlds(plain)


def test_settings_may_change_between_steps_and_solves():
    sim = simulation(seeds=(0,), dtype="float64")
    sim.run(60, DT)
    sim.collide(DT)
    slots, _ = measure.contact_slots(sim.contacts)
    results = {}
    for name, changes in {
        "pgs": {"acceleration": "none"},
        "jacobi": {"method": "jacobi"},
        "nncg": {"acceleration": "nncg"},
    }.items():
        sim.config = dc.SolverConfig(tolerance=1e-11, max_sweeps=100_000, **changes)
        sim.contacts.numpy("impulse")[slots] = 0.0
        sim.solve()
        results[name] = sim.motion.numpy("solved")[: sim.model.body_count].copy()
    for name, solved in results.items():
        np.testing.assert_allclose(solved, results["pgs"], atol=1e-7, err_msg=name)
    sim.config = replace(sim.config, history=True, max_sweeps=7)
    sim.step(DT)
    assert sim.stats.history.shape == (1, 7)


def test_nonlinear_cg_recovers_from_a_bad_start():
    """Scratch that a solve from nonsense leaves behind must not reach the next solve."""
    sim = simulation(seeds=(0,), config=dc.SolverConfig(acceleration="nncg", max_sweeps=50))
    sim.run(60, DT)
    for start in (np.nan, 3e38):
        sim.collide(DT)
        slots, _ = measure.contact_slots(sim.contacts)
        good = sim.contacts.numpy("impulse")[slots].copy()
        sim.solve()
        expected = sim.contacts.numpy("impulse")[slots].copy()
        sim.contacts.numpy("impulse")[slots] = start
        sim.solve()
        sim.contacts.numpy("impulse")[slots] = good
        sim.solve()
        assert (sim.contacts.numpy("impulse")[slots] == expected).all()


def test_snapshot_goes_on_bit_for_bit(tmp_path):
    sim = simulation()
    sim.run(70, DT)
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5", threads=2)
    assert loaded.contacts.numpy("contact_count").sum() > 20
    for s in (sim, loaded):
        s.run(70, DT)
    assert all_worlds(loaded) == all_worlds(sim)
    assert sim.contacts.numpy("age").max() > 70  # contacts older than the snapshot


def test_memory_and_explain_tell_what_runs():
    sim = simulation(seeds=(0,))
    memory = sim.memory()
    assert memory["contact_bytes"] > 0
    assert memory["body_bytes"] > 0
    discs, general = sim.explain(), simulation(seeds=(0,), specialize=False).explain()
    assert "discs" in discs
    assert discs != general
    assert "joint" in discs  # there are none: said, not hidden
    assert f"at least {sim.config.min_sweeps} sweeps" in discs


def test_explain_counts_shapes_of_each_kind_and_names_a_repeated_stage():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.81))
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0.0, 0.0), (10.0, 0.0)])
    builder.add_capsule(builder.add_body(position=(5.0, 1.0)), (-0.5, 0.0), (0.5, 0.0), 0.2)
    builder.add_box(builder.add_body(position=(7.0, 1.0)), 0.5, 0.5)
    builder.add_discs([(2.0, 1.0)], radius=0.5)
    text = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(sleep=True)).explain()
    assert "; 1 disc, 1 polygon, 1 segment, 1 capsule; 0 joints" in text
    assert "narrowphase, wake_touched, narrowphase (again, where a sleeper was touched), admit" in text


def test_explain_counts_no_empty_slots_and_names_nothing_that_does_not_run():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.81))
    body = builder.add_body()
    builder.add_capsule(body, (0.0, 0.0), (1.0, 0.0), 0.2)
    sim = dc.Simulation(*builder.finalize())
    sim.reserve(bodies=16, shapes=16, vertices=64)
    assert sim.explain().startswith("scene: 1 world, 1 dynamic body; 1 capsule; 0 joints")
    sim.remove(bodies=[body])
    assert sim.explain().startswith("scene: 1 world, no bodies; no shapes; 0 joints")
    soft = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(method="tgs_soft", substeps=4)).explain()
    assert "acceleration" not in soft and "position correction" not in soft
    uncorrected = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(position_iterations=0)).explain()
    assert "the position phase is skipped" in uncorrected


# ---------------------------------------------------------------- coordinates, kinds of bodies


@pytest.mark.parametrize("origin", [(1e5, 0.0), (-1e5, 2e5)])
def test_a_far_away_world_moves_with_the_same_bits(origin):
    """Positions are relative to the world's origin, so that float32 is as exact at 100 km as at 0."""
    near, far = dc.ModelBuilder(), dc.ModelBuilder()
    grid = np.stack(np.meshgrid(np.arange(4) * 0.5 - 0.75, 0.25 + 0.5 * np.arange(4)), axis=-1).reshape(-1, 2)
    grid += np.arange(16)[:, None] % 3 * [0.03125, 0.0]  # exact in binary, also after adding the origin
    for builder, at in ((near, (0.0, 0.0)), (far, origin)):
        builder.add_world(origin=at)
        builder.add_chain(builder.add_body(at, type=dc.BodyType.STATIC), GROUND)
        builder.add_discs(grid + at, 0.2)
    sims = [dc.Simulation(*builder.finalize("float32")) for builder in (near, far)]
    for sim in sims:
        sim.run(150, DT)
    assert all_worlds(sims[0]) == all_worlds(sims[1])
    assert sims[1].model.numpy("origin")[0].tolist() == list(origin)
    assert np.abs(sims[1].state.numpy("position")).max() < 10


def test_static_bodies_never_move():
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body((0.1, 0.2), angle=0.3, type=dc.BodyType.STATIC)
    builder.add_box(ground, 3.0, 0.2)
    builder.add_discs([(0.0, 0.8), (0.3, 1.6)], 0.3, velocity=(0.0, -20.0), restitution=0.5)
    sim = dc.Simulation(*builder.finalize("float32"))
    sim.state.numpy("force")[0] = (1e3, 1e3)
    before = [sim.state.numpy(name)[0].copy() for name in STATE]
    sim.run(100, DT)
    assert all((sim.state.numpy(name)[0] == v).all() for name, v in zip(STATE, before))
    assert sim.contacts.numpy("impulse").max() > 0


def test_kinematic_bodies_keep_their_velocity_and_carry_things():
    """A conveyor of speed v takes a box along: it slides for v / (mu g), then rests on the belt."""
    speed, mu = 1.5, 0.5
    builder = dc.ModelBuilder()
    builder.add_world()
    belt = builder.add_body((0.0, 0.0), velocity=(speed, 0.0), type=dc.BodyType.KINEMATIC)
    builder.add_box(belt, 20.0, 0.5, friction=mu)
    load = builder.add_body((0.0, 0.7))
    builder.add_box(load, 0.4, 0.2, friction=mu)
    sim = dc.Simulation(*builder.finalize("float64"))
    slide = speed / (mu * 9.8)
    half = round(slide / 2 / DT)
    sim.run(half, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[load], (mu * 9.8 * half * DT, 0.0), atol=1e-3)
    sim.run(round(2 * slide / DT), DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[load], (speed, 0.0), atol=1e-6)
    steps = half + round(2 * slide / DT)
    np.testing.assert_allclose(sim.state.numpy("position")[belt], (speed * steps * DT, 0.0), atol=1e-12)
    assert sim.state.numpy("velocity")[belt].tolist() == [speed, 0.0]
    # the load lags by what it slid: v^2 / (2 mu g)
    lag = sim.state.numpy("position")[belt, 0] - sim.state.numpy("position")[load, 0]
    np.testing.assert_allclose(lag, speed**2 / (2 * mu * 9.8), atol=speed * DT)


def test_kinematic_bodies_turn_and_lift():
    """A rising platform lifts what rests on it; a turning one keeps its spin whatever hits it."""
    builder = dc.ModelBuilder()
    builder.add_world()
    lift = builder.add_body((0.0, 0.0), velocity=(0.0, 0.5), type=dc.BodyType.KINEMATIC)
    builder.add_box(lift, 2.0, 0.5)
    rider = int(builder.add_discs([(0.0, 0.8)], 0.3)[0])
    wheel = builder.add_body((10.0, 0.0), angular_velocity=3.0, type=dc.BodyType.KINEMATIC)
    builder.add_box(wheel, 1.0, 0.2)
    builder.add_discs([(10.3, 1.5)], 0.3)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.run(100, DT)
    np.testing.assert_allclose(sim.state.numpy("position")[rider, 1], 1.3, atol=1e-3)
    np.testing.assert_allclose(sim.state.numpy("position")[lift, 1], 0.5, atol=1e-12)
    assert sim.state.numpy("angular_velocity")[wheel] == 3.0
    np.testing.assert_allclose(sim.state.numpy("angle")[wheel], 3.0, atol=1e-12)


def test_forces_and_torques_act_until_changed():
    """Free body: v = F t / m, omega = tau t / I."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_discs([(0.0, 0.0)], 0.5)
    sim = dc.Simulation(*builder.finalize("float64"))
    mass, inertia = sim.model.numpy("mass")[0], sim.model.numpy("inertia")[0]
    sim.state.numpy("force")[0] = (2.0, -1.0)
    sim.state.numpy("torque")[0] = 0.25
    sim.run(50, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[0], np.array([2.0, -1.0]) * 0.5 / mass, rtol=1e-12)
    np.testing.assert_allclose(sim.state.numpy("angular_velocity")[0], 0.25 * 0.5 / inertia, rtol=1e-12)
    sim.state.numpy("force")[0] = 0.0
    before = sim.state.numpy("velocity")[0].copy()
    sim.step(DT)
    assert (sim.state.numpy("velocity")[0] == before).all()


@pytest.mark.parametrize(
    ("backend", "change", "message"),
    [
        ("warp", lambda wp, a: wp.array(a.numpy(), dtype=wp.vec2d, device="cpu"), r"state\.position is .*vec2d"),
        ("warp", lambda wp, a: wp.zeros(len(a) + 1, dtype=wp.vec2f, device="cpu"), r"state\.position is .*must be"),
        ("warp", lambda wp, a: wp.zeros(2 * len(a), dtype=wp.vec2f, device="cpu")[::2], r"state\.position has strides"),
        ("warp", lambda wp, a: a.numpy(), r"state\.position is \('ndarray'"),
        ("numpy", lambda wp, a: a.astype(np.float64), r"state\.position is .*float64"),
        ("numpy", lambda wp, a: np.zeros((2 * len(a), 2), np.float32)[::2], r"state\.position has strides"),
        ("numpy", lambda wp, a: a[:, :1], r"state\.position is .*must be"),
    ],
)
def test_a_foreign_array_is_refused(backend, change, message):
    """Never copied in silence: dtype, shape, stride and kind of array are checked before any kernel runs."""
    wp = pytest.importorskip("warp")
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs([(0.0, 0.0), (3.0, 0.0)], 0.5)
    model, state, joints = builder.finalize("float32", backend=backend)
    state.share("position", change(wp, state.position))
    with pytest.raises(ValueError, match=message):
        dc.Simulation(model, state, joints)


def test_no_thread_is_left_at_work_after_an_interrupt(monkeypatch):
    """A shard fails while another is in the middle of its chunk: the error arrives only when that one has ended."""
    sim = simulation(threads=2)
    sim.step(DT)
    first, take = threading.current_thread(), Rounds.take
    begun, ended = threading.Event(), threading.Event()

    def take_slowly(shard, rounds):
        if threading.current_thread() is first:
            assert begun.wait(200.0)
            raise KeyboardInterrupt
        begun.set()
        time.sleep(0.05)
        done = take(shard, 1)
        ended.set()
        return done

    monkeypatch.setattr(Rounds, "take", take_slowly)
    monkeypatch.setattr(stepping, "WORTH_THREADS", 0)
    with pytest.raises(KeyboardInterrupt):
        sim.run(100, DT)
    assert ended.is_set()
    monkeypatch.undo()
    before = sim.state.numpy("time").copy()
    sim.run(3, DT)
    np.testing.assert_allclose(sim.state.numpy("time") - before, 3 * DT, rtol=1e-6)
