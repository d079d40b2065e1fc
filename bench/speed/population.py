"""What a change of a scene that runs takes: bodies and joints that come and go, more slots, slots that stay empty.

Discs rest in a pile; what comes is put far above it and goes again, so that each round begins as the one before.
"""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from pipeline import scenes

SUMMARY = "adding and removing bodies, shapes and joints between steps, with and without room for them [us]"
KEYS = ("add_us", "remove_us", "slot_ns")
THREADS = 1

SIZES, QUICK_SIZES = (100, 10_000), (100, 1_000)
SETTLE = 100  # steps
ROUNDS, QUICK_ROUNDS = 40, 15
BATCH = 100  # bodies that come in one call
ABOVE = 1_000.0  # [m]


def pile(size: int) -> dc.Simulation:
    """Discs at rest, with room for those that come."""
    sim = dc.Simulation(*scenes.Settled(bodies=size).build().finalize())
    sim.run(SETTLE, DT)
    sim.reserve(bodies=BATCH, shapes=BATCH, vertices=4 * BATCH)
    sim.run(1, DT)
    return sim


def measure(quick: bool) -> dict[str, Any]:
    """Times of each size of pile; the largest times of one body, and of an empty slot in a step."""
    rows = {}
    for size in QUICK_SIZES if quick else SIZES:
        timing.progress(f"{size} discs")
        rows[f"{size}"] = measure_pile(size, QUICK_ROUNDS if quick else ROUNDS)
    return {**{key: max(row[key] for row in rows.values()) for key in KEYS}, "rows": rows}


def measure_pile(size: int, rounds: int) -> dict[str, float]:
    """Medians over rounds [us], and what an empty slot adds to a step [ns]."""
    sim = pile(size)
    times: dict[str, list[float]] = {}

    def clock(name: str, call: Any) -> Any:
        found = []
        times.setdefault(name, []).append(timing.seconds(lambda: found.append(call())))
        return found[0]

    def discs(count: int) -> dc.Additions:
        more = sim.additions()
        more.add_discs(np.stack([1.1 * np.arange(count), np.full(count, ABOVE)], axis=1), 0.5)
        return more

    for _ in range(rounds):
        clock("step_us", lambda: sim.step(DT))
        more = discs(1)
        added = clock("add_us", lambda more=more: sim.add(more))
        sim.step(DT)
        clock("remove_us", lambda added=added: sim.remove(bodies=added.bodies))
        sim.step(DT)
    for _ in range(rounds // 4):
        more = discs(BATCH)
        added = clock("add_batch_us", lambda more=more: sim.add(more))
        sim.step(DT)
        clock("remove_batch_us", lambda added=added: sim.remove(bodies=added.bodies))
        sim.step(DT)
    ids = sim.ids.numpy("body_id")
    first, second = np.flatnonzero((ids >= 0) & (sim.model.numpy("body_type") == dc.BodyType.DYNAMIC))[:2]
    for _ in range(rounds // 4):
        more = sim.additions()
        more.add_distance_joint(more.existing(int(ids[first])), more.existing(int(ids[second])))
        added = clock("add_joint_us", lambda more=more: sim.add(more))
        sim.step(DT)
        clock("remove_joint_us", lambda added=added: sim.remove(joints=added.joints))
        sim.step(DT)
    for k in range(rounds // 8):
        clock("grow_us", lambda k=k: sim.reserve(bodies=BATCH + 8 * (k + 1)))
        sim.step(DT)
    found = {name: 1e6 * statistics.median(spent) for name, spent in times.items()}
    return found | {"slot_ns": slot_cost(size, rounds)}


def slot_cost(size: int, rounds: int) -> float:
    """What an empty slot of a body and a shape adds to a step, where there are as many as bodies [ns]."""
    sims = [dc.Simulation(*scenes.Settled(bodies=size).build().finalize()) for _ in range(2)]
    for sim in sims:
        sim.run(SETTLE, DT)
    sims[1].reserve(bodies=size, shapes=size)
    steps = max(2_000 // size, 2)
    without, beside = sims
    spent = timing.interleave(
        {"without": lambda: without.run(steps, DT), "with": lambda: beside.run(steps, DT)}, rounds
    )
    more = statistics.median(b - a for a, b in zip(spent["without"], spent["with"], strict=True))
    return 1e9 * more / steps / size


def report(values: dict[str, Any]) -> str:
    """A table for people."""
    names = [name for name in next(iter(values["rows"].values())) if name.endswith("_us")]
    rows = [
        (size, *(f"{row[name]:.0f}" for name in names), f"{row['slot_ns']:.1f}") for size, row in values["rows"].items()
    ]
    return timing.table(("discs", *(name.removesuffix("_us").replace("_", " ") for name in names), "slot [ns]"), rows)
