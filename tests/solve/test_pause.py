"""A solve that pauses: it goes on bit for bit, takes impulses that were replaced, and finishes world by world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.options import RunOptions
from pipeline.scenes import Mixed, Thesis

SETTINGS = [("pgs", a) for a in ("none", "sor", "aitken", "nncg")] + [("jacobi", "none"), ("jacobi", "aitken")]


def colliding(scene=None, steps: int = 100, run: RunOptions | None = None, **config) -> dc.Simulation:
    """Worlds in which things have fallen onto each other, after ``collide``."""
    run = run or RunOptions(worlds=3, seed=3)
    sim = run.simulation(scene or Thesis(bodies=30), dc.SolverConfig(**config))
    sim.run(steps, run.dt)
    sim.collide(run.dt)
    return sim


def result(sim: dc.Simulation) -> list[np.ndarray]:
    names = ("sweeps", "change", "residual")
    arrays = [
        sim.contacts.numpy("impulse"),
        sim.motion.numpy("solved")[: sim.model.body_count],
        *(sim.stats.numpy(n) for n in names),
    ]
    return [array.copy() for array in arrays]


def run_paused(sim: dc.Simulation, pause: int, **options) -> int:
    sim.solve(pause=0, **options)
    pauses = 0
    while sim.running.any():
        sim.resume(pause=pause, **options)
        pauses += 1
    return pauses


@pytest.mark.parametrize(("method", "acceleration"), SETTINGS)
@pytest.mark.parametrize("scene", [Thesis(bodies=30), Mixed(bodies=12)], ids=["discs", "mixed"])
def test_a_solve_that_pauses_has_the_bits_of_one_that_does_not(scene, method, acceleration):
    sim = colliding(scene, method=method, acceleration=acceleration, max_sweeps=150)
    start = np.zeros_like(sim.contacts.numpy("impulse"))
    sim.contacts.assign("impulse", start)
    sim.solve()
    wanted = result(sim)
    assert wanted[2].max() > 10
    sim.contacts.assign("impulse", start)
    assert run_paused(sim, 4) > 2
    for a, b in zip(wanted, result(sim), strict=True):
        np.testing.assert_array_equal(a, b)


def squared_steps(sim):
    """Squared steps of the last two sweeps before a pause, (W, 2)."""
    iteration = sim.stats.numpy("iteration")
    return np.column_stack([iteration["step_before"], iteration["step_last"]])


@pytest.mark.parametrize("acceleration", ["none", "aitken"])
def test_the_oracle_pauses_at_the_same_sweeps(acceleration):
    made = {}
    for backend in ("warp", "numpy"):
        run = RunOptions(worlds=2, seed=3, dtype="float64", backend=backend)
        sim = colliding(Thesis(bodies=8), 3, replace(run, dt=0.1), acceleration=acceleration, max_sweeps=60)
        sim.solve(pause=0)
        rows = []
        for _ in range(4):
            sim.resume(pause=5)
            rows.append(np.column_stack([sim.stats.numpy("sweeps"), sim.running, squared_steps(sim)]))
        sim.stats.assign("replaced", np.ones(2, np.int32))
        sim.contacts.assign("impulse", 1.1 * sim.contacts.numpy("impulse"))
        sim.resume()
        made[backend] = (np.array(rows), *result(sim))
    assert made["warp"][0][:, :, 1].any()
    for a, b in zip(made["warp"], made["numpy"], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_a_pause_knows_the_last_two_steps():
    sim = colliding(acceleration="none")
    start = sim.contacts.numpy("impulse").copy()
    after = []
    for sweeps in (7, 8, 9):
        sim.contacts.assign("impulse", start)
        sim.solve(replace(sim.config, max_sweeps=sweeps))
        after.append(sim.contacts.numpy("impulse").copy())
    sim.contacts.assign("impulse", start)
    sim.solve(pause=0)
    sim.resume(pause=9)
    np.testing.assert_array_equal(sim.stats.numpy("sweeps"), [9, 9, 9])
    norms = squared_steps(sim)
    first = sim.contacts.numpy("contact_start")
    for w, count in enumerate(sim.contacts.numpy("contact_count")):
        steps = np.diff(np.array(after)[:, first[w] : first[w] + count], axis=0)
        np.testing.assert_allclose(norms[w], (steps**2).sum(axis=(1, 2)), rtol=1e-3)
    sim.resume(pause=1)  # two sweeps are the least that two steps can be told from
    np.testing.assert_array_equal(sim.stats.numpy("sweeps"), [11, 11, 11])


@pytest.mark.parametrize(("method", "acceleration"), SETTINGS)
def test_replaced_impulses_are_taken_up_in_their_world_alone(method, acceleration):
    sim = colliding(method=method, acceleration=acceleration, max_sweeps=3000, tolerance=1e-5)
    start = sim.contacts.numpy("impulse").copy()
    sim.solve()
    wanted = result(sim)
    sim.contacts.assign("impulse", start)
    sim.solve(pause=0)
    sim.resume(pause=10)
    assert sim.running.all()
    first, count = (sim.contacts.numpy(n) for n in ("contact_start", "contact_count"))
    middle = slice(first[1], first[1] + count[1])
    impulse = sim.contacts.numpy("impulse").copy()
    impulse[middle] = wanted[0][middle]
    sim.contacts.assign("impulse", impulse)
    sim.stats.assign("replaced", np.array([0, 1, 0], np.int32))
    sim.resume()
    found = result(sim)
    assert not sim.stats.numpy("replaced").any()
    assert found[2][1] < min(25, wanted[2][1])  # from the solution: some 10 sweeps until the pause and few beyond
    for w in (0, 2):
        part = slice(first[w], first[w] + count[w])
        np.testing.assert_array_equal(found[0][part], wanted[0][part])
        assert found[2][w] == wanted[2][w]


def test_threads_pause_alike():
    made = []
    for threads in (1, 2):
        sim = colliding(run=RunOptions(worlds=5, seed=3, threads=threads))
        run_paused(sim, 6)
        made.append(result(sim))
    for a, b in zip(*made, strict=True):
        np.testing.assert_array_equal(a, b)


def test_one_solve_may_have_settings_of_its_own():
    sim = colliding(tolerance=1e-3)
    start = sim.contacts.numpy("impulse").copy()
    sim.solve()
    coarse = result(sim)
    sim.solve(replace(sim.config, tolerance=1e-5, acceleration="none", max_sweeps=5000))
    assert (sim.stats.numpy("change") < 1e-5).all() and (coarse[3] >= 1e-5).all()
    sim.contacts.assign("impulse", start)
    sim.solve()
    for a, b in zip(coarse, result(sim), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_world_without_contacts_is_done_at_once():
    sim = colliding(Thesis(bodies=1), steps=0, max_sweeps=50)
    assert not sim.contacts.numpy("contact_count").any()
    sim.solve(pause=0)
    assert not sim.running.any()
    sim.resume(pause=5)
    assert not sim.stats.numpy("sweeps").any()


def test_what_cannot_be_is_refused():
    sim = colliding(Thesis(bodies=5), 1)
    with pytest.raises(ValueError, match="no solve is in flight"):
        sim.resume()
    with pytest.raises(ValueError, match=r"pause is -1; it must be an integer in \[0"):
        sim.solve(pause=-1)
    with pytest.raises(ValueError, match=r"config.method is 'jacobi', the solver's is 'pgs'"):
        sim.solve(replace(sim.config, method="jacobi"))
    sim.solve()
    sim.advance()
    with pytest.raises(ValueError, match="needs collide"):
        sim.solve(pause=3)
    arrays = Thesis(bodies=5).build(1, 0).finalize()
    colored = dc.Simulation(*arrays, schedule="color")
    colored.collide(0.01)
    with pytest.raises(ValueError, match="only 'world' can pause"):
        colored.solve(pause=3)
    kept = dc.Simulation(*Thesis(bodies=5).build(1, 0).finalize(), config=dc.SolverConfig(history=True, max_sweeps=10))
    kept.collide(0.01)
    with pytest.raises(ValueError, match=r"config.max_sweeps is 20; the solver keeps the history of 10"):
        kept.solve(replace(kept.config, max_sweeps=20))
