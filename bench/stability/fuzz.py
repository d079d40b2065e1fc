"""Random whole scenes (hypothesis) and what has to hold in each: for tests, and in number for the bench."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.stability import invariants
from bench.verdicts import Cases, Check
from dc_kernels.model.config import ACCELERATIONS, STOPS
from dc_kernels.model.enums import BodyType

cases = Cases()
KINDS = ("disc", "disc off centre", "capsule", "box", "polygon", "rounded")
STEPS = 12
EXAMPLES = 300
FIELDS = ("position", "angle", "velocity", "angular_velocity", "time", "flags")


@dataclass(frozen=True)
class Body:
    """One body with a shape; ``size`` is the radius of the disc that it fits into, or so [m]."""

    kind: str
    type: BodyType
    size: float
    corners: int
    density: float
    position: tuple[float, float]
    angle: float
    velocity: tuple[float, float]
    spin: float
    friction: float
    restitution: float
    onto: bool = False
    """At the place of the body before."""


@dataclass(frozen=True)
class World:
    """A scene and its settings."""

    bodies: tuple[Body, ...]
    gravity: tuple[float, float]
    ground: tuple[float, ...]
    """Heights of a chain's vertices, one every metre about x = 0; none for no ground."""
    ground_friction: float
    joints: tuple[tuple[int, int], ...]
    config: dc.SolverConfig
    dtype: str
    dt: float
    schedule: str
    specialize: bool

    def build(self) -> dc.ModelBuilder:
        """The scene."""
        builder = dc.ModelBuilder()
        builder.add_world(gravity=self.gravity)
        if self.ground:
            x = np.arange(len(self.ground)) - 0.5 * (len(self.ground) - 1)
            ground = builder.add_body(type=BodyType.STATIC)
            builder.add_chain(ground, np.stack([x, self.ground], axis=1), friction=self.ground_friction)
        first = int(bool(self.ground))
        place = (0.0, 0.0)
        for body in self.bodies:
            place = place if body.onto else body.position
            add_body(builder, body, place)
        for a, b in self.joints:
            types = {self.bodies[i].type for i in (a, b)}
            if a != b and BodyType.DYNAMIC in types:
                builder.add_distance_joint(first + a, first + b, (0.3, 0.0), (-0.3, 0.1), 0.5)
        return builder

    def simulation(self, **options: Any) -> dc.Simulation:
        """A new simulation of it."""
        return dc.Simulation(*self.build().finalize(self.dtype), config=self.config, **options)


def add_body(builder: dc.ModelBuilder, body: Body, place: tuple[float, float]) -> None:
    """A body with its shape."""
    moves = body.type != BodyType.STATIC
    index = builder.add_body(
        place, body.angle, body.velocity if moves else (0.0, 0.0), body.spin if moves else 0.0, type=body.type
    )
    material: Any = {"density": body.density, "friction": body.friction, "restitution": body.restitution}
    size = body.size
    if body.kind == "disc":
        builder.add_disc(index, size, **material)
    elif body.kind == "disc off centre":
        builder.add_disc(index, 0.7 * size, (0.3 * size, 0.0), **material)
        builder.add_disc(index, 0.4 * size, (-0.5 * size, 0.2 * size), **material)
    elif body.kind == "capsule":
        builder.add_capsule(index, (-0.6 * size, 0.0), (0.6 * size, 0.1 * size), 0.3 * size, **material)
    elif body.kind == "box":
        builder.add_box(index, 0.8 * size, 0.6 * size, **material)
    else:
        turn = np.arange(body.corners) * (2.0 * math.pi / body.corners)
        corners = size * np.stack([np.cos(turn), 0.7 * np.sin(turn)], axis=1)
        builder.add_polygon(index, corners, radius=0.2 * size if body.kind == "rounded" else 0.0, **material)


def worlds() -> Any:
    """The strategy: a ``World`` of up to ten bodies."""
    from hypothesis import strategies as st

    def number(low: float, high: float) -> Any:
        return st.floats(low, high)

    def power(low: float, high: float) -> Any:
        return number(math.log10(low), math.log10(high)).map(lambda exponent: 10.0**exponent)

    body = st.builds(
        Body,
        kind=st.sampled_from(KINDS),
        type=st.sampled_from([BodyType.DYNAMIC] * 8 + [BodyType.KINEMATIC, BodyType.STATIC]),
        size=power(0.1, 1.0),
        corners=st.integers(3, 8),
        density=power(1e-2, 1e1),
        position=st.tuples(number(-2.5, 2.5), number(0.0, 4.0)),
        angle=number(-7.0, 7.0),
        velocity=st.tuples(number(-10.0, 10.0), number(-10.0, 10.0)),
        spin=number(-20.0, 20.0),
        friction=st.one_of(number(0.0, 1.0), st.sampled_from([0.0, 10.0])),
        restitution=st.one_of(st.just(0.0), number(0.0, 1.0)),
        onto=st.sampled_from([False] * 7 + [True]),
    )
    config = st.builds(
        dc.SolverConfig,
        method=st.sampled_from(["pgs", "jacobi"]),  # which solve each step's problem
        acceleration=st.sampled_from(list(ACCELERATIONS)),
        stop=st.sampled_from(list(STOPS)),
        start=st.sampled_from(["cache", "zero"]),
        position_correction=st.sampled_from(["ngs", "baumgarte", "none"]),
        omega=number(0.5, 1.0),
        max_sweeps=st.sampled_from([2000, 20]),
        tolerance=st.just(1e-6),
    )
    bumps = st.lists(number(-0.5, 0.5), min_size=2, max_size=8).map(tuple)
    joint = st.tuples(st.integers(0, 9), st.integers(0, 9))

    def limited(scene: World) -> World:
        inside = tuple(pair for pair in scene.joints if max(pair) < len(scene.bodies))
        return replace(scene, joints=inside)

    return st.builds(
        World,
        bodies=st.lists(body, min_size=1, max_size=10).map(tuple),
        gravity=st.one_of(st.just((0.0, -9.8)), st.tuples(number(-20.0, 20.0), number(-20.0, 20.0))),
        ground=st.one_of(st.just((0.0,) * 8), st.just(()), bumps),
        ground_friction=number(0.0, 1.0),
        joints=st.one_of(st.just(()), st.lists(joint, max_size=3).map(tuple)),
        config=config,
        dtype=st.sampled_from(["float32", "float64"]),
        dt=power(1e-3, 5e-2),
        schedule=st.sampled_from(["world"] * 3 + ["color"]),
        specialize=st.booleans(),
    ).map(limited)  # fmt: skip


def bits(sim: dc.Simulation) -> list[bytes]:
    """State and contacts as bytes; of contacts the slots in use."""
    table = invariants.contact_table(sim)
    values = [sim.state.numpy(name) for name in FIELDS] + [table[name] for name in ("key", "impulse", "gap")]
    return [(v + np.zeros(1, v.dtype)).tobytes() for v in values]  # -0 counts as 0


def faults(world: World, steps: int = STEPS) -> list[str]:
    """Run a scene phase by phase and check each step; run it again with other means, for which bits have to agree.

    The second run begins without room for any pair or contact, in the world's own schedule, and goes on from a snapshot
    after half the steps.
    """
    sim = world.simulation(specialize=world.specialize)
    found: list[str] = []
    bounds = invariants.BOUNDS[world.dtype]
    dissipates = not any(b.restitution for b in world.bodies) and world.config.position_correction != "baumgarte"
    for step in range(steps):
        sim.collide(world.dt)
        now = invariants.lost_contacts(sim, bounds.geometry)
        start = invariants.contact_table(sim)["impulse"]
        sim.solve()
        now += invariants.step_faults(sim, start)
        converged = sim.stats.numpy("sweeps")[0] < world.config.max_sweeps
        if dissipates and converged:
            gain, scale = invariants.energy_gain(sim)
            if gain > bounds.energy * scale + 1e-6:
                now.append(f"energy grew by {gain:g} J of {scale:g} J")
        sim.advance()
        if sim.state.numpy("flags").any():
            now.append(f"flags are {sim.state.numpy('flags')}")
        found += [f"step {step}: {fault}" for fault in now]
        if found:
            return found
    again = world.simulation(
        specialize=world.specialize, schedule=world.schedule, pairs_per_shape=0.0, contacts_per_body=0.0
    )
    again.run(steps // 2, world.dt)
    with tempfile.TemporaryDirectory() as folder:
        again.save(Path(folder) / "half.h5")
        again = dc.Simulation.load(Path(folder) / "half.h5")
    again.run(steps - steps // 2, world.dt)
    if bits(again) != bits(sim):
        found.append("a run with no room at first, saved and loaded, ended with other bits")
    return found


@cases.add_slow
def fuzz(quick: bool) -> Iterator[Check]:
    """Random scenes of up to ten bodies of all kinds, mass ratios to 1e5, overlaps, joints, any settings.

    All finite; velocities are predicted ones plus impulses over masses, so that momentum changes by gravity and what
    does not move freely only; |t| <= mu n, n >= 0; no energy from a converged solve at restitution 0; every pair
    below the look-ahead has its contact, once, with the hulls' distance; bits of a run that began without room, was
    saved and loaded.
    """
    from hypothesis import HealthCheck, given, seed, settings

    examples = 25 if quick else EXAMPLES
    failed: list[str] = []

    @seed(1)
    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(worlds())
    def run(world: World) -> None:
        found = faults(world)
        if found:
            failed[:] = [f"{found[0]} of {world}"]
        assert not found

    try:
        run()
    except AssertionError:
        yield Check(f"{examples} random scenes, the least that fails: {failed[0]}", 1.0, 0.0)
    else:
        yield Check(f"{examples} random scenes, failures [1]", 0.0, 0.0)
