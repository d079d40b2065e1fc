"""Several Python threads at once: they make kernels one at a time, launch side by side, and change no bit."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels._warp.common import OPTIMIZATION
from dc_kernels.learn.channels import OUTPUT
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.runtime import stepping, threads
from dc_kernels.runtime.building import building

GRID = dc.Grid(rows=16, columns=16, spacing=0.5)
POINTS = np.random.default_rng(0).uniform(1.0, 6.0, (60, 2))
# each job on two threads of a new process: what nobody has made yet is asked for at the same time
FIRST_USE = """
import sys, threading
import numpy as np
import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels._warp import common

common.OPTIMIZATION.update(LEVELS)
sys.setswitchinterval(1e-6)
grid = dc.Grid(rows=16, columns=16, spacing=0.5)
points = np.random.default_rng(0).uniform(1.0, 6.0, (60, 2))

def simulate(k):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5)
    ball = builder.add_body((0.0, 1.0))
    builder.add_box(ball, 0.3, 0.2) if k % 2 else builder.add_disc(ball, 0.3)
    sim = dc.Simulation(*builder.finalize(("float32", "float64")[k // 2]))
    sim.run(30, 1 / 60)
    return sim.state.numpy("position")

def solve():
    one = dict(row_start=[0, 1], column=[0], block=np.eye(2)[None], q=[[-1.0, 0.5]], mu=[0.3])
    return delassus.solve(delassus.DelassusProblem(**one)).impulses

jobs = [
    *(lambda k=k: simulate(k) for k in range(4)),
    lambda: dc.splat(points, points, grid),
    lambda: dc.gather(np.ones((1, 2, 16, 16)), points, grid),
    lambda: dc.neighbor_pairs(points, 0.5),
    solve,
]
count = 2 * len(jobs)
barrier, results = threading.Barrier(count), [None] * count

def work(i):
    barrier.wait()
    results[i] = jobs[i % len(jobs)]().tobytes()

workers = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(count)]
[worker.start() for worker in workers]
[worker.join(200.0) for worker in workers]
assert results == 2 * [job().tobytes() for job in jobs]
print("same bits")
"""


def simulation(worlds=2, discs=6, **options):
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 9), (0, 0), (9, 0), (9, 9)])
        builder.add_discs([(1.0 + i % 7 * 1.1, 1.0 + i // 7 * 1.1) for i in range(discs)], 0.5)
    return dc.Simulation(*builder.finalize(), **options)


def on_a_thread(function, seconds=200.0):
    """What a function returns or raises on a thread of its own, or TimeoutError."""
    found = Future()

    def work():
        try:
            found.set_result(function())
        except BaseException as error:
            found.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return found.result(seconds)


def test_the_first_use_may_come_from_many_threads():
    """Defined, hashed, compiled and loaded without a lock, kernels crash the process."""
    code = FIRST_USE.replace("LEVELS", repr(OPTIMIZATION))
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300)
    assert found.returncode == 0, found.stderr
    assert found.stdout == "same bits\n"


def test_splats_go_on_while_another_thread_makes_simulations():
    wanted, made, splats = dc.splat(POINTS, POINTS, GRID), 0, 0
    simulation().run(3, 0.01)
    beside = threading.Event()

    def make():
        nonlocal made
        for k in range(20):
            if k == 10:  # a busy machine may not have let the splats begin
                beside.wait(200.0)
            simulation().run(3, 0.01)
            made += 1

    maker = threading.Thread(target=make, daemon=True)
    maker.start()
    while maker.is_alive():
        np.testing.assert_array_equal(dc.splat(POINTS, POINTS, GRID), wanted)
        splats += 1
        beside.set()
    assert made == 20 and splats > 0


def test_what_is_made_already_waits_for_no_thread_that_makes_kernels():
    sim = simulation()
    sim.step(0.01)
    image = np.zeros((1, 2, 16, 16))
    splat = dc.Transfer(GRID).at(POINTS).splat(POINTS, image)
    dc.splat(POINTS, POINTS, GRID)
    with building():
        assert on_a_thread(lambda: (sim.run(5, 0.01), splat(), dc.splat(POINTS, POINTS, GRID), simulation()))


def test_calls_of_one_splat_by_tiles_wait_for_each_other():
    """They share what they count the points of tiles in."""
    grid = dc.Grid(rows=1500, columns=1500, spacing=0.01)
    points = np.random.default_rng(3).uniform(0.0, 15.0, (20_000, 2)).astype(np.float32)
    values, image = np.ones((20_000, 1), np.float32), np.zeros((1, 1, 1500, 1500), np.float32)
    splat = dc.Transfer(grid).at(points).splat(values, image)
    splat()
    wanted = image.copy()
    threads.map_threads(lambda _: splat(), range(20), 4)
    np.testing.assert_array_equal(image, wanted)


def entries(sim):
    """Every call of a simulation and of what works on it, by name; each may follow those before it."""
    images = dc.Images(sim, dc.ImageSpec(GRID))
    reader = SolveReader(sim, GRID)
    image = np.zeros((len(sim.state.numpy("time")), 2, 16, 16), np.float32)
    cached = {name: sim.contacts.numpy(name)[:0] for name in ("key", "impulse", "color", "age")}
    none = np.zeros(len(sim.state.numpy("time")), np.int32)
    return {
        "step": lambda: sim.step(0.01),
        "run": lambda: sim.run(3, 0.01),
        "run of no step": lambda: sim.run(0, 0.01),
        "collide": lambda: sim.collide(0.01),
        "from_world": lambda: delassus.from_world(sim),
        "solve": sim.solve,
        "solve that pauses": lambda: sim.solve(pause=1),
        "begin": reader.begin,
        "read": lambda: reader.read(np.flatnonzero(sim.running), begin=True),
        "correct": lambda: reader.correct(np.zeros((reader.count, len(OUTPUT)), np.float32)),
        "resume": sim.resume,
        "refine": lambda: delassus.refine(sim, 1e-9),
        "advance": sim.advance,
        "warmup": sim.warmup,
        "config": lambda: setattr(sim, "config", replace(sim.config, max_sweeps=sim.config.max_sweeps + 1)),
        "save": lambda: sim.save(os.devnull),
        "restore_contacts": lambda: sim.restore_contacts(none, cached, none.astype(np.float32)),
        "images": lambda: dc.Images(sim, dc.ImageSpec(GRID)),
        "splat": images.splat,
        "impulse_image": images.impulse_image,
        "gather": lambda: images.gather(image),
        "start_from": lambda: images.start_from(image),
    }


def test_a_second_thread_is_told_at_once_that_a_simulation_is_at_work():
    """One waits within a step while the other tries every call: each is refused, and the bits are those of one."""
    sim, alone = simulation(), simulation()
    sim.run(20, 0.01)
    alone.run(22, 0.01)
    calls = entries(sim)
    begun, end = threading.Event(), threading.Event()

    def wait(_):
        begun.set()
        assert end.wait(200.0)

    worker = threading.Thread(target=lambda: sim.run(1, 0.01, callback=wait), daemon=True)
    worker.start()
    assert begun.wait(200.0)
    try:
        for name, call in calls.items():
            before = time.thread_time()
            with pytest.raises(RuntimeError, match=r"the simulation of 2 worlds and 14 bodies is at work in a call of"):
                call()
            assert time.thread_time() - before < 1.0 and worker.is_alive(), name
    finally:
        end.set()
        worker.join(200.0)
    sim.step(0.01)
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))


def test_threads_call_a_simulation_one_after_the_other(tmp_path):
    sim, alone = simulation(), simulation()
    sim.run(20, 0.01)
    alone.run(20, 0.01)
    theirs = entries(alone)
    for name, call in entries(sim).items():
        if name != "save":
            on_a_thread(call)
            theirs[name]()
    on_a_thread(lambda: sim.save(tmp_path / "snapshot.h5"))
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))


def test_threads_that_step_one_simulation_at_once_take_only_the_steps_that_returned():
    sim, alone = simulation(), simulation()
    taken, refused = [], []

    def work():
        for _ in range(200):
            try:
                sim.step(0.01)
            except RuntimeError:
                refused.append(1)
            else:
                taken.append(1)

    workers = [threading.Thread(target=work) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(200.0)
    assert len(taken) + len(refused) == 600
    alone.run(len(taken), 0.01)
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))


def test_several_calls_may_be_kept_from_other_threads():
    sim = simulation()
    with sim.calls:
        sim.collide(0.01)
        with pytest.raises(RuntimeError, match="at work in a call of another thread"):
            on_a_thread(sim.solve)
        sim.solve()
        sim.advance()
    on_a_thread(lambda: sim.step(0.01))


def test_a_thread_steps_while_another_records_a_graph():
    """Warp's launches of all threads believe that they are recorded; ours run, and the graph holds its own."""
    sim, recorded, alone = simulation(), simulation(), simulation()
    for one in (sim, recorded, alone):
        one.step(0.01)

    def work():
        sim.run(9, 0.01)
        other = simulation()
        other.run(10, 0.01)
        return dc.splat(POINTS, POINTS, GRID), other

    wanted = dc.splat(POINTS, POINTS, GRID)
    with wp.ScopedCapture(device="cpu") as capture:
        image, other = on_a_thread(work)
        recorded.step(0.01)
    np.testing.assert_array_equal(image, wanted)
    alone.run(9, 0.01)
    for one in (sim, other):
        np.testing.assert_array_equal(one.state.numpy("position"), alone.state.numpy("position"))
    for _ in range(9):
        wp.capture_launch(capture.graph)
    np.testing.assert_array_equal(recorded.state.numpy("position"), alone.state.numpy("position"))


@pytest.mark.parametrize("share", [False, True])
def test_a_second_thread_changes_no_bit_and_is_taken_where_it_pays(monkeypatch, share):
    sim, alone = simulation(5, 20, threads=3), simulation(5, 20)
    monkeypatch.setattr(stepping, "WORTH_THREADS", 0 if share else 10**9)
    shared = []  # threads asked for; whether the second finds anything left is a race
    together = stepping.run_together
    monkeypatch.setattr(stepping, "run_together", lambda work, n, stop: (shared.append(n), together(work, n, stop))[1])
    for steps in (1, 40, 3):
        sim.run(steps, 0.01)
        alone.run(steps, 0.01)
    for name in ("position", "velocity", "angle"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))
    assert shared == [3] * 3 * share


def test_results_come_in_order_and_an_error_arrives_when_all_have_ended():
    assert threads.map_threads(lambda i: i * i, range(20), 4) == [i * i for i in range(20)]
    begun, ended = threading.Event(), threading.Event()

    def fail(i):
        if i == 0:
            assert begun.wait(200.0)
            raise ZeroDivisionError
        begun.set()
        time.sleep(0.05)
        ended.set()

    with pytest.raises(ZeroDivisionError):
        threads.map_threads(fail, range(2), 2)
    assert ended.is_set()


def test_a_task_may_share_its_own_work():
    """The thread that calls works too, so that tasks of a full pool never wait for each other."""

    def task(_):
        return sum(threads.map_threads(lambda i: i, range(50), 4))

    many = 4 * (os.cpu_count() or 1)
    assert on_a_thread(lambda: threads.map_threads(task, range(many), many)) == [1225] * many


def takes_of(trial, seconds, count):
    """The ways that are taken, True for the other, if each takes what ``seconds`` says."""
    taken = []
    for _ in range(count):
        taken.append(trial.other)
        trial.took(seconds[trial.other])
    return taken


@pytest.mark.parametrize("gains", [True, False])
def test_the_faster_way_is_taken_and_the_other_tried_now_and_then(gains):
    trial = threads.Trial()
    seconds = {gains: 1.0, not gains: 2.0}
    taken = takes_of(trial, seconds, 4 * threads.SURE_TRIES)
    assert taken == [True, True, False, False] * threads.SURE_TRIES
    taken = takes_of(trial, seconds, 10_000)
    assert set(taken[: threads.LEAST_TAKES]) == {gains}
    slow = taken.count(not gains)
    of_a_trial = 2 * threads.TRIES
    assert 2 * of_a_trial <= slow <= of_a_trial * (10_000 / threads.MOST_TAKES + 10)
    # what was slow has become fast, perhaps within a trial
    change = threads.MOST_TAKES + 8 * threads.TRIES + threads.LEAST_TAKES
    taken = takes_of(trial, {gains: 2.0, not gains: 1.0}, change)
    # but for a trial, of which half the takes are of the other way
    assert taken[-threads.LEAST_TAKES :].count(gains) <= of_a_trial


def test_a_way_that_gains_nothing_is_not_changed_to():
    trial = threads.Trial()
    taken = takes_of(trial, {True: 1.0, False: 0.99}, 5_000)
    assert taken[-1] and taken.count(False) < 50


@pytest.mark.parametrize("gains", [True, False])
def test_what_else_the_machine_does_decides_no_trial(gains):
    """A take in eleven lasts ten times as long, and the first one of a way after the other twice as long."""
    trial, before, taken = threads.Trial(), None, []
    for i in range(5_000):
        way = trial.other
        disturbed = 10.0 if i % 11 == 3 else 2.0 if way != before else 1.0
        trial.took(disturbed * (1.0 if way == gains else 1.2))
        before = way
        taken.append(way)
    settled = taken[4 * threads.FIRST_TRIES :]
    assert settled.count(gains) > 0.9 * len(settled)
