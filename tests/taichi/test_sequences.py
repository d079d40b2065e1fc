"""Launches as one kernel: rounds of shards, what ends them, arrays by their own names."""

from types import SimpleNamespace

import numpy as np
import pytest

from dc_kernels.runtime.backends import bind

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.runtime.sequences import repeated

T = group_types("float32")


@kernel
def count(tid, launch: T.Launch, state: T.State, stats: T.Stats):
    """Counts the rounds of a world that has no flag."""
    w = tid + launch.world_offset
    if state.flags[w] == 0:
        stats.sweeps[w] = stats.sweeps[w] + 1


@kernel
def flag(tid, launch: T.Launch, limit: ti.i32, state: T.State, stats: T.Stats, pairs: T.Pairs):
    """Flags a world that has counted up to a limit times its index; keeps the index of the padding body."""
    w = tid + launch.world_offset
    pairs.count[w] = launch.padding_body
    if stats.sweeps[w] == limit * w:
        state.flags[w] = 2


def given(worlds=6, offset=1, limit=3):
    """Groups of a few worlds, of which the first is left out."""
    return {
        "launch": SimpleNamespace(world_offset=offset, padding_body=100),
        "state": SimpleNamespace(flags=np.zeros(worlds, np.int32)),
        "stats": SimpleNamespace(sweeps=np.zeros(worlds, np.int32)),
        "pairs": SimpleNamespace(count=np.zeros(worlds, np.int32)),
        "limit": limit,
        "deferred": True,
    }


def repeat(values, starts, todo, stop_at=2, parallel=True):
    """The launch, and what it tells of each shard."""
    shards = len(starts) - 1
    told = {name: np.zeros(shards, np.int32) for name in ("taken", "halt")}
    told["peak"] = np.zeros((shards, 2), np.int32)
    launch = repeated(
        [bind(count, 5, values, "cpu"), bind(flag, 5, values, "cpu")],
        np.array(starts, np.int32),
        parallel=parallel,
        todo=np.array(todo, np.int32),
        flags=values["state"].flags,
        stop_at=stop_at,
        used=[values["stats"].sweeps, np.arange(10, 16, dtype=np.int32)],
        **told,
    )
    return launch, SimpleNamespace(**told)


@pytest.mark.parametrize("parallel", [False, True])
def test_shards_take_rounds_until_one_of_their_worlds_stops(parallel):
    values = given()
    launch, told = repeat(values, [0, 2, 5], [5, 20], parallel=parallel)
    launch()
    # worlds 1 and 2 stop after 3 and 6 rounds, worlds 3 to 5 after 9, 12 and 15
    assert values["stats"].sweeps.tolist() == [0, 3, 3, 9, 9, 9]
    assert told.taken.tolist() == [3, 9]
    assert told.halt.tolist() == [2, 2]
    assert told.peak.tolist() == [[3, 12], [9, 15]]
    assert values["state"].flags.tolist() == [0, 2, 0, 2, 0, 0]
    assert set(values["pairs"].count[1:].tolist()) == ({100, 108} if parallel else {100})
    values["state"].flags[:] = 0
    launch()  # goes on, each by as many
    assert told.taken.tolist() == [3 + 3, 9 + 3]
    assert values["stats"].sweeps.tolist() == [0, 6, 6, 12, 12, 12]


def test_other_flags_stop_nothing_and_no_rounds_are_none():
    values = given(limit=1)
    launch, told = repeat(values, [0, 1, 5], [4, 0], stop_at=4)
    launch()
    assert told.taken.tolist() == [4, 0]
    assert told.halt.tolist() == [0, 0]
    assert values["stats"].sweeps.tolist() == [0, 1, 0, 0, 0, 0]


def test_launches_that_differ_are_refused():
    one, other = given(), given()
    with pytest.raises(ValueError, match="sweeps is not the same in all launches"):
        repeated([bind(count, 5, one, "cpu"), bind(flag, 5, other, "cpu")], np.zeros(2, np.int32), **NOTHING)
    with pytest.raises(ValueError, match="no kernel over the worlds of the other launches"):
        repeated([bind(count, 5, one, "cpu"), bind(flag, 4, one, "cpu")], np.zeros(2, np.int32), **NOTHING)


NOTHING = {name: np.zeros(1, np.int32) for name in ("todo", "taken", "halt", "flags")}
NOTHING |= {"parallel": False, "stop_at": 0, "used": [], "peak": np.zeros((1, 1), np.int32)}
