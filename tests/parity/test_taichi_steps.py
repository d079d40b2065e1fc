"""Whole steps as one kernel of Taichi's: runs, growth, threads and interrupts leave the bits of Warp's steps."""

from __future__ import annotations

import contextlib
import signal
import time
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime import stepping
from dc_kernels.runtime.sequences import PoolRounds
from tests.interrupting import interrupted, work_on
from tests.parity.scenes import discs

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)
DT = 0.01
ROOM = {"pairs_per_shape": 0.2, "contacts_per_body": 0.1}


def made(backend: str, **options: Any) -> dc.Simulation:
    """Worlds of discs that differ in size, as their kernels are compiled in half the time; one is empty."""
    builder = dc.ModelBuilder()
    for columns in (2, 5, 3, 1, 6, 4):
        discs(builder, columns, 7 - columns, friction=0.1 * columns)
    builder.add_world()
    config = dc.SolverConfig(max_sweeps=30)
    return dc.Simulation(*builder.finalize("float32", backend=backend), config=config, **options)


def assert_same(sim: dc.Simulation, want: dc.Simulation) -> None:
    """Both have the same state, and go on from the same contacts."""
    for name in ("position", "angle", "velocity", "angular_velocity", "time", "flags"):
        assert sim.state.numpy(name).tobytes() == want.state.numpy(name).tobytes(), name
    count = want.cache.numpy("count")
    np.testing.assert_array_equal(sim.cache.numpy("count"), count)
    for name in ("key", "impulse", "age"):
        for first, other, n in zip(*(s.contacts.numpy("contact_start") for s in (sim, want)), count):
            got = sim.cache.numpy(name)[first : first + n]
            assert got.tobytes() == want.cache.numpy(name)[other : other + n].tobytes(), name


@pytest.fixture(scope="module")
def taichi() -> dc.Simulation:
    """A simulation whose step is compiled once, for the threads of the pool."""
    return made("taichi", threads=2, **ROOM)


def test_a_run_has_the_bits_of_warp(taichi: dc.Simulation) -> None:
    warp = made("warp", **ROOM)
    taichi.run(150, DT)
    warp.run(150, DT)
    assert_same(taichi, warp)
    assert isinstance(taichi._phase_rounds("step")[0], PoolRounds)
    assert taichi.storage.solver.at_once == 7  # a world of its own in rows.past for each that may be in flight
    used = [{key: room["used"] for key, room in sim.capacity().items()} for sim in (taichi, warp)]
    assert used[0] == used[1]
    for sim in (taichi, warp):
        sim.run(3, DT, callback=lambda sim: None)
        sim.run(20, 0.5 * DT)
    assert_same(taichi, warp)


def test_an_interrupt_leaves_all_worlds_at_one_time(taichi: dc.Simulation) -> None:
    taichi.reset()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before, worked = signal.signal(signal.SIGPROF, interrupt), time.process_time()
    try:
        with pytest.raises(KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_PROF, 0.15)  # of work: a busy machine may not let it begin for longer
            taichi.run(10**7, DT)
    finally:
        signal.signal(signal.SIGPROF, before)
    assert time.process_time() - worked < 5.0
    reached = taichi.state.numpy("time")
    assert reached.min() == reached.max() > 0.0
    steps = round(reached[0] / DT)
    warp = made("warp")
    warp.run(steps, DT)
    taichi.run(2, DT)
    warp.run(2, DT)
    assert_same(taichi, warp)


def test_an_interrupt_ends_a_step_of_endless_sweeps(taichi: dc.Simulation) -> None:
    """A launch holds the interpreter's lock; all worlds are then at one time, with what impulses were found."""
    taichi.reset()
    taichi.run(20, DT)
    settings, before = taichi.config, taichi.state.numpy("time").copy()
    taichi.config = dc.SolverConfig(min_sweeps=2**31 - 1, max_sweeps=2**31 - 1)
    with interrupted():
        taichi.run(1000, DT)
    moved = taichi.state.numpy("time") - before
    assert moved.min() == moved.max() == pytest.approx(DT)
    assert taichi.running.sum() == 6 and np.isfinite(taichi.state.numpy("position")).all()
    taichi.config = settings
    taichi.run(2, DT)  # nothing is left of the interrupt
    assert not taichi.running.any()


def test_a_step_that_ends_in_time_is_whole(taichi: dc.Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepping, "GRACE", 20.0)
    config, found = dc.SolverConfig(min_sweeps=100_000, max_sweeps=1_000_000), []
    for stop, then in ((contextlib.nullcontext(), bool), (interrupted(stepping.GRACE), work_on)):
        taichi.reset()
        taichi.config = dc.SolverConfig(max_sweeps=30)
        taichi.run(20, DT)
        taichi.config = config
        with stop:
            taichi.run(1, DT)
            then()
        found.append([taichi.state.numpy(name).tobytes() for name in ("position", "velocity", "time")])
        assert taichi.stats.numpy("sweeps").max() >= 100_000
    assert found[0] == found[1]
