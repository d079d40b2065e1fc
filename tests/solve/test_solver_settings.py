"""The solver: when it stops, start impulses, settings, distance joints."""

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from tests.solve.scenes import DT, bits, check_laws, dense, pile, settled, solve_from, used


def test_stops_at_the_first_change_below_tolerance_and_keeps_history():
    sim = settled()
    for schedule_method, acceleration in (("pgs", "none"), ("pgs", "aitken"), ("jacobi", "none")):
        solve_from(sim, method=schedule_method, acceleration=acceleration, tolerance=1e-5, history=True)
        history, sweeps = sim.stats.history.numpy(), sim.stats.numpy("sweeps")
        assert history.shape == (2, sim.config.max_sweeps)
        assert sweeps.min() > 1
        for w, n in enumerate(sweeps):
            assert history[w, n - 1] == sim.stats.numpy("change")[w]
            assert history[w, n - 1] < 1e-5 or n == sim.config.max_sweeps
            assert (history[w, : n - 1] >= 1e-5).all()
    solve_from(sim, history=False)
    assert sim.stats.history.numpy().shape == (2, 0)


def test_history_is_zero_beyond_the_sweeps():
    sim = settled()
    solve_from(sim, acceleration="none", tolerance=1e-8, max_sweeps=5000, history=True)
    before = sim.stats.numpy("sweeps").copy()
    solve_from(sim, tolerance=1e-2)
    assert (sim.stats.numpy("sweeps") < before).all()
    for w, n in enumerate(sim.stats.numpy("sweeps")):
        assert not sim.stats.history.numpy()[w, n:].any()


def test_stops_on_the_residual_checked_every_few_sweeps():
    sim = settled()
    for every in (1, 5):
        _, _, _ = solve_from(
            sim, stop="residual", tolerance=1e-4, residual_every=every, acceleration="none", max_sweeps=20_000
        )
        assert (sim.stats.numpy("residual") < 1e-4).all()
        sweeps = sim.stats.numpy("sweeps").copy()
        assert (sweeps % every == 0).all()
        for w in range(2):  # and not before: one check less would not have been enough
            solve_from(sim, stop="residual", tolerance=0.0, max_sweeps=int(sweeps[w]) - every)
            assert sim.stats.numpy("residual")[w] >= 1e-4


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_no_impulse_solves_a_gap_that_stays_open(friction, backend):
    """Also without friction, where the cone of impulses is a ray."""
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    builder.add_box(builder.add_body((0.0, -0.5), type=dc.BodyType.STATIC), 5.0, 0.5, friction=friction)
    builder.add_disc(builder.add_body((0.0, 0.515)), 0.5, friction=friction)
    model, state, _ = builder.finalize("float64", backend=backend)
    sim = dc.Simulation(model, state, config=dc.SolverConfig(stop="residual"))
    sim.collide(1e-3)
    assert sim.contacts.numpy("contact_count")[0] == 1
    sim.solve()
    assert sim.stats.numpy("residual")[0] == 0.0
    assert not sim.contacts.numpy("impulse")[:1].any()


def test_residual_falls_to_round_off_and_is_relative_to_a_frictional_stop():
    """From zero impulses at contacts that all close, the natural map is of the order of its scale."""
    sim = settled()
    solve_from(sim, max_sweeps=0)
    begin = sim.stats.numpy("residual").copy()
    assert ((begin > 0.05) & (begin < 5)).all()
    solve_from(sim, tolerance=1e-14, max_sweeps=100_000, acceleration="none")
    assert (sim.stats.numpy("residual") < 1e-9).all()


def test_no_sweeps_leave_impulses_and_apply_them():
    """V = V* + M^-1 J^T lambda (Wu 2018, equation 2.26)."""
    sim = pile("general", "float64", seeds=(4,))
    sim.run(150, DT)
    sim.collide(DT)
    start = np.random.default_rng(0).uniform(0, 0.1, (len(used(sim)[0]), 2))
    impulse, _, solved = solve_from(sim, start, max_sweeps=0)
    assert (impulse == start).all()
    assert (sim.stats.numpy("sweeps") == 0).all()
    j, inverse, velocity, _, _ = dense(sim)
    np.testing.assert_allclose(solved.ravel(), velocity + inverse * (j.T @ start.ravel()), atol=1e-13)


@pytest.mark.parametrize("schedule", ["world", "color"])
def test_a_world_without_contacts_takes_no_sweeps(schedule):
    builder = dc.ModelBuilder()
    builder.add_world()  # empty
    builder.add_world()
    builder.add_discs([(0.0, 0.0), (5.0, 0.0)], 0.5)
    sim = dc.Simulation(*builder.finalize("float32"), schedule=schedule)
    sim.run(3, DT)
    assert (sim.stats.numpy("sweeps") == 0).all()
    assert not sim.stats.numpy("change").any()
    assert not sim.stats.numpy("residual").any()
    np.testing.assert_allclose(sim.state.numpy("velocity")[:, 1], -9.8 * 3 * DT, rtol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("time"), 3 * DT, rtol=1e-6)


# ---------------------------------------------------------------- start impulses


def test_every_start_ends_at_the_same_velocities():
    sim = pile("discs", "float64", seeds=(3,))
    sim.run(250, DT)
    sim.collide(DT)
    rng = np.random.default_rng(1)
    count = len(used(sim)[0])
    solution, _, expected = solve_from(sim, tolerance=1e-12, max_sweeps=500_000, acceleration="none")
    sweeps = sim.stats.numpy("sweeps")[0]
    starts = {
        "random": np.column_stack((rng.uniform(0, 5, count), rng.uniform(-2, 2, count))),
        "bad": np.full((count, 2), 50.0),
        "thousandfold": 1000 * solution,
        "negative": -solution,
    }
    for name, start in starts.items():
        impulse, _, solved = solve_from(sim, start)
        assert sim.stats.numpy("change")[0] < 1e-12, name
        check_laws(sim, impulse, solved, 1e-7)
        np.testing.assert_allclose(solved, expected, atol=1e-7, err_msg=name)
    _, _, solved = solve_from(sim, solution, tolerance=1e-6, min_sweeps=1)
    assert sim.stats.numpy("sweeps")[0] <= 3 < sweeps
    np.testing.assert_allclose(solved, expected, atol=1e-9)


def test_start_callable_writes_the_start():
    sim = pile("discs", seeds=(0,))
    seen = []

    def copy(sim):
        slots, _ = used(sim)
        sim.contacts.numpy("impulse")[slots] = 0.25
        seen.append(len(slots))

    sim.run(30, DT)
    sim.config = replace(sim.config, max_sweeps=0)
    sim.step(DT, start=copy)
    assert seen == [len(used(sim)[0])]
    assert (sim.contacts.numpy("impulse")[used(sim)[0]] == 0.25).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_that_is_not_finite_names_the_contact(value):
    sim = pile("discs", seeds=(0, 1))
    sim.run(60, DT)
    before = bits(sim)[:6]
    slots, world = used(sim)
    third = slots[world == 1][2]

    def start(sim):
        sim.contacts.numpy("impulse")[third, 1] = value

    with pytest.raises(ValueError, match=rf"contacts\.impulse\[{third}, 1\] \(contact 2 of world 1\)"):
        sim.step(DT, start=start)
    assert bits(sim)[:6] == before  # nothing was committed
    sim.step(DT)
    assert not sim.state.numpy("flags").any()


def test_cache_starts_from_the_step_before():
    warm, cold = (
        pile("discs", "float64", seeds=(4,), config=dc.SolverConfig(tolerance=1e-8, max_sweeps=20_000))
        for _ in range(2)
    )
    cold.config = replace(cold.config, start="zero")
    for sim in (warm, cold):
        sim.run(300, DT)
    assert warm.stats.numpy("sweeps")[0] < cold.stats.numpy("sweeps")[0]
    solution = warm.contacts.numpy("impulse")[used(warm)[0]].copy()
    keys = warm.contacts.numpy("key")[used(warm)[0]].copy()
    warm.collide(DT / 2)  # impulses follow the time step
    now = warm.contacts.numpy("key")[used(warm)[0]]
    common = np.isin(now, keys)
    assert common.any()
    expected = solution[np.searchsorted(keys, now[common])] / 2
    np.testing.assert_allclose(warm.contacts.numpy("impulse")[used(warm)[0]][common], expected, rtol=1e-12)
    cold.collide(DT)
    assert not cold.contacts.numpy("impulse")[used(cold)[0]].any()


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("method", "gauss"),
        ("acceleration", "anderson"),
        ("stop", "never"),
        ("start", "copy"),
        ("position_correction", "split"),
        ("max_sweeps", -1),
        ("tolerance", -1e-4),
        ("tolerance", float("nan")),
        ("residual_every", 0),
        ("omega", 0.0),
        ("omega", 2.5),
        ("aitken_period", 2),
        ("aitken_threshold", 0.0),
        ("aitken_cap", -1.0),
        ("position_iterations", -1),
        ("position_factor", 1.5),
        ("slop", float("nan")),
        ("max_correction", 0.0),
        ("speculative", -0.1),
        ("margin", -0.1),
        ("restitution_threshold", -1.0),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(ValueError, match=rf"SolverConfig\.{name} is"):
        dc.SolverConfig(**{name: value})


def test_settings_that_contradict_each_other():
    with pytest.raises(ValueError, match="aitken_period_max"):
        dc.SolverConfig(aitken_period=50)
    with pytest.raises(ValueError, match="omega"):
        dc.SolverConfig(method="jacobi", acceleration="sor", omega=1.4)


# ---------------------------------------------------------------- distance joints


def test_pendulum_keeps_length_and_period():
    """T = 2 pi sqrt(L / g) (1 + theta^2 / 16 + ...), the simple pendulum (Landau and Lifshitz I, 11)."""
    length, theta, dt = 2.0, 0.1, 0.002
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    anchor = builder.add_body((1.0, 3.0), type=dc.BodyType.STATIC)
    bob = builder.add_body((1.0 + length * np.sin(theta), 3.0 - length * np.cos(theta)), mass=0.7)
    builder.add_distance_joint(anchor, bob)
    sim = dc.Simulation(*builder.finalize("float64"))
    x, lengths = [], []

    def watch(sim):
        offset = sim.state.numpy("position")[bob] - sim.state.numpy("position")[anchor]
        x.append(offset[0])
        lengths.append(np.hypot(*offset))

    sim.run(6000, dt, callback=watch)
    assert np.abs(np.array(lengths) - length).max() < sim.config.slop * 1.0
    x = np.array(x)
    down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    crossing = down + x[down] / (x[down] - x[down + 1])
    period = np.diff(crossing).mean() * dt
    assert len(crossing) >= 4
    np.testing.assert_allclose(period, 2 * np.pi * np.sqrt(length / 9.8) * (1 + theta**2 / 16), rtol=2e-3)
    assert x[-1500:].max() > 0.95 * x[:1500].max()  # the swing lasts


def test_hanging_chain_carries_the_weights_below():
    """Statics: the force in a link is the weight of all that hangs below it."""
    masses = np.array([0.5, 2.0, 1.0, 3.0, 0.25])
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    last = builder.add_body((0.0, 0.0), type=dc.BodyType.STATIC)
    for k, mass in enumerate(masses):
        body = builder.add_body((0.0, -(k + 1.0)), mass=mass)
        builder.add_distance_joint(last, body)
        last = body
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(tolerance=1e-12, max_sweeps=20_000))
    sim.run(20, DT)
    loads = -sim.joints.numpy("joint_impulse") / DT
    np.testing.assert_allclose(loads, 9.8 * masses[::-1].cumsum()[::-1], rtol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("position")[:, 1], -np.arange(6.0), atol=1e-6)
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-8


def test_a_joint_pulls_and_pushes():
    """Two free masses flying apart, then towards each other, keep their distance and their common momentum."""
    builder = dc.ModelBuilder()
    for speed in (1.0, -1.0):
        builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
        a = builder.add_body((0.0, 0.0), velocity=(0.0, 0.0), mass=1.0)
        b = builder.add_body((1.0, 0.0), velocity=(speed, 0.0), mass=3.0)
        builder.add_distance_joint(a, b)
    config = dc.SolverConfig(tolerance=1e-14)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.run(10, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[:, 0], [0.75, 0.75, -0.75, -0.75], atol=1e-12)
    gap = np.diff(sim.state.numpy("position")[:, 0])[[0, 2]]
    np.testing.assert_allclose(gap, 1.0, atol=1e-12)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.step(DT)
    np.testing.assert_allclose(sim.joints.numpy("joint_impulse"), [-0.75, 0.75], atol=1e-12)
