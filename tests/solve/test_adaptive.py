"""Acceleration "adaptive": its three methods in turn, the same in both backends, and no worse than each alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import measure
from dc_kernels.solve.iteration import Stretch
from pipeline.scenes import Mixed, Stack, Thesis

DT = 0.01
TIGHT = dc.SolverConfig(acceleration="adaptive", tolerance=1e-10, max_sweeps=20_000, stretch=20)


def impact(
    bodies: int = 30, dtype: str = "float64", steps: int = 70, worlds: int = 2, backend: str = "warp", **options
) -> dc.Simulation:
    """Worlds of discs that fall onto each other, after ``collide``."""
    model, state, joints = Thesis(bodies=bodies).build(worlds, 5).finalize(dtype, backend=backend)
    sim = dc.Simulation(model, state, joints, **options)
    sim.run(steps, DT)
    sim.collide(DT)
    return sim


def method(sim: dc.Simulation) -> np.ndarray:
    """Which of the three is at work, by world."""
    return sim.stats.numpy("iteration")["stretch_method"]


@pytest.mark.parametrize(("schedule", "every"), [("world", 3), ("color", 5)])
def test_backends_agree_in_every_method(schedule, every):
    """Iterates of a whole solve, looked at in each stretch; both schedules have one's bits (test_solver.py)."""
    config = dc.SolverConfig(start="zero", acceleration="adaptive", tolerance=0.0, max_sweeps=12, stretch=12)
    falling = impact(steps=45, config=config)
    sims = [impact(steps=0, backend=b, schedule=schedule, config=config) for b in ("warp", "numpy")]
    for sim in sims:  # the oracle need not go all the way: the solve starts from zero
        for name, values in falling.state.views().items():
            sim.state.numpy(name)[...] = values
        sim.collide(DT)
    seen = set()
    for sweeps in range(12, 73, every):
        for sim in sims:
            sim.contacts.numpy("impulse")[...] = 0.0
            sim.solve(replace(config, max_sweeps=sweeps))
        flying = sims[0].stats.numpy("change") > 1e-9  # below, round-off decides
        assert (method(sims[0]) == method(sims[1]))[flying].all()
        seen |= set(method(sims[0])[flying])
        slots = measure.contact_slots(sims[0].contacts)[0]
        one, two = (sim.contacts.numpy("impulse")[slots] for sim in sims)
        np.testing.assert_allclose(one, two, atol=1e-9, err_msg=f"{sweeps} sweeps")
        one, two = (sim.motion.numpy("solved")[: sim.model.body_count] for sim in sims)
        np.testing.assert_allclose(one, two, atol=1e-9, err_msg=f"{sweeps} sweeps")
    assert {Stretch.MOMENTUM, Stretch.ANDERSON} < seen


def test_it_ends_at_the_answer_of_plain_sweeps():
    sim = impact(config=replace(TIGHT, max_sweeps=100_000))
    start = sim.contacts.numpy("impulse").copy()
    solved = []
    for acceleration in ("adaptive", "none"):
        sim.contacts.assign("impulse", start)
        sim.solve(replace(sim.config, acceleration=acceleration))
        assert (sim.stats.numpy("change") < 1e-10).all()
        solved.append(sim.motion.numpy("solved")[: sim.model.body_count].copy())
    np.testing.assert_allclose(*solved, atol=1e-7)


@pytest.mark.parametrize(("dtype", "bound"), [("float32", 5e-6), ("float64", 1e-14)])
def test_velocities_are_those_of_the_impulses(dtype, bound):
    """Momentum carries velocities along, round-off included; where a solve ends they are made anew."""
    sim = impact(100, dtype, 90, 1, config=replace(TIGHT, tolerance=0.0, stretch=40))
    ended = set()
    for sweeps in (41, 60, 79, 80, 81, 100, 119, 140):
        sim.contacts.numpy("impulse")[...] = 0.0
        sim.solve(replace(sim.config, max_sweeps=sweeps))
        ended |= set(method(sim))
        contacts = sim.contacts
        slots = measure.contact_slots(contacts)[0]
        a, b, n, arm_a, arm_b, p = (
            contacts.numpy(k)[slots] for k in ("body_a", "body_b", "normal", "arm_a", "arm_b", "impulse")
        )
        vector = (p[:, :1] * n + p[:, 1:] * np.stack([n[:, 1], -n[:, 0]], axis=1)).astype(float)
        want = sim.motion.numpy("predicted").astype(float)
        model = sim.model
        for body, arm, sign in ((a, arm_a, -1.0), (b, arm_b, 1.0)):
            np.add.at(want[:, :2], body, sign * vector * model.numpy("inv_mass")[body][:, None])
            turn = arm[:, 0] * vector[:, 1] - arm[:, 1] * vector[:, 0]
            np.add.at(want[:, 2], body, sign * turn * model.numpy("inv_inertia")[body])
        got = sim.motion.numpy("solved")
        size = np.abs(want[: model.body_count, :3]).max()
        np.testing.assert_allclose(got[: model.body_count, :3], want[: model.body_count, :3], atol=bound * size)
    assert Stretch.MOMENTUM in ended


def test_it_pays_where_one_method_stalls():
    """A stack of 20 boxes to a residual of 1e-4 from the cache of steps before: Aitken's three times the sweeps."""
    sweeps = {}
    for acceleration in ("aitken", "adaptive"):
        config = dc.SolverConfig(acceleration=acceleration, stop="residual", max_sweeps=20_000)
        model, state, joints = Stack().build(1, 0).finalize("float64")
        sim = dc.Simulation(model, state, joints, config=config)
        total = 0
        for _ in range(20):
            sim.step(DT)
            total += int(sim.stats.numpy("sweeps")[0])
        assert sim.stats.numpy("residual")[0] < 1e-4
        sweeps[acceleration] = total
    assert 2 * sweeps["adaptive"] < sweeps["aitken"]


def test_a_solve_may_choose_it_for_itself():
    """The room that it needs is made when it is asked for, and grows with the contacts."""
    sim = impact(config=dc.SolverConfig(acceleration="none", tolerance=1e-10, max_sweeps=50_000))
    assert sim.rows.sizes["row past"] == 0
    start = sim.contacts.numpy("impulse").copy()
    sim.solve()
    wanted = sim.motion.numpy("solved")[: sim.model.body_count].copy()
    for acceleration in ("adaptive", "nncg"):
        sim.contacts.assign("impulse", start)
        sim.solve(replace(sim.config, acceleration=acceleration))
        np.testing.assert_allclose(sim.motion.numpy("solved")[: sim.model.body_count], wanted, atol=1e-7)
    assert sim.rows.sizes["row past"] >= sim.storage.solver.past_width > 0
    sim.advance()


def test_threads_and_shards_do_not_share_what_a_solve_remembers():
    """Worlds of different sizes, some of which go through every method, on one thread and on two."""
    builder = Thesis(bodies=20).build(5, 1)
    bits = []
    for threads in (1, 2):
        model, state, joints = builder.finalize()
        sim = dc.Simulation(model, state, joints, config=replace(TIGHT, tolerance=1e-7), threads=threads)
        sim.run(120, DT)
        bits.append((sim.state.numpy("position").tobytes(), sim.stats.numpy("sweeps").tobytes()))
    assert bits[0] == bits[1]


def test_nonsense_leaves_no_trace():
    """What a solve from NaN or huge impulses leaves behind must not reach the next."""
    sim = impact(config=TIGHT)
    good = sim.contacts.numpy("impulse").copy()
    sim.solve()
    wanted = sim.contacts.numpy("impulse").copy()
    for start in (np.nan, 1e300):
        sim.contacts.numpy("impulse")[...] = start
        with np.errstate(all="ignore"):
            sim.solve(replace(TIGHT, max_sweeps=100))
        sim.contacts.assign("impulse", good)
        sim.solve()
        np.testing.assert_array_equal(sim.contacts.numpy("impulse"), wanted)


def test_stretch_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"SolverConfig.stretch is 9; it must be an integer in \[10,"):
        dc.SolverConfig(stretch=9)


@pytest.mark.parametrize("acceleration", ["adaptive", "aitken"])
def test_no_energy_comes_from_sweeps_that_circle(acceleration):
    """With a friction of 10 half of the steps hit their cap; momentum alone would gain 1e4 times the energy in one."""
    config = dc.SolverConfig(acceleration=acceleration, max_sweeps=600)
    sim = dc.Simulation(*Mixed(bodies=50, friction=10.0).build(4, 0).finalize(), config=config)
    start = measure.kinetic_energy(sim) + measure.potential_energy(sim)
    capped = 0
    for _ in range(250):
        sim.step(DT)
        capped += int((sim.stats.numpy("sweeps") == 600).sum())
        assert (measure.kinetic_energy(sim) + measure.potential_energy(sim) < start).all()
    assert capped > 100


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_it_leaves_a_method_that_grows_without_end(backend):
    """A hexagon that hits a wall of tiles from afar: rows differ by 1e-3 of their arms, and float32 resolves 1e-7.

    In one throw of five a method leads so far astray that it is left.
    """
    draw = np.random.default_rng(1)
    turns = np.arange(6) * np.pi / 3
    config = replace(dc.SolverConfig.preset("accurate"), history=True)
    left = 0
    for _ in range(12):
        place, angle = draw.uniform((-8.0, -0.4), (-4.0, 0.4)), float(draw.uniform(0.0, 2.0 * np.pi))
        speed = float(draw.choice([400.0, 1000.0]))
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0, 0))
        wall = builder.add_body(type=dc.BodyType.STATIC)
        for k in range(-12, 13):
            builder.add_box(wall, 0.01, 0.25, center=(0.0, 0.5 * k))
        hexagon = builder.add_body(place, angle=angle, velocity=(speed, 0.0))
        builder.add_polygon(hexagon, 0.3 * np.stack((np.cos(turns), np.sin(turns)), axis=1))
        sim = dc.Simulation(*builder.finalize(backend=backend), config=config)
        sim.run(1, 1 / 60)
        left += int((sim.stats.numpy("iteration")["rate"] <= -1e9).any())
        assert sim.stats.numpy("history").max() < 1e4 * speed
        assert np.hypot(*sim.state.numpy("velocity")[hexagon]) <= speed * (1 + 1e-4)
        assert sim.stats.numpy("residual")[0] < 0.1
    assert left > 0
