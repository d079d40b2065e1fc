"""Shards of worlds: rounds until one halts, on one thread or several, launched from Python or by their addresses."""

from __future__ import annotations

import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels.runtime import launches, stepping
from dc_kernels.runtime.sequences import Rounds, Watch
from dc_kernels.runtime.stepping import Shards
from dc_kernels.runtime.threads import uninterrupted

WORLDS = 6


class Worlds:
    """Counters of rounds, one a world; world w runs full at the round ``full[w]``, and uses as much as it counts."""

    def __init__(self, threads, full):
        self.count, self.flags = np.zeros(WORLDS, np.int32), np.zeros(WORLDS, np.int32)
        self.full = full
        self.shards = Shards(WORLDS, 10 * WORLDS, threads, tiles=True)
        self.rounds = self.shards.rounds(self.bind, Watch(self.flags, 2, (self.count,)), together=True)

    def bind(self, first, count):
        def launch():
            for w in range(first, first + count):
                if self.flags[w] == 0:
                    self.count[w] += 1
                    if self.count[w] == self.full.get(w):
                        self.flags[w] = 2

        return [launch]


def in_tiles(monkeypatch):
    """Let one thread take worlds of 20 bodies one after the other, from the first round on."""
    monkeypatch.setattr(stepping, "TILE", 20)
    monkeypatch.setattr(stepping, "WORTH_TILES", 1)


@pytest.mark.parametrize(
    ("threads", "worth", "tiled"),
    [(1, 10**9, 0), (3, 10**9, 0), (3, 0, 0), (3, 600, 0), (1, 10**9, 1), (1, 0, 1), (1, 600, 1)],
)
def test_all_rounds_are_taken_however_often_some_world_runs_full(monkeypatch, threads, worth, tiled):
    """With a bar of 600 the work is shared at first, and the rest of each shard taken by one thread."""
    monkeypatch.setattr(stepping, "WORTH_THREADS", worth)
    if tiled:
        in_tiles(monkeypatch)
    worlds = Worlds(threads, {0: 7, 5: 7, 3: 15})
    left, halts = 20, 0
    while worlds.shards.run(worlds.rounds, left):
        halts += 1
        left = worlds.shards.left
        assert sum(left) < 20 * len(left)
        worlds.flags[...] = 0
    assert (worlds.count == 20).all()
    assert 2 <= halts <= 3
    assert len(worlds.rounds) == (4 if tiled else 7 if threads > 1 else 1)
    assert worlds.shards.peak.max() == 20


def test_a_round_from_which_no_bit_halts_goes_on():
    worlds = Worlds(1, {})
    worlds.flags[2] = 1  # another bit
    assert not worlds.shards.run(worlds.rounds, 5)
    assert list(worlds.count) == [5, 5, 0, 5, 5, 5]


def interrupt(monkeypatch, when, *, first=False):
    """Interrupt the present thread right after it has taken rounds, for the time so many: before it counts them.

    ``first``: other threads wait until it has, or they might take all of them.
    """
    here, take, count, calls, begun = threading.current_thread(), Rounds.take, Rounds.count, [], threading.Event()

    def take_or_wait(rounds, longest):
        if first and threading.current_thread() is not here:
            assert begun.wait(60.0)
        return take(rounds, longest)

    def count_or_raise(rounds):
        if threading.current_thread() is here:
            begun.set()
            calls.append(rounds)
            if len(calls) == when:
                raise KeyboardInterrupt
        return count(rounds)

    monkeypatch.setattr(Rounds, "take", take_or_wait)
    monkeypatch.setattr(Rounds, "count", count_or_raise)


@pytest.mark.parametrize(("threads", "worth"), [(2, 0), (2, 10**9), (1, 0)])
@pytest.mark.parametrize("room", [0.2, 2.5])
@pytest.mark.parametrize("when", [1, 2, 3])
def test_an_interrupt_leaves_all_worlds_after_the_same_step(monkeypatch, when, room, threads, worth):
    """Whatever the threads have taken of it, and whether a world was about to get more room."""
    monkeypatch.setattr(stepping, "WORTH_THREADS", worth)
    monkeypatch.setattr(stepping, "AT_ONCE", 10**3)
    alone = pile()
    if threads == 1:
        in_tiles(monkeypatch)
    sim = pile(threads=threads, contacts_per_body=room)
    assert len(sim.ranges) == 3
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        interrupt(patch, when)
        sim.run(3000, 0.01)
    time = sim.state.numpy("time")
    steps = int(np.argmin(np.abs(np.arange(3001) * 0.01 - time[0])))
    assert 0 < steps < 3000 and (time == time[0]).all() and sim.phase == "advance"
    alone.run(steps, 0.01)
    sim.run(30, 0.01)
    alone.run(30, 0.01)
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))


@pytest.mark.parametrize("worth", [0, 10**9])
def test_an_interrupted_phase_has_ended_in_all_worlds_and_is_not_taken_twice(monkeypatch, worth):
    monkeypatch.setattr(stepping, "WORTH_THREADS", worth)
    sim, alone = pile(threads=2), pile()
    for one in (sim, alone):
        one.run(40, 0.01)
    for phase, call in (("collide", lambda: sim.collide(0.01)), ("solve", sim.solve), ("advance", sim.advance)):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            interrupt(patch, 1, first=True)
            call()
        assert sim.phase == phase
    with pytest.raises(ValueError, match="needs solve"):
        sim.advance()
    alone.step(0.01)
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))


def test_an_interrupt_is_held_back_until_the_block_has_ended():
    done = []
    with pytest.raises(KeyboardInterrupt):
        with uninterrupted():
            with uninterrupted():
                signal.raise_signal(signal.SIGINT)
                done.append(1)
            done.append(2)
        done.append(3)
    assert done == [1, 2]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def pile(worlds=3, **options):
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 9), (0, 0), (9, 0), (9, 9)])
        builder.add_discs([(1.0 + i % 7 * 1.1, 1.0 + i // 7 * 1.1) for i in range(20)], 0.5)
    return dc.Simulation(*builder.finalize(), **options)


def test_small_worlds_in_tiles_have_the_bits_of_all_at_once(monkeypatch):
    """They grow, fall asleep and wake each in its own time; 48 worlds of 21 bodies are the two tiles that they are."""
    sims = []
    for tile in (stepping.TILE // 2, 10**9):
        monkeypatch.setattr(stepping, "TILE", tile)
        sim = pile(48, config=dc.SolverConfig(sleep=True, sleep_time=0.2), contacts_per_body=0.2, pairs_per_shape=0.5)
        sim.state.numpy("velocity")[5, 0] = 20.0
        for _ in range(4):
            sim.run(100, 0.01)
        sim.state.numpy("velocity")[-1] = (3.0, 9.0)
        sim.step(0.01)
        sim.run(30, 0.01)
        sims.append(sim)
    tiled, whole = sims
    assert len(tiled.ranges) == 2 and len(whole.ranges) == 1
    assert 0 < tiled.asleep.sum() < tiled.model.body_count
    assert tiled.capacity() == whole.capacity()
    for name in ("position", "angle", "velocity", "angular_velocity", "time"):
        np.testing.assert_array_equal(tiled.state.numpy(name), whole.state.numpy(name))


def test_launches_by_address_and_by_warp_give_the_same(monkeypatch):
    """A version of Warp that is not known has its launches made one by one; room, peaks and bits agree."""
    assert wp.__version__.startswith(launches.PACKED)
    sims = [pile(contacts_per_body=0.2, pairs_per_shape=0.5, threads=2)]
    monkeypatch.setattr(launches, "PACKED", ())
    sims.append(pile(contacts_per_body=0.2, pairs_per_shape=0.5, threads=2))
    for sim in sims[::-1]:
        for _ in range(3):
            sim.run(20, 0.01)
        sim.collide(0.01)
        sim.solve(replace(sim.config, max_sweeps=5))
        sim.advance()
        monkeypatch.undo()
    by_address, by_warp = sims
    assert by_address.capacity() == by_warp.capacity()
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(by_address.state.numpy(name), by_warp.state.numpy(name))


def test_peaks_are_those_of_all_steps_not_of_the_last():
    """A pile that falls apart used more room before than at the end."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_discs([(0.0, 0.0), (0.99, 0.0)], 0.5)
    model, state, joints = builder.finalize()
    sim = dc.Simulation(model, state, joints)
    sim.step(0.01)
    state.numpy("velocity")[:] = [(-20.0, 0.0), (20.0, 0.0)]
    sim.run(50, 0.01)
    assert sim.capacity()["contacts"] == {"reserved": 5, "used": 0, "peak_of_a_world": 1}


def test_the_layout_version_changes_when_arrays_do_and_the_phase_follows_the_calls():
    sim = pile(contacts_per_body=0.2)
    version, impulse = sim.layout_version, sim.contacts.impulse
    assert sim.phase == "advance"
    sim.collide(0.01)
    assert sim.phase == "collide"
    sim.solve()
    assert sim.phase == "solve"
    sim.advance()
    assert sim.phase == "advance"
    sim.run(300, 0.01)
    assert sim.contacts.impulse is not impulse
    assert sim.layout_version != version
    version = sim.layout_version
    sim.run(5, 0.01)
    assert sim.layout_version == version
    sim.config = replace(sim.config, history=True)
    assert sim.layout_version != version
    version = sim.layout_version
    sim.config = replace(sim.config, tolerance=1e-3)
    assert sim.layout_version == version
