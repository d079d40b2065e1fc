"""Ctrl-C in launches that would take hours: it is not kept waiting, and all worlds stand at the same time."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime import stepping
from tests.interrupting import interrupted, work_on

ENDLESS = dc.SolverConfig(min_sweeps=2**31 - 1, max_sweeps=2**31 - 1)
PUSHES = dc.SolverConfig(position_iterations=2**31 - 1, position_factor=1e-9)


@pytest.fixture(autouse=True)
def short_grace(monkeypatch):
    monkeypatch.setattr(stepping, "GRACE", 0.1)


def piled(worlds, threads, config=None):
    """Discs on the ground, which overlap it."""
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 10.0, 1.0)
        for i in range(3):
            builder.add_disc(builder.add_body((2.0 * i, 1.4)), 0.5)
    sim = dc.Simulation(*builder.finalize(), threads=threads)
    sim.run(3, 0.01)
    sim.config = config or sim.config
    sim.warmup()
    return sim


@pytest.mark.parametrize(("worlds", "threads"), [(1, 1), (5, 2)])
@pytest.mark.parametrize("config", [ENDLESS, PUSHES])
def test_a_step_of_endless_sweeps_is_interrupted(worlds, threads, config):
    sim = piled(worlds, threads, config)
    before = sim.state.numpy("time").copy()
    with interrupted():
        sim.run(1_000_000, 0.01)
    assert sim.phase == "advance"
    moved = sim.state.numpy("time") - before
    assert moved.min() == moved.max() > 0.0
    assert sim.running.all() or config is PUSHES
    assert np.isfinite(sim.state.numpy("position")).all()
    sim.config = dc.SolverConfig()
    sim.run(5, 0.01)  # nothing is left of the interrupt
    assert not sim.running.any()
    np.testing.assert_allclose(sim.state.numpy("time") - before - moved, 0.05)


def test_a_solve_of_endless_sweeps_does_not_count_where_it_is_interrupted():
    sim = piled(2, 2, ENDLESS)
    sim.collide(0.01)
    with interrupted():
        sim.solve()
    assert sim.phase == "collide"
    with pytest.raises(ValueError, match=r"advance\(\) needs solve"):
        sim.advance()
    sim.solve(dc.SolverConfig(max_sweeps=50))
    sim.advance()


def test_a_step_that_ends_in_time_has_the_bits_of_one_that_is_not_interrupted(monkeypatch):
    monkeypatch.setattr(stepping, "GRACE", 10.0)
    config = dc.SolverConfig(min_sweeps=2_000_000, max_sweeps=10_000_000)
    sims = [piled(1, 1, config) for _ in range(2)]
    sims[0].step(0.01)
    with interrupted(10.0):
        sims[1].step(0.01)
        work_on()
    assert sims[1].stats.numpy("sweeps")[0] == sims[0].stats.numpy("sweeps")[0] >= 2_000_000
    for name in ("position", "velocity", "time"):
        assert sims[0].state.numpy(name).tobytes() == sims[1].state.numpy(name).tobytes()


def test_a_solver_of_others_contacts_is_interrupted():
    arrays = {
        "body_a": np.zeros(1, np.int32),
        "body_b": np.ones(1, np.int32),
        "normal": np.array([[0.0, 1.0]], np.float32),
        "gap": np.zeros(1, np.float32),
        "arm_a": np.zeros((1, 2), np.float32),
        "arm_b": np.array([[0.0, -0.5]], np.float32),
        "friction": np.full(1, 0.5, np.float32),
        "inv_mass": np.array([0.0, 1.0], np.float32),
        "inv_inertia": np.array([0.0, 8.0], np.float32),
    }
    point, kept = None, {k: v for k, v in arrays.items() if k not in ("body_a", "body_b", "normal", "gap")}
    solver = dc.ContactSolver(arrays["body_a"], arrays["body_b"], point, arrays["normal"], arrays["gap"], **kept)
    velocity, spin = np.array([[0, 0], [1, -1]], np.float32), np.zeros(2, np.float32)
    solver.solve(0.01, velocity.copy(), spin.copy())
    with interrupted():
        solver.solve(0.01, velocity, spin, config=ENDLESS)
    stats = solver.solve(0.01, velocity.copy(), spin.copy())
    assert stats.numpy("sweeps")[0] < 1000


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("call", ["splat", "gather", "sph_density"])
def test_transfers_and_sums_do_not_keep_an_interrupt_waiting(call, threads):
    # many seconds of work; that of a sum goes on behind the interrupt, beside the tests that follow
    count, radius = (45_000 if call == "sph_density" else 60_000), 0.1
    points = np.random.default_rng(0).uniform(0.0, 1.0, (count, 2)).astype(np.float32)
    grid, stencil = dc.Grid(rows=1001, columns=1001, spacing=1e-3), dc.Stencil(h=radius)
    image = np.ones((1, 1, *grid.shape), np.float32)

    def work(n):
        if call == "splat":
            dc.splat(points[:n], np.ones((n, 1), np.float32), grid, stencil, threads=threads)
        elif call == "gather":
            dc.gather(image, points[:n], grid, stencil, threads=threads)
        else:
            dc.sph_density(points[:n], np.ones(n, np.float32), radius, threads=threads)

    work(1)  # compiled, and a splat of so many points has kernels of its own
    if call == "splat":
        dc.Transfer(grid, stencil, threads=threads).at(points).splat(np.ones((count, 1), np.float32), image)
    with interrupted():
        work(count)
        work(count)
