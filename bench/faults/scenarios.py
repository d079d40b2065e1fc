"""Scenarios of threads and processes, one of which ``python -m bench.faults.scenarios NAME SEED`` runs.

What several threads or processes get at once is compared, bit for bit, with what one gets.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.runtime import stepping

GRID = dc.Grid(rows=31, columns=33, spacing=0.5)
POINTS = np.random.default_rng(0).uniform(0.0, 15.0, (400, 2))
START = [0, 150, 400]
STATE = ("position", "angle", "velocity", "angular_velocity", "time")
SCENARIOS: dict[str, Callable[[np.random.Generator], None]] = {}
PATIENCE = 240.0  # for a thread [s]


def scenario(function: Callable[[np.random.Generator], None]) -> Callable[[np.random.Generator], None]:
    """Register a scenario under its name."""
    SCENARIOS[function.__name__] = function
    return function


# ---------------------------------------------------------------------- jobs: bytes that have to be the same


def scene(k: int = 0, **options: Any) -> dc.Simulation:
    """Three worlds; k chooses bodies, shapes and dtype."""
    builder = dc.ModelBuilder()
    for _ in range(3):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 9), (0, 0), (9, 0), (9, 9)])
        builder.add_discs([(1.0 + i % 7 * 1.1, 0.6 + i // 7 * 1.05) for i in range(25 + 5 * k)], 0.5)
        if k % 2:
            builder.add_box(builder.add_body((4.0, 8.0)), 0.4, 0.3)
    return dc.Simulation(*builder.finalize("float64" if k // 2 % 2 else "float32"), **options)


def bits(sim: dc.Simulation) -> bytes:
    """The state of a simulation."""
    return b"".join(sim.state.numpy(name).tobytes() for name in STATE)


def simulate(k: int = 0, steps: int = 40, **options: Any) -> bytes:
    """A simulation's state after some steps."""
    sim = scene(k, **options)
    sim.run(steps, 0.01)
    return bits(sim)


def splat(threads: int = 1) -> bytes:
    """An image of points."""
    return bytes(dc.splat(POINTS, POINTS, GRID, start=START, threads=threads).tobytes())


def gather() -> bytes:
    """An image at points."""
    return bytes(dc.gather(np.ones((2, 2, 31, 33)), POINTS, GRID, start=START).tobytes())


def pairs() -> bytes:
    """Neighbours of points."""
    return bytes(dc.neighbor_pairs(POINTS, 0.9).tobytes())


def density() -> bytes:
    """Sums over neighbours."""
    return bytes(dc.sph_density(POINTS, np.ones(len(POINTS)), 1.0).tobytes())


def dual() -> bytes:
    """A world's contacts solved in Delassus form."""
    sim = scene()
    sim.run(30, 0.01)
    sim.collide(0.01)
    return bytes(delassus.solve(delassus.from_world(sim, 0)).impulses.tobytes())


def images() -> bytes:
    """Images of a simulation whose room grows."""
    sim = scene(contacts_per_body=0.2, pairs_per_shape=0.5)
    shown, found = dc.Images(sim, dc.ImageSpec(GRID)), b""
    for _ in range(4):
        sim.run(10, 0.01)
        found += dc.to_numpy(shown.splat()).tobytes()
    return found


JOBS: list[Callable[[], bytes]] = [
    lambda: simulate(0),
    lambda: simulate(1),
    lambda: simulate(2),
    lambda: simulate(3, threads=2),
    splat,
    lambda: splat(3),
    gather,
    pairs,
    density,
    dual,
    images,
]


def at_once(jobs: Sequence[Callable[[], Any]], count: int) -> list[Any]:
    """What so many threads get, which begin at the same time; None of one that raised or never ended."""
    barrier, found = threading.Barrier(count), [None] * count

    def work(i: int) -> None:
        barrier.wait()
        found[i] = jobs[i % len(jobs)]()

    workers = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(count)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(PATIENCE)
    return found


def drawn(rng: np.random.Generator, count: int) -> list[Callable[[], bytes]]:
    """Some of the jobs, in any order."""
    return [JOBS[i] for i in rng.permutation(len(JOBS))[:count]]


# ---------------------------------------------------------------------- scenarios


@scenario
def first_use(rng: np.random.Generator) -> None:
    """What nobody has made yet is asked for by two threads each."""
    jobs = drawn(rng, len(JOBS))
    found = at_once(jobs, 2 * len(jobs))
    assert found == 2 * [job() for job in jobs]


@scenario
def one_kind(rng: np.random.Generator) -> None:
    """Four threads call the same."""
    for job in drawn(rng, 5):
        assert at_once([job], 4) == 4 * [job()]


@scenario
def makers(rng: np.random.Generator) -> None:
    """One thread makes simulations, another splats and searches."""
    wanted, end = [splat(), pairs(), gather()], time.monotonic() + 2.0

    def make() -> None:
        while time.monotonic() < end:
            simulate(int(rng.integers(4)), 5)

    maker = threading.Thread(target=make)
    maker.start()
    while time.monotonic() < end:
        assert [splat(), pairs(), gather()] == wanted
    maker.join()


@scenario
def shards(rng: np.random.Generator) -> None:
    """Worlds are shared by threads, also where their room grows."""
    for k in rng.permutation(4):
        assert simulate(int(k), 60, threads=3, contacts_per_body=0.2) == simulate(int(k), 60)


@scenario
def one_simulation(rng: np.random.Generator) -> None:
    """Three threads step and draw one simulation that grows: those in the way are refused, no bit is lost."""
    sim, alone = scene(contacts_per_body=0.3), scene()
    shown, taken = dc.Images(sim, dc.ImageSpec(GRID)), []

    def work() -> bool:
        for _ in range(80):
            with contextlib.suppress(RuntimeError):
                sim.step(0.01)
                taken.append(1)
                shown.splat()
            sim.capacity(), sim.memory()
        return True

    assert at_once([work], 3) == [True] * 3
    alone.run(len(taken), 0.01)
    assert bits(sim) == bits(alone)


@scenario
def comings(rng: np.random.Generator) -> None:
    """One thread steps a simulation, others add to it and remove: those in the way are refused, nothing is lost."""
    sim, there = scene(contacts_per_body=0.3), list(range(2))
    lock = threading.Lock()

    def step() -> bool:
        for _ in range(80):
            with contextlib.suppress(RuntimeError):
                sim.step(0.01)
        return True

    def change() -> bool:
        for _ in range(30):
            with lock, contextlib.suppress(RuntimeError):
                more = sim.additions(int(rng.integers(3)))
                more.add_disc(more.add_body((float(rng.uniform(1.0, 8.0)), 8.0)), 0.3)
                there.extend(sim.add(more).bodies.tolist())
                sim.remove(bodies=there[-2])
                del there[-2]
        return True

    assert at_once([step, change, change], 3) == [True] * 3
    places = sim.index(bodies=there)
    assert np.isfinite(sim.state.numpy("position")[places]).all() and len(set(places.tolist())) == len(there)
    other = sim.clone()
    sim.run(20, 0.01)
    other.run(20, 0.01)
    assert bits(sim) == bits(other)


@scenario
def records(rng: np.random.Generator) -> None:
    """A thread records a graph of steps and splats while another runs both."""
    sims, wanted, out = [scene(), scene()], splat(), np.zeros((2, 2, 31, 33))
    for sim in sims:
        sim.run(20, 0.01)
    expected, found = simulate(1), []
    with wp.ScopedCapture(device="cpu") as capture:
        worker = threading.Thread(target=lambda: found.append([splat() for _ in range(20)] + [simulate(1)]))
        worker.start()
        sims[0].step(0.01)
        dc.splat(POINTS, POINTS, GRID, start=START, out=out)
        worker.join()
    assert found == [[wanted] * 20 + [expected]] and not out.any()
    for _ in range(7):
        wp.capture_launch(capture.graph)
    sims[1].run(7, 0.01)
    assert bits(sims[0]) == bits(sims[1]) and out.tobytes() == wanted


@scenario
def refused_records(rng: np.random.Generator) -> None:
    """What no graph can hold is refused, and works afterwards."""
    sim = scene(contacts_per_body=0.3)
    image = np.ones((1, 1, 31, 33))
    calls: list[Callable[[], Any]] = [
        pairs,
        density,
        lambda: sim.step(0.01, start=print),
        lambda: setattr(sim, "config", replace(sim.config, omega=1.1)),
        lambda: dc.gather(image, POINTS, GRID, dc.Stencil(), reverse=True),
    ]
    for i in rng.permutation(len(calls)):
        try:
            with wp.ScopedCapture(device="cpu"):
                calls[i]()
        except RuntimeError as error:
            assert "cannot be recorded in a graph" in str(error), error
        else:
            raise AssertionError(f"call {i} was recorded")
    sim.run(40, 0.01)
    assert bits(sim) == simulate()


@scenario
def forks(rng: np.random.Generator) -> None:
    """Children forked while a thread makes and steps simulations, after the pool's threads have begun."""
    stepping.WORTH_THREADS = 0
    sim, wanted, stop = scene(threads=2), (splat(), simulate(1)), threading.Event()
    sim.run(5, 0.01)
    splat(2)

    def work() -> None:
        while not stop.is_set():
            simulate(0, 5)

    worker = threading.Thread(target=work)
    worker.start()
    children = []
    for _ in range(4):
        child = os.fork()
        if not child:
            signal.alarm(60)
            sim.run(5, 0.01)
            os._exit(0 if (splat(2), simulate(1, threads=2)) == wanted else 3)
        children.append(child)
    codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
    stop.set()
    worker.join()
    assert codes == [0] * 4, codes


def both(k: int) -> tuple[bytes, bytes]:
    """A simulation and a splat, for another process."""
    return simulate(k), splat(2)


@scenario
def spawns(rng: np.random.Generator) -> None:
    """A pool of processes that start anew."""
    k = int(rng.integers(4))
    with multiprocessing.get_context(("spawn", "forkserver")[k % 2]).Pool(2) as pool:
        found = pool.map_async(both, [k] * 3).get(80.0)
    assert found == [both(k)] * 3


@scenario
def interrupts(rng: np.random.Generator) -> None:
    """Ctrl-C into a run on two threads: no thread works on, and all worlds stand at the same step."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background jobs ignore
    sim, alone = scene(threads=2, contacts_per_body=0.3), scene()
    sim.step(0.01)
    wait = float(rng.uniform(0.02, 0.2))
    threading.Timer(wait, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with contextlib.suppress(KeyboardInterrupt):
        sim.run(10**6, 0.01)
        raise AssertionError("no interrupt came")
    at, end = sim.state.numpy("time").copy(), bits(sim)
    time.sleep(0.1)
    assert (at == at[0]).all() and end == bits(sim), at
    while alone.state.numpy("time")[0] < at[0]:
        alone.step(0.01)
    assert bits(alone) == end


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    _, name, seed = sys.argv
    stream = np.random.default_rng(int(seed))
    sys.setswitchinterval(float(stream.choice([1e-6, 1e-4, 5e-3])))
    SCENARIOS[name](stream)
    print("done")
