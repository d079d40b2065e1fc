"""Sizes, time steps and distances from the origin: what dimensional analysis and the layout of numbers promise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import G as GRAVITY
from bench.cases import DT
from bench.stability.invariants import contact_table
from bench.verdicts import Cases, Check
from dc_kernels import measure
from pipeline import scenes

cases = Cases()
DTYPES = ("float32", "float64")


def scene_of_size(name: str, size: float) -> scenes.Scene:
    """A pile of discs, bodies of all kinds, or a stack, with bodies of ``size`` [m]."""
    if name == "stack":
        return scenes.Stack(bodies=5, half_width=0.5 * size, jitter=0.005 * size)
    return {"thesis": scenes.Thesis, "mixed": scenes.Mixed}[name](bodies=30, radius=0.5 * size)


def simulation(scene: scenes.Scene, dtype: str, config: dc.SolverConfig | None = None) -> dc.Simulation:
    """One world of a scene."""
    return dc.Simulation(*scene.build().finalize(dtype), config=config)


def moving(sim: dc.Simulation) -> Any:
    """Which bodies are dynamic."""
    return sim.model.numpy("body_type") == dc.BodyType.DYNAMIC


def far_from(sim: dc.Simulation, other: dc.Simulation, size: float) -> float:
    """Largest difference of positions [size] and angles [rad] from another simulation, whose bodies have 1 m."""
    there, here = (s.state.numpy("position").astype(np.float64) for s in (other, sim))
    turn = np.abs(sim.state.numpy("angle").astype(np.float64) - other.state.numpy("angle"))
    return float(max(np.abs(here / size - there).max(), turn.max()))


@cases.add
def sizes_similar(quick: bool) -> Iterator[Check]:
    """Bodies of 1e-3 to 1e3 m, one gravity: with times in sqrt(L) and impulses in L^2.5 all is the same in units of L.

    Froude similarity (density and g given). L = 4^k makes every factor a power of two, so not a bit may differ; 10^k
    differs by round-off, which impacts multiply: over 20 steps from the first contact on.
    """
    names = ("thesis", "mixed", "stack")
    exact, close = (-5, 5) if quick else (-5, -3, 3, 5), () if quick else (-3, -1, 2, 3)
    for dtype in DTYPES:
        for sizes, steps, what in (
            ([4.0**k for k in exact], 100, "sizes 4^-5 to 4^5 m"),
            ([10.0**k for k in close], 20, "sizes 1e-3 to 1e3 m, 20 steps"),
        ):
            worst, sim = 0.0, None
            for name in names if sizes else ():
                base = similar(name, 1.0, dtype, steps)
                for size in sizes:
                    sim = similar(name, size, dtype, steps)
                    worst = max(worst, far_from(sim, base, size))
            if sizes:
                limit = 0.0 if steps == 100 else {"float32": 1e-4, "float64": 1e-10}[dtype]
                yield Check(f"{what}, {dtype}: difference of positions [L] and angles [rad]", worst, limit, sim)


def similar(name: str, size: float, dtype: str, steps: int) -> dc.Simulation:
    """A scene of a size after so many steps that are similar for each size."""
    config = dc.SolverConfig(tolerance={"float32": 1e-4, "float64": 1e-12}[dtype] * size**2.5)
    sim = simulation(scene_of_size(name, size), dtype, config)
    sim.run(steps, DT * size**0.5)
    return sim


def stack(dtype: str, bodies: int = 10, size: float = 1.0, config: dc.SolverConfig | None = None) -> dc.Simulation:
    """Boxes on each other on a static box, aligned and touching."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body((0.0, -0.5 * size), type=dc.BodyType.STATIC)
    builder.add_box(ground, 5.0 * size, 0.5 * size)
    for i in range(bodies):
        builder.add_box(builder.add_body((0.0, (i + 0.5) * size)), 0.5 * size, 0.5 * size)
    return dc.Simulation(*builder.finalize(dtype), config=config)


class Rest:
    """What a stack that should rest does: drift [size], speed [sqrt(g size)], error of its load on the ground [1]."""

    def __init__(self, sim: dc.Simulation, size: float = 1.0) -> None:
        self.sim, self.size = sim, size
        self.begin = sim.state.numpy("position").astype(np.float64).copy()
        self.weight = float(sim.model.numpy("mass").astype(np.float64).sum()) * GRAVITY
        self.drift = self.speed = self.load = 0.0
        self.sweeps = 0

    def step(self, dt: float, loaded: bool = True) -> None:
        """Step, and note the worst of each; the load only if ``loaded``."""
        sim = self.sim
        sim.step(dt)
        moved = np.abs(sim.state.numpy("position") - self.begin).max()
        self.drift = max(self.drift, float(moved) / self.size)
        fastest = float(np.abs(sim.state.numpy("velocity")).max())
        self.speed = max(self.speed, fastest / (GRAVITY * self.size) ** 0.5)
        self.sweeps += int(sim.stats.numpy("sweeps")[0])
        if loaded:
            table = contact_table(sim)
            force = table["impulse"][table["body_a"] == 0, 0].sum() / dt
            self.load = max(self.load, abs(force / self.weight - 1.0))

    def checks(self, what: str, drift: float = 0.01, speed: float = 0.01) -> Iterator[Check]:
        """Drift, speed and load against their limits."""
        yield Check(f"{what}: drift [size]", self.drift, drift, self.sim)
        yield Check(f"{what}: speed [sqrt(g size)]", self.speed, speed, self.sim)
        yield Check(f"{what}: error of the load on the ground [1]", self.load, 0.01, self.sim)


@cases.add
def sizes_same_settings(quick: bool) -> Iterator[Check]:
    """A stack of ten boxes of 1e-3 to 1e3 m at rest, the same settings: rests, loads the ground with M g.

    dt is 0.01 s, for 1 mm 3 ms: what counts is dt sqrt(g / L), of which the README states the limit, 0.3. The stop is
    relative; the default, 1.3e-3 of a weight's impulse, rests to 1 % from 1 m up, where 1e-4 N s are less than that.
    """
    sizes = (1e-3, 1e-2, 1e3) if quick else (1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3)
    settings = (
        ("residual 1e-6", dc.SolverConfig(stop="residual", tolerance=1e-6), sizes),
        ("relative 5e-6", dc.SolverConfig(relative_tolerance=5e-6), sizes),
        ("defaults", None, (1.0, 1e3) if quick else (1.0, 1e1, 1e2, 1e3)),
    )
    for dtype in DTYPES:
        for name, config, chosen in settings:
            for size in chosen:
                rest = Rest(stack(dtype, size=size, config=config), size)
                for i in range(100 if quick else 500):
                    rest.step(min(DT, 0.3 * (size / GRAVITY) ** 0.5), loaded=i > 50)
                yield from rest.checks(f"{size:g} m, {dtype}, {name}")


@cases.add
def time_steps(quick: bool) -> Iterator[Check]:
    """A stack of ten boxes of 1 m at rest with dt 1e-6 to 0.1 s: rests and loads the ground with M g.

    The tolerance is 1e-6 of a box's weight over a step.
    """
    for dtype in DTYPES:
        for dt in (1e-6, 1e-3, 0.1) if quick else (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 0.1):
            sim = stack(dtype, config=dc.SolverConfig(tolerance=1e-6 * GRAVITY * dt))
            rest = Rest(sim)
            for i in range(100 if quick else 500):
                rest.step(dt, loaded=i > 20)
            yield from rest.checks(f"dt {dt:g} s, {dtype}")


@cases.add
def varying_time_step(quick: bool) -> Iterator[Check]:
    """A time step drawn anew each time, log-uniform in [0.002, 0.02] s: cached impulses are scaled by the ratio.

    A stack of ten boxes rests and loads the ground with M g, in less than a tenth of the sweeps that zero starts take.
    """
    steps = 200 if quick else 1000
    draw = np.random.default_rng(0)
    varied = 10.0 ** draw.uniform(-2.7, -1.7, steps)
    for dtype in DTYPES:
        sweeps = {}
        for start in ("cache", "zero"):
            rest = Rest(stack(dtype, config=dc.SolverConfig(tolerance=1e-5, start=start)))  # type: ignore[arg-type]
            for i, dt in enumerate(varied):
                rest.step(float(dt), loaded=i > 20)
            sweeps[start] = rest.sweeps / steps
            if start == "cache":
                yield from rest.checks(dtype)
        yield Check(f"{dtype}: sweeps a step over those from zero [1]", sweeps["cache"] / sweeps["zero"], 0.1)


@cases.add
def far_origin(quick: bool) -> Iterator[Check]:
    """Worlds with an origin 1e3 to 1e7 m away: positions are relative to it, so the bits are those of a world at 0.

    Positions are multiples of 1/32 m, so that adding the origin in float64 and taking it away again is exact.
    """
    for dtype in DTYPES:
        differ = 0
        reference = far_pile(dtype, 0.0)
        for far in (1e3, 1e7) if quick else (1e3, 1e4, 1e5, 1e6, 1e7):
            sim = far_pile(dtype, far)
            differ += any(
                sim.state.numpy(name).tobytes() != reference.state.numpy(name).tobytes()
                for name in ("position", "angle", "velocity", "angular_velocity")
            )
        yield Check(f"origins that change a bit of 150 steps, {dtype} [1]", differ, 0.0)


def far_pile(dtype: str, far: float) -> dc.Simulation:
    """Discs and boxes falling into a box, about (far, -far)."""
    builder = dc.ModelBuilder()
    builder.add_world(origin=(far, -far))
    ground = builder.add_body((far, -far), type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-2.0, 4.0), (-2.0, 0.0), (2.0, 0.0), (2.0, 4.0)))
    for i in range(16):
        place = (far - 1.5 + (i % 4) + (i % 3) * 0.03125, -far + 0.5 + 0.875 * (i // 4))
        body = builder.add_body(place, angle=0.25 * i)
        if i % 2:
            builder.add_disc(body, 0.25)
        else:
            builder.add_box(body, 0.3125, 0.1875)
    sim = dc.Simulation(*builder.finalize(dtype))
    sim.run(150, DT)
    return sim


@cases.add
def far_within(quick: bool) -> Iterator[Check]:
    """Discs and boxes of 1 m in a box, D from their world's origin along x and y: round-off of positions is D eps.

    After 10 s the pile rests to 1 % of a size, in overlap and in drift over 5 s, up to the D that the README states;
    farther out, give the world an origin near by (case far_origin). Its topmost disc leaves a balance in which an error
    grows 2.5 times in half a second: as round-off has it, it lies still from 5 to 7 s on.
    """
    for dtype, limit in (("float32", FAR_FLOAT32), ("float64", FAR_FLOAT64)):
        for at in (limit,) if quick else (0.0, 1e2, 1e3, 1e4, limit):
            sim = pile_at(dtype, at)
            sim.run(1_000, DT)
            before = sim.state.numpy("position").copy()
            sim.run(100 if quick else 500, DT)
            drift = float(np.abs(sim.state.numpy("position") - before).max())
            yield Check(f"{at:g} sizes away, {dtype}: drift [size]", drift, 0.01, sim)
            overlap = float(measure.overlap(sim, DT).max[0])
            yield Check(f"{at:g} sizes away, {dtype}: largest overlap [size]", overlap, 0.01, sim)


FAR_FLOAT32, FAR_FLOAT64 = 2e4, 1e7


def pile_at(dtype: str, at: float) -> dc.Simulation:
    """Twenty discs and boxes above a box, about (at, at), in a world whose origin is (0, 0)."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body((at, at), type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(-3.0, 10.0), (-3.0, 0.0), (3.0, 0.0), (3.0, 10.0)])
    for i in range(20):
        body = builder.add_body((at - 2.4 + 1.2 * (i % 5), at + 0.6 + 1.1 * (i // 5)), angle=0.3 * i)
        if i % 2:
            builder.add_disc(body, 0.5)
        else:
            builder.add_box(body, 0.5, 0.4)
    return dc.Simulation(*builder.finalize(dtype))
