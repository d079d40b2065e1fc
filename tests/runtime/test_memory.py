"""What would not fit into the memory is refused before it is allocated, with its name and size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.arrays import State
from dc_kernels.runtime.memory import check_memory, free_memory
from pipeline.scenes import scene

HUGE = dc.Grid(rows=2**23, columns=2**23, spacing=1.0)
GRID = dc.Grid(rows=64, columns=64, spacing=1.0)
POINTS, VALUES = np.full((1, 2), 2.5, np.float32), np.ones((1, 1), np.float32)


def discs(worlds: int, **options):
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        builder.add_disc(builder.add_body(), 0.5)
    return dc.Simulation(*builder.finalize(backend="numpy"), **options)


def test_what_is_free_is_known():
    assert 1e8 < free_memory() < 1e15
    check_memory("a little", 1e6)
    with pytest.raises(MemoryError, match=r"field would take 1e\+09 GB of memory; .* GB are free"):
        check_memory("field", 1e18)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("grid", lambda: dc.splat(POINTS, VALUES, HUGE)),
        ("2147483647 channels", lambda: dc.splat(POINTS, VALUES, GRID, bins=2**31 - 1, point_bin=[0])),
        ("worlds is 2147483647", lambda: scene("thesis").build(2**31 - 1)),
        ("of 2147483647 bodies", lambda: scene("thesis", bodies=2**31 - 1).build()),
        ("of 500000500000 bodies", lambda: scene("pyramid", rows=10**6).build()),
        ("State.* .body 1000000000000.", lambda: State({"body": 10**12, "world": 1}, "float32", backend="numpy")),
    ],
)
def test_huge_counts_are_refused_by_name(name, call):
    with pytest.raises(MemoryError, match=name):
        call()


@pytest.mark.parametrize(("worlds", "sweeps"), [(1, 2**31 - 1), (64, 2_000_000)])
def test_a_history_that_takes_long_to_clear_is_refused_and_nothing_has_changed(worlds, sweeps):
    sim = discs(worlds)
    before = sim.config
    with pytest.raises(MemoryError, match=rf"history of max_sweeps {sweeps} in {worlds} worlds .* may be 100000000"):
        sim.config = replace(before, history=True, max_sweeps=sweeps)
    with pytest.raises(MemoryError, match=f"max_sweeps {sweeps}"):
        discs(worlds, config=replace(before, history=True, max_sweeps=sweeps))
    assert sim.config == before
    sim.run(1, 0.01)


def test_steps_and_room_beyond_what_kernels_count_are_refused():
    sim = discs(1)
    with pytest.raises(ValueError, match="steps is 1000000000000"):
        sim.run(10**12, 0.01)
    with pytest.raises(ValueError, match="pairs_per_shape is 10000000000"):
        discs(1, pairs_per_shape=1e10)
