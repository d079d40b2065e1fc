"""Scenes and recorded states of the bench ``error_time``: contact problems from impact to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

import dc_kernels as dc
from bench.cases import DT
from dc_kernels.measure import contact_slots
from pipeline import scenes

DECADES = 4.0  # of densities in a pile of mixed masses
LADDER = (1, 3, 10, 30, 100, 300, 1_000, 3_000, 10_000)


@dataclass(frozen=True, kw_only=True)
class MixedMasses(scenes.Thesis):
    """Thesis discs whose densities are log-uniform over four decades, the mean of their logarithm being ``density``."""

    name: ClassVar[str] = "mixed-masses"

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Places as in thesis, then a density for each disc."""
        low = self.radius * (1.0 + scenes.CLEARANCE)
        free, distance = self.side - 2.0 * low, 2.0 * low
        placed = scenes.place_discs([self.sampler(s, free) for s in streams], self.bodies, distance, (free, free)) + low
        material: dict[str, Any] = {**self.material}
        for stream, world in zip(streams, placed, strict=True):
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_open_box(builder, self.side, self.side)
            material["density"] = self.density * 10.0 ** stream.uniform(-0.5 * DECADES, 0.5 * DECADES, self.bodies)
            strip = np.floor(world[:, 0] / (2.0 * distance))
            builder.add_discs(world[np.lexsort((world[:, 1], strip))], self.radius, **material)


@dataclass(frozen=True, kw_only=True)
class HeavyOnLight(scenes.Scene):
    """Columns of boxes side by side, each carrying one that is 10, 100, 1000 and 10 000 times as heavy."""

    name: ClassVar[str] = "heavy-on-light"

    light: int = 4
    """Light boxes in each column [1]."""
    ratios: tuple[float, ...] = (1e1, 1e2, 1e3, 1e4)
    """Mass of the upper box over that of a light one [1]."""
    half_width: float = 0.5
    """Half of the boxes' side [m]."""
    jitter: float = 0.002
    """Largest sideways offset of a box, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The floor and the columns."""
        half = self.half_width
        width = 4.0 * half * len(self.ratios)
        self.add_static_chain(builder, [(-2.0 * half, 0.0), (width, 0.0)])
        for column, ratio in enumerate(self.ratios):
            for row, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.light + 1)):
                body = builder.add_body((4.0 * half * column + float(offset), (2 * row + 1) * half))
                density = self.density * (ratio if row == self.light else 1.0)
                builder.add_box(body, half, half, **{**self.material, "density": density})


@dataclass(frozen=True)
class Case:
    """A scene, and what is measured on it."""

    title: str
    scene: scenes.Scene
    steps: tuple[int, ...]
    """After which steps of 0.01 s a state is recorded; the last is at rest, and where runs begin."""
    seeds: tuple[int, ...] = (7,)
    """Worlds that are recorded."""
    cap: int = 10_000
    """Most sweeps of a solve [1]."""
    most: int = 50_000
    """Sweeps of the search for a reference beside Newton's method, at most [1]."""
    learned: bool = False
    """Whether ContactNet is a start: it has been trained on discs of one size."""
    seconds: float = 2.0
    """Simulated time of a run [s]."""
    repeats: int = 3
    """Timed calls of each solve; shorter solves get more [1]."""

    @property
    def ladder(self) -> tuple[int, ...]:
        """Numbers of sweeps at which errors are taken."""
        return tuple(n for n in LADDER if n <= self.cap)


CASES: dict[str, Case] = {
    "thesis_100": Case(
        "thesis world, 100 discs", scenes.Thesis(), (80, 100, 120, 140, 180, 1_000), (7, 8), learned=True, cap=10_000
    ),
    "thesis_1000": Case(
        "thesis world, 1 000 discs",
        scenes.Thesis(bodies=1_000),
        (150, 200, 300, 400, 500, 1_500),
        learned=True,
        cap=3_000,
    ),
    "pyramid": Case("pyramid of 465 boxes", scenes.Pyramid(rows=30), (2, 20, 100, 300), cap=3_000),
    "mixed": Case("300 discs, polygons, capsules", scenes.Mixed(bodies=300), (120, 160, 200, 250, 1_000), cap=3_000),
    "mixed_masses": Case(
        "300 discs, masses 1 to 1e4", MixedMasses(bodies=300), (120, 160, 200, 250, 1_000), cap=10_000
    ),
    "heavy_on_light": Case("boxes under 10 to 1e4 times their mass", HeavyOnLight(), (2, 20, 100, 300), cap=10_000),
    "thesis_10000": Case(
        "thesis world, 10 000 discs",
        scenes.Thesis(bodies=10_000),
        (200, 400, 700),
        cap=1_000,
        most=2_000,
        repeats=1,
        seconds=1.0,
    ),
}
QUICK = {
    "thesis_100": Case(
        "thesis world, 100 discs", scenes.Thesis(), (100, 140, 300), learned=True, cap=1_000, repeats=1, seconds=1.1
    ),
    "pyramid": Case("pyramid of 55 boxes", scenes.Pyramid(rows=10), (2, 100), cap=1_000, repeats=1, seconds=1.1),
}


@dataclass(frozen=True)
class State:
    """A world before a step: bodies and cached contacts, exact in float32."""

    scene: scenes.Scene
    seed: int
    step: int
    """Steps of 0.01 s so far."""
    bodies: dict[str, np.ndarray]
    """Fields of ``model.fields.STATE`` by name."""
    contacts: dict[str, np.ndarray]
    """What ``Simulation.restore_contacts`` takes."""
    dt: np.ndarray
    """Time step of the cached impulses, (1,) [s]."""
    models: dict[str, Any] = field(default_factory=dict, repr=False)
    """By dtype, once made."""

    def simulation(self, dtype: str = "float32", **options: Any) -> dc.Simulation:
        """A simulation that stands at this state; options of ``dc.Simulation``."""
        if dtype not in self.models:
            self.models[dtype] = self.scene.build(1, self.seed).finalize(dtype=dtype)
        model, state, joints = self.models[dtype]
        state, joints = state.copy(), joints.copy()  # simulations share a model, and nothing else
        sim = dc.Simulation(model, state, joints, **options)
        for name, values in self.bodies.items():
            state.assign(name, values.astype(state.numpy(name).dtype))
        contacts = {**self.contacts, "impulse": self.contacts["impulse"].astype(sim.dtype)}
        sim.restore_contacts(np.array([len(contacts["key"])]), contacts, self.dt.astype(sim.dtype))
        return sim


def capture(sim: dc.Simulation, scene: scenes.Scene, seed: int, step: int) -> State:
    """The state of a simulation of one world, between two steps."""
    slots, _ = contact_slots(sim.contacts)
    names = ("position", "angle", "velocity", "angular_velocity")
    return State(
        scene=scene,
        seed=seed,
        step=step,
        bodies={name: sim.state.numpy(name).copy() for name in names},
        contacts={name: sim.contacts.numpy(name)[slots].copy() for name in ("key", "impulse", "color", "age")},
        dt=sim.contacts.numpy("contact_dt").copy(),
    )


def record(case: Case) -> list[State]:
    """The states of a case, each step of which is solved to the tolerance; those of each world in order of time."""
    found = []
    for seed in case.seeds:
        model, state, joints = case.scene.build(1, seed).finalize()
        sim = dc.Simulation(model, state, joints, config=dc.SolverConfig.preset("accurate"))
        done = 0
        for step in case.steps:
            sim.run(step - done, DT)
            done = step
            found.append(capture(sim, case.scene, seed, step))
    return found
