"""What a scene pays for each feature that only one of its bodies uses, or that a setting turns on: time, and result.

A pile of discs at rest stands beside two witnesses, on a floor of their own that nobody else touches. Each row gives
one witness a feature, or the simulation a setting; everything else is the scene without it, which skips the feature.
Both are stepped in turn from the same state.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from pipeline import scenes

SUMMARY = "what a scene saves that lacks a feature: its time with one over without, and the difference of results"
KEYS = ("least_ratio", "largest_difference_mm")
THREADS = 1

DISCS, QUICK_DISCS = 1_000, 300
SETTLE = 300  # steps by which the pile has come to rest
ROUNDS, QUICK_ROUNDS = 15, 7
STEPS = 20  # of a round, timed together
AWAY = 1_000.0  # of the witnesses from the pile [m]


@dataclass(frozen=True)
class Row:
    """A feature: what uses it, and what is said of the pile's motion with it."""

    what: str
    body: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of the first witness's body."""
    shape: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of its shape."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the solver."""
    build: Callable[[dc.ModelBuilder, int, int], Any] | None = None
    """What else is added, given the builder and both witnesses."""
    slots: bool = False
    """There are as many empty slots as bodies."""
    beside: Callable[[dc.Simulation], Callable[[], Any]] | None = None
    """What is done with the simulation once, and after the steps of each round, timed with them."""
    box: bool = False
    """The first witness is a box, not a disc."""
    reason: str = ""
    """Why the pile moves otherwise, to rounding; empty where it must not."""


def come_and_go(sim: dc.Simulation) -> Callable[[], Any]:
    """Add a disc and remove it: from then on there are ids and slots."""
    more = sim.additions()
    more.add_disc(more.add_body((2.0 * AWAY, 0.0)), 0.5)
    sim.remove(bodies=sim.add(more).bodies)
    return lambda: None


def ask(sim: dc.Simulation) -> Callable[[], Any]:
    """Make a tree for queries of where the bodies are."""
    return dc.Queries(sim).update


GENERAL = "rows of discs leave out what is zero for them, so sums round otherwise"
OWN = GENERAL + "; a solve looks at joints, too"
ROWS: Mapping[str, Row] = {
    "polygon": Row("a box among discs: all shapes' narrowphase and rows", box=True, reason=GENERAL),
    "joint": Row(
        "a distance joint: its rows, among general ones",
        build=lambda builder, a, b: builder.add_distance_joint(a, b),
        reason=GENERAL + "; a world with joints ends by its tolerances",
    ),
    "hinge": Row(
        "a hinge: rows with two bounds", build=lambda builder, a, b: builder.add_revolute_joint(a, b), reason=OWN
    ),
    "motor": Row(
        "a hinge with motor and limits",
        build=lambda builder, a, b: builder.add_revolute_joint(
            a, b, lower=-0.5, upper=0.5, motor_speed=1.0, max_motor_torque=1.0
        ),
        reason=OWN,
    ),
    "breaks": Row(
        "a hinge that may break",
        build=lambda builder, a, b: builder.add_revolute_joint(a, b, break_force=1e6),
        reason=OWN,
    ),
    "rod_across": Row(
        "a rod with a row across it, and its tree",
        build=lambda builder, a, b: builder.add_distance_joint(a, b, across=True),
        reason=OWN,
    ),
    "spring": Row("a spring", build=lambda builder, a, b: builder.add_distance_joint(a, b, frequency=1.0), reason=OWN),
    "rope": Row("a rope", build=lambda builder, a, b: builder.add_rope_joint(a, b), reason=OWN),
    "slider": Row("a slider", build=lambda builder, a, b: builder.add_prismatic_joint(a, b, (1.0, 0.0)), reason=OWN),
    "weld": Row("a weld", build=lambda builder, a, b: builder.add_weld_joint(a, b), reason=OWN),
    "suspension": Row("a wheel joint: a spring", build=lambda builder, a, b: builder.add_wheel_joint(a, b), reason=OWN),
    "target": Row(
        "a target that draws a body",
        build=lambda builder, a, b: builder.add_target_joint(a, b, (2.0, 0.0), max_force=1.0),
        reason=OWN,
    ),
    "gear": Row("a gear", build=lambda builder, a, b: builder.add_gear_joint(a, b, -1.0), reason=OWN),
    "general": Row(
        "a row of one's own",
        build=lambda builder, a, b: builder.add_general_joint(a, b, (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)),
        reason=OWN,
    ),
    "friction": Row("a coefficient of friction of its own", shape={"friction": 0.1}),
    "restitution": Row("a restitution: biases of impacts", shape={"restitution": 0.5}),
    "damping": Row("linear and angular damping", body={"linear_damping": 0.1, "angular_damping": 0.1}),
    "gravity_scale": Row("gravity scaled for a body", body={"gravity_scale": 0.5}),
    "fixed_rotation": Row("a body that does not turn", body={"fixed_rotation": True}),
    "surface_speed": Row("a belt", shape={"surface_speed": 0.1}, reason=GENERAL),
    "rolling": Row("rolling resistance: a row more of a contact", shape={"rolling_resistance": 0.05}, reason=GENERAL),
    "sensor": Row(
        "a sensor about a body: a look at each candidate pair",
        build=lambda builder, a, b: builder.add_disc(a, 0.7, sensor=True),
    ),
    "one_way": Row(
        "a one-way shape: a look at each contact",
        build=lambda builder, a, b: builder.add_disc(a, 0.1, density=0.0, one_way=(0.0, 1.0)),
    ),
    "contact_events": Row("pairs that touch, begin, end and hit, listed", config={"contact_events": True}),
    "contact_switches": Row("contacts that may be switched off", config={"contact_switches": True}),
    "continuous": Row("pairs followed along their way, nothing fast", config={"continuous": True}),
    "sleep": Row("sleep allowed, nobody asleep", config={"sleep": True, "sleep_time": 1e6}),
    "slots": Row("as many empty slots as bodies", slots=True),
    "population": Row("a body has come and gone", beside=come_and_go),
    "queries": Row("a tree for queries, made anew every 20 steps", beside=ask),
    "history": Row("the change of every sweep kept", config={"history": True}),
    "substeps": Row("two whole steps for each", config={"substeps": 2}, reason="steps are half as long"),
    "tgs_soft": Row(
        "soft contacts: four substeps", config={"method": "tgs_soft", "substeps": 4}, reason="another method altogether"
    ),
}


def simulation(row: Row, discs: int) -> dc.Simulation:
    """The pile and its witnesses."""
    builder = scenes.Settled(bodies=discs).build()
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, [(AWAY - 5.0, 0.0), (AWAY + 5.0, 0.0)])
    first = builder.add_body((AWAY - 1.0, 0.5), **row.body)
    if row.box:
        builder.add_box(first, 0.5, 0.5, **row.shape)
    else:
        builder.add_disc(first, 0.5, **row.shape)
    second = builder.add_body((AWAY + 1.0, 0.5))
    builder.add_disc(second, 0.5)
    if row.build is not None:
        row.build(builder, first, second)
    config = dataclasses.replace(dc.SolverConfig(), **row.config)
    sim = dc.Simulation(*builder.finalize(), config=config)
    if row.slots:
        sim.reserve(bodies=discs, shapes=discs)
    return sim


def measure(quick: bool) -> dict[str, Any]:
    """Ratios and differences of each row, the least ratio, and the largest difference that has no reason."""
    discs, rounds = (QUICK_DISCS, QUICK_ROUNDS) if quick else (DISCS, ROUNDS)
    without = simulation(Row(""), discs)
    without.run(SETTLE, DT)
    begin = {name: without.state.numpy(name).copy() for name in ("position", "angle", "velocity", "angular_velocity")}
    rows = {}
    for name, row in ROWS.items():
        timing.progress(name)
        rows[name] = measure_row(row, discs, begin, rounds)
    return {
        "least_ratio": min(found["ratio"] for found in rows.values()),
        "largest_difference_mm": max(rows[name]["difference_mm"] for name, row in ROWS.items() if not row.reason),
        "rows": rows,
    }


def measure_row(row: Row, discs: int, begin: Mapping[str, np.ndarray], rounds: int) -> dict[str, Any]:
    """Time with the feature over without [1], both [us a step], and how far bodies of the pile end apart [mm]."""
    sims = {"without": simulation(Row(""), discs), "with": simulation(row, discs)}
    for sim in sims.values():
        for name, values in begin.items():
            sim.state.numpy(name)[: len(values)] = values  # empty slots lie behind
        sim.run(STEPS, DT)
    beside = {"without": None, "with": row.beside and row.beside(sims["with"])}

    def once(name: str) -> None:
        """Steps of a round."""
        sims[name].run(STEPS, DT)
        if then := beside[name]:
            then()

    times: dict[str, list[float]] = {name: [] for name in sims}
    for k in range(rounds):
        for name in list(sims)[:: -1 if k % 2 else 1]:
            times[name].append(timing.seconds(lambda name=name: once(name)))  # type: ignore[misc]
    pile = [sim.state.numpy("position")[: discs + 1].astype(np.float64) for sim in sims.values()]
    return {
        "ratio": statistics.median(one / other for one, other in zip(times["with"], times["without"], strict=True)),
        **{f"{name}_us": 1e6 * statistics.median(spent) / STEPS for name, spent in times.items()},
        "difference_mm": 1e3 * float(np.abs(pile[0] - pile[1]).max()),
        "variant": sims["with"].variant,
    }


def report(values: dict[str, Any]) -> str:
    """A table for people."""
    rows = [
        (
            ROWS[name].what,
            f"{found['without_us']:.0f}",
            f"{found['with_us']:.0f}",
            f"{found['ratio']:.3f}",
            f"{found['difference_mm']:.1e}" if found["difference_mm"] else "0",
            ROWS[name].reason,
        )
        for name, found in values["rows"].items()
    ]
    head = ("a feature of one body, or a setting", "without [us]", "with [us]", "ratio", "difference [mm]")
    return timing.table((*head, "why"), rows)
