"""Threads within one world: the bits of one thread, whoever comes, comes late, or never does."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime import sequences, stepping, threads
from dc_kernels.runtime.sequences import BEGINS
from tests.interrupting import interrupted

STEPS = 4
JOB, MEMBERS = 1 + BEGINS, 2 + BEGINS  # lines of a team's memory: the leader's, and that of the members


@pytest.fixture(autouse=True)
def as_many_cores_as_asked_for(monkeypatch):
    monkeypatch.setattr(stepping, "usable_cores", lambda: 8)
    monkeypatch.setattr(stepping, "WORTH_HELP", 100)
    monkeypatch.setattr(threads.Trial, "took", lambda *_: None)  # helpers are always asked, whether it pays or not


def heap(discs=1600, worlds=1, shape="disc", walls_first=True, dtype="float32", **options):
    """Bodies on a lattice that touch and fall upon each other: colours of many blocks from the first step on."""
    builder = dc.ModelBuilder()
    side = int(discs**0.5)

    def add_walls():
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(-1.0, side + 9.0), (-1.0, 0.0), (side + 1.0, 0.0), (side + 1.0, side + 9.0)])

    for _ in range(worlds):
        builder.add_world()
        if walls_first:
            add_walls()
        for i in range(discs):
            at = (0.5 + i % side + 0.3 * (i // side % 2), 0.5 + 0.9 * (i // side))
            if shape == "disc":
                builder.add_disc(builder.add_body(at), 0.5)
            else:
                builder.add_box(builder.add_body(at), 0.5, 0.45)
        if not walls_first:
            add_walls()
    return dc.Simulation(*builder.finalize(dtype=dtype), config=dc.SolverConfig(max_sweeps=40), **options)


def ends(sim):
    """What a run has left, as bytes."""
    used = int(sim.contacts.numpy("contact_count")[0])
    groups = [sim.state.numpy(name) for name in ("position", "angle", "velocity", "angular_velocity")]
    groups += [sim.contacts.numpy(name)[:used] for name in ("key", "normal", "arm_b", "gap", "color", "impulse")]
    groups += [sim.rows.numpy("slot")[:used], sim.stats.numpy("sweeps"), sim.stats.numpy("residual")]
    return [np.ascontiguousarray(group).tobytes() for group in groups]


def jobs_of(sim):
    """How many jobs the first team of a simulation was led through."""
    return int(sim._shards._teams._memory[0, JOB].view(np.int64)[4]) // 2


def rests(sim, calm=False):
    """Whether the first team's leader missed somebody and opens no job for a while; ``calm`` lets it forget that."""
    line = sim._shards._teams._memory[0, JOB].view(np.int64)
    missed = bool(line[3])
    if calm:
        line[3] = line[5] = 0
    return missed


def members_of(sim):
    """How many threads are there beside the leader of the first team."""
    return int(sim._shards._teams._memory[0, MEMBERS].view(np.int32)[0])


def met(monkeypatch, sim):
    """Let no call of a simulation begin before all its members are there, and none of them counts as missed."""

    def run_helped(work, *others):
        def wait_and_work():
            end = time.monotonic() + 10.0
            while members_of(sim) < sim.threads - 1 and time.monotonic() < end:
                time.sleep(1e-4)
            rests(sim, calm=True)
            work()

        threads.run_helped(wait_and_work, *others)

    monkeypatch.setattr(stepping, "run_helped", run_helped)


def test_faster_threads_get_larger_shares():
    begins = np.zeros(3, np.int32)
    shares = sequences.Shares(begins)
    assert begins.tolist() == [0, 21845, 43691]
    speeds = np.array([1.0, 2.0, 1.0])
    for _ in range(8):
        shares.learn((np.array(shares.of) / speeds).tolist())
    np.testing.assert_allclose(shares.of, speeds / 4, rtol=0.03)
    assert begins.tolist() == [round(65536 * sum(shares.of[:p])) for p in range(3)]
    learned = list(shares.of)
    shares.learn([1.0, 1.02, 1.0])
    assert shares.of == learned
    for _ in range(20):
        shares.learn([1e-3, 1.0, 1e3])  # one that another process keeps from its core
    assert sum(shares.of) == pytest.approx(1.0) and min(shares.of) > 0.03


@pytest.mark.parametrize("shares", [(0.75, 0.25), (0.07, 0.93)])
def test_bits_do_not_depend_on_shares(monkeypatch, shares):
    monkeypatch.setattr(sequences.Shares, "learn", lambda *_: None)
    alone, sim = heap(900), heap(900, threads=2)
    sim._shards._teams._shares[0]._set(list(shares))
    met(monkeypatch, sim)
    for one in (alone, sim):
        one.run(STEPS, 0.01)
        one.run(STEPS, 0.01)
    assert jobs_of(sim) > 0
    assert ends(sim) == ends(alone)


@pytest.mark.parametrize(("shape", "acceleration"), [("disc", "adaptive"), ("box", "adaptive"), ("disc", "nncg")])
def test_bits_are_those_of_one_thread(monkeypatch, shape, acceleration):
    found = []
    for count in (1, 2, 5):
        sim = heap(900, shape=shape, threads=count)
        if count > 1:
            met(monkeypatch, sim)
        sim.config = dc.SolverConfig(max_sweeps=40, acceleration=acceleration)
        assert sim.threads == count
        sim.run(STEPS, 0.01)
        for _ in range(2):
            sim.collide(0.01)
            sim.solve(pause=7)
            sim.resume()
            sim.advance()
        found.append(ends(sim))
        assert jobs_of(sim) > 0 if count > 1 else not sim._shards.helpers
    assert found[1:] == found[:1] * 2


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_and_rows_of_many_discs_are_those_of_one_thread(monkeypatch, dtype):
    """More of them than one part has, with other shapes among the pairs or at their beginning, in room that grows."""
    for walls_first, room in ((True, 2.5), (False, 2.5), (True, 0.7)):
        found = []
        for count in (1, 2, 3, 4):
            sim = heap(2500, walls_first=walls_first, dtype=dtype, threads=count, contacts_per_body=room)
            if count > 1:
                met(monkeypatch, sim)
            for _ in range(3):
                before = jobs_of(sim) if count > 1 else 0
                sim.collide(0.01)
                if count > 1 and room > 1.0:
                    # a machine that takes a core from a member in the first job may make the leader do the second alone
                    assert jobs_of(sim) >= before + (2 if walls_first and not rests(sim) else 1)
                sim.solve()
                sim.advance()
            found.append(ends(sim))
        assert found[1:] == found[:1] * 3


def test_bits_do_not_depend_on_when_a_member_comes():
    """Each call has a new one, which meets the solve wherever that is."""
    sim = heap(900, threads=2)
    sim.run(2, 0.01)
    sim.config = dc.SolverConfig(max_sweeps=12, acceleration="none", stop="change", min_sweeps=12)
    found = set()
    for _ in range(150):
        sim.collide(0.01)
        sim.solve()
        found.add(sim.motion.numpy("solved").tobytes())
    assert len(found) == 1


def test_two_worlds_and_three_threads_help_where_there_is_work():
    one, many = heap(900, worlds=2), heap(900, worlds=2, threads=3)
    for sim in (one, many):
        sim.run(STEPS, 0.01)
    assert (one.threads, many.threads) == (1, 3)
    assert ends(one) == ends(many)


def test_a_member_that_never_comes_is_not_waited_for(monkeypatch):
    """The pool's threads are all taken; then there is one that leaves at once."""
    alone, sim = heap(), heap(threads=2)
    free = threading.Event()
    room = threads.thread_pool(1)._max_workers
    taken = [threads.thread_pool(1).submit(free.wait) for _ in range(room)]
    try:
        sim.run(STEPS, 0.01)
    finally:
        free.set()
    [one.result() for one in taken]
    assert jobs_of(sim) == 0
    alone.run(STEPS, 0.01)
    assert ends(sim) == ends(alone)
    monkeypatch.setattr(sequences, "PATIENCE", -100_000)
    hasty = heap(threads=2)
    hasty.run(STEPS, 0.01)
    assert ends(hasty) == ends(alone)


def test_the_bits_are_those_of_one_thread_while_both_ways_are_tried(monkeypatch):
    asked = []

    def took(trial, _):
        asked.append(trial.other)
        trial.other = len(asked) % 3 == 0

    monkeypatch.setattr(threads.Trial, "took", took)
    monkeypatch.setattr(stepping, "AT_ONCE", 1)
    alone, sim = heap(), heap(threads=2)
    for one in (alone, sim):
        one.run(12, 0.01)
        one.step(0.01)
        one.step(0.01)
    assert set(asked) == {True, False}
    assert ends(sim) == ends(alone)


def test_a_small_world_and_a_schedule_by_colours_take_one_thread(monkeypatch):
    assert heap(400, threads=2, schedule="color").threads == 1
    monkeypatch.setattr(stepping, "WORTH_HELP", 1000)
    assert heap(400, threads=2).threads == 1
    monkeypatch.setattr(stepping, "usable_cores", lambda: 1)
    assert heap(1600, threads=2).threads == 1


def test_a_world_that_grows_gets_the_threads_that_were_asked_for(monkeypatch):
    monkeypatch.setattr(stepping, "WORTH_HELP", 500)
    sims = [heap(400, threads=asked) for asked in (1, 2)]
    assert [sim.threads for sim in sims] == [1, 1]
    copies = [sim.clone() for sim in sims]
    for sim in (*sims, *copies):
        more = sim.additions(0)
        more.add_discs([(0.5 + i % 20, 20.5 + i // 20) for i in range(200)], 0.5)
        sim.add(more)
        sim.run(STEPS, 0.01)
    assert [sim.threads for sim in (*sims, *copies)] == [1, 2, 1, 2]
    assert all(ends(sim) == ends(sims[0]) for sim in (*sims, *copies))


def test_no_step_is_left_where_the_last_one_needs_room():
    """What mends an overflow takes the step; nothing is then left to be taken, or timed."""
    alone, sim = heap(400), heap(400, threads=2, contacts_per_body=0.0, pairs_per_shape=0.0)
    for one in (alone, sim):
        one.step(0.01)
        one.run(0, 0.01)
        one.run(STEPS, 0.01)
    assert ends(sim) == ends(alone)


def test_an_interrupt_leaves_a_world_at_a_whole_step():
    """The helper has left when the caller goes on; the run goes on with the bits of one that was not interrupted."""
    alone, sim = heap(), heap(threads=2)
    alone.run(60, 0.01)
    with interrupted():
        sim.run(100_000, 0.01)
    done = round(float(sim.state.numpy("time")[0]) / 0.01)
    assert done > 0
    assert members_of(sim) == 0
    if done < 60:
        sim.run(60 - done, 0.01)
        assert ends(sim) == ends(alone)


def test_a_forked_child_has_a_team_of_its_own():
    alone, sim = heap(), heap(threads=2)
    sim.run(1, 0.01)
    child = os.fork()
    if child == 0:
        sim.run(STEPS, 0.01)
        alone.run(1 + STEPS, 0.01)
        os._exit(0 if ends(sim) == ends(alone) else 1)
    assert os.waitpid(child, 0)[1] == 0
