"""What a step costs beside its kernels: Python around one body, a second thread where the work is small, creation.

The kernels' cost is that of a graph of the step, recorded by Warp, which replays it without Python.
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable
from typing import Any

from bench import timing

SUMMARY = "step() and run() of one body beside the recorded graph of a step, threads=2 on small scenes [us], creation"
KEYS = (
    *("step_over_graph_us", "run_over_graph_us", "step_us_1_body", "pymunk_us_1_body", "threads2_penalty_us"),
    *("creation_ms", "creation_unlike_ms"),
)
THREADS = 2

STEPS = 200  # timed together
ROUNDS, ROUNDS_QUICK = 31, 15
CREATED, CREATED_QUICK = 300, 200  # worlds that are made one after the other
PARTS = ("place", "finalize", "simulation", "first_step")
SIZES = ((2, 1), (4, 10), (16, 40), (64, 40))  # worlds and discs of each, for the second thread


def measure(quick: bool) -> dict[str, Any]:
    """Medians of a step [us], and the medians of differences within a round."""
    rounds = ROUNDS_QUICK if quick else ROUNDS
    return {
        **measure_one_body(rounds),
        **measure_threads(rounds),
        **measure_creation(CREATED_QUICK if quick else CREATED),
    }


def resting(worlds: int, discs: int, threads: int = 1) -> Any:
    """A simulation of so many discs side by side on the ground of each world, after 100 steps."""
    import dc_kernels as dc
    from bench import cases

    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world()
        builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 100.0, 0.5, center=(0.0, -0.5))
        builder.add_discs([(1.1 * i, 0.5) for i in range(discs)], 0.5)
    sim = dc.Simulation(*builder.finalize(), threads=threads)
    sim.warmup()
    sim.run(100, cases.DT)
    return sim


def resting_in_pymunk(gravity: tuple[float, float]) -> Callable[[], None] | None:
    """A step of one disc on the ground in pymunk, at its settings; None where it is not installed."""
    try:
        import pymunk
    except ImportError:
        return None
    from bench import cases

    space = pymunk.Space()
    space.gravity = gravity
    body = pymunk.Body(1.0, pymunk.moment_for_circle(1.0, 0.0, 0.5))
    body.position = (0.0, 0.5)
    space.add(pymunk.Segment(space.static_body, (-100.0, 0.0), (100.0, 0.0), 0.0))
    space.add(body, pymunk.Circle(body, 0.5))
    for _ in range(100):
        space.step(cases.DT)
    return lambda: space.step(cases.DT)


def measure_one_body(rounds: int) -> dict[str, Any]:
    """A step of one disc at rest: by ``step``, by ``run``, as a graph, in pymunk."""
    import warp as wp

    from bench import cases

    stepped, run, replayed = (resting(1, 1) for _ in range(3))
    with wp.ScopedCapture(device="cpu") as capture:
        replayed.step(cases.DT)
    calls = {
        "step": repeat(lambda: stepped.step(cases.DT)),
        "run": lambda: run.run(STEPS, cases.DT),
        "graph": repeat(lambda: wp.capture_launch(capture.graph)),
    }
    pymunk_step = resting_in_pymunk(tuple(stepped.model.numpy("gravity")[0].tolist()))
    if pymunk_step is not None:
        calls["pymunk"] = repeat(pymunk_step)
    times = {name: [1e6 * t / STEPS for t in spent] for name, spent in timing.interleave(calls, rounds).items()}
    found = timing.medians(times)
    over = {
        f"{name}_over_graph_us": statistics.median(a - b for a, b in zip(times[name], times["graph"], strict=True))
        for name in ("step", "run")
    }
    values = {f"{name}_us_1_body": found.get(name) for name in ("step", "run", "graph", "pymunk")}
    return {**over, **values}


def measure_threads(rounds: int) -> dict[str, Any]:
    """A step of small scenes with threads=1 and threads=2, and the most that the second loses."""
    from bench import cases

    values: dict[str, Any] = {}
    lost = []
    for worlds, discs in SIZES:
        sims = [resting(worlds, discs, threads) for threads in (1, 2)]
        calls = {str(i): repeat(lambda sim=sim: sim.step(cases.DT)) for i, sim in enumerate(sims)}  # type: ignore[misc]
        times = [[1e6 * t / STEPS for t in spent] for spent in timing.interleave(calls, rounds // 2).values()]
        lost.append(statistics.median(b - a for a, b in zip(*times, strict=True)))
        values |= {f"threads{i + 1}_us_{worlds * discs}": statistics.median(spent) for i, spent in enumerate(times)}
    return {**values, "threads2_penalty_us": max(lost)}


def measure_creation(worlds: int) -> dict[str, float]:
    """Medians of making a thesis world: all of it, its parts, and where no world has the model of one before."""
    from dataclasses import replace

    import dc_kernels as dc
    from bench import cases

    alike = cases.scenes.Thesis()
    unlike = [replace(alike, radius=alike.radius * (1.0 + 1e-4 * i)) for i in range(worlds)]
    spent: dict[str, list[float]] = {name: [] for name in (*PARTS, "all", "unlike")}
    for seed in range(-3, worlds):  # some beforehand, which compile and load
        begin = time.perf_counter()
        builder = alike.build(1, max(seed, 0))
        placed = time.perf_counter()
        groups = builder.finalize()
        finalized = time.perf_counter()
        sim = dc.Simulation(*groups)
        made = time.perf_counter()
        sim.step(cases.DT)
        stepped = time.perf_counter()
        dc.Simulation(*unlike[seed].build(1, max(seed, 0)).finalize())
        edges = (begin, placed, finalized, made, stepped)
        times = (*(b - a for a, b in itertools.pairwise(edges)), made - begin, time.perf_counter() - stepped)
        if seed >= 0:
            for name, value in zip(spent, times, strict=True):
                spent[name].append(value)
        del builder, groups, sim  # before the next one is made
    found = {name: 1e3 * value for name, value in timing.medians(spent).items()}
    parts = {f"creation_{name}_ms": found[name] for name in (*PARTS, "unlike")}
    return {"creation_ms": found["all"], **parts}


def repeat(call: Callable[[], Any]) -> Callable[[], None]:
    """One call that makes ``STEPS``."""

    def calls() -> None:
        for _ in itertools.repeat(None, STEPS):
            call()

    return calls


def creation_rows(values: dict[str, Any]) -> list[tuple[str, float]]:
    """What making a world takes, part by part."""
    return [
        ("places, a builder, `finalize`, `Simulation`", values["creation_ms"]),
        ("places and a builder", values["creation_place_ms"]),
        ("`finalize`", values["creation_finalize_ms"]),
        ("`Simulation`", values["creation_simulation_ms"]),
        ("all of it where no model is like one before", values["creation_unlike_ms"]),
        ("the first step, which binds the kernels", values["creation_first_step_ms"]),
    ]


def report(values: dict[str, Any]) -> str:
    """Tables for people."""
    graph = values["graph_us_1_body"]
    rows = [
        ("step()", values["step_us_1_body"], values["step_over_graph_us"]),
        ("run(), a step", values["run_us_1_body"], values["run_over_graph_us"]),
        ("recorded graph", graph, None),
        ("pymunk", values["pymunk_us_1_body"], None),
    ]
    sizes = [worlds * discs for worlds, discs in SIZES]
    shared = [(size, values[f"threads1_us_{size}"], values[f"threads2_us_{size}"]) for size in sizes]
    return "\n\n".join(
        (
            timing.table(("one body at rest [us]", "median", "over the graph"), rows),
            timing.table(("discs at rest, step() [us]", "threads=1", "threads=2"), [(f"{n}", *t) for n, *t in shared]),
            timing.table(("one thesis world [ms]", "median"), creation_rows(values)),
        )
    )
