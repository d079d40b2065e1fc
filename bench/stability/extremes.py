"""Extremes of physics: mass ratios, a loaded rope, bullets, overlaps, a tumbler.

Bodies are 1 m wide and weigh 1 kg unless said; g = 9.8 m/s^2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import G, at_least, box, disc, floor, pose, world
from bench.stability.common import DT, depth, energy, finite, named, simulate, speed, velocities, watch
from bench.verdicts import Cases, Check
from dc_kernels import measure

cases = Cases()


# ---------------------------------------------------------------- masses


def squeezed(ratio: float, seconds: float, **settings: Any) -> tuple[float, dc.Simulation]:
    """How far a light box is pressed into its neighbours by one ``ratio`` times heavier on it [m]."""
    builder = world()
    floor(builder)
    light = box(builder, (0.0, 0.5), 0.5, 0.5)
    heavy = box(builder, (0.0, 1.5), 0.5, 0.5, mass=ratio)
    sim = simulate(builder, **settings)

    def sunk(s: dc.Simulation) -> float:
        y = pose(s)[:, 1]
        return max(0.5 - y[light], 1.0 - (y[heavy] - y[light]))

    return float(watch(sim, seconds, sunk).max()), sim


@cases.add
def mass_ratio(quick: bool) -> Iterator[Check]:
    """A heavy box on a light one: what is pressed into what stays below 1 % of the size, at ratios of 1e2 to 1e6.

    Gauss-Seidel leaves M / (M + m) of the error of two such contacts a sweep, so that a ratio of 1e4 takes more than
    the default cap of 1000 sweeps in the first step, and 1e5 too many: these are solved in float64 to 1e-6 N s within
    400 000 sweeps. Peers: Box2D v3 and pymunk, at their defaults, let a box of ratio 1e3 fall through.
    """
    seconds = 0.2 if quick else 20.0
    wide: dict[str, Any] = {"dtype": "float64", "tolerance": 1e-6, "max_sweeps": 400_000}
    for ratio, settings in ((1e2, {}), (1e3, {}), (1e4, {}), (1e5, wide), (1e6, wide)):
        sunk, sim = squeezed(ratio, seconds, **settings)
        yield Check(f"ratio {ratio:.0e}, {named(settings)}: penetration over size", sunk, 0.01, sim)
    if not quick:
        low, high = 1e4, 1e6
        while high > 1.1 * low:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if squeezed(middle, 5.0)[0] <= 0.01 else (low, middle)
        yield at_least(f"default settings hold 1 % up to a ratio of {low:.2g}", low, 1e4)


# ---------------------------------------------------------------- rope

LINKS, LOAD = 10, 1800.0


def rope(swinging: bool, seconds: float, dt: float, across: bool | None = False) -> tuple[float, dc.Simulation]:
    """Largest stretch of a link of 1 m, ten of them with beads of 1 kg and 1800 kg at the end, which hang or swing.

    Args:
        swinging: let go from the horizontal, or hanging.
        seconds: how long.
        dt: time step [s].
        across: see ``add_distance_joint``.
    """
    builder = world()
    last = builder.add_body(type=dc.BodyType.STATIC)
    for i in range(1, LINKS + 1):
        sway = 0.0 if swinging else 0.01 * (-1) ** i  # what an unstable mode can grow from
        place = (float(i), 0.0) if swinging else (0.0, float(-i))
        bead = builder.add_body(place, velocity=(sway, 0.0), mass=LOAD if i == LINKS else 1.0)
        builder.add_disc(bead, 0.2, mask=0)
        builder.add_distance_joint(last, bead, across=across)
        last = bead
    sim = simulate(builder)

    def stretch(s: dc.Simulation) -> float:
        return float(np.abs(np.hypot(*np.diff(pose(s)[:, :2], axis=0).T) - 1.0).max())

    return float(watch(sim, seconds, stretch, dt=dt, every=10 * dt).max()), sim


@cases.add
def loaded_rope(quick: bool) -> Iterator[Check]:
    """Ten links with 1800 times a bead's mass at the end, hanging and let go from the horizontal: stretch below 1 %.

    Joints pull along the direction at the beginning of a step, so beads on a rope under tension T swing across it with
    up to w = 2 sqrt(T / (m l)), stably as long as w dt < 2 (symplectic Euler): dt < sqrt(m l / T), 7.5 ms where the
    load hangs, 4.3 ms at the bottom of its swing (T = 3 M g). Hence dt = 2 ms; the hanging rope's limit is measured
    where rods have no inertia across them; with it (``across``) the rope hangs at three times the limit, too.
    """
    seconds = 4.0 if quick else 30.0
    for swinging in (False, True):
        worst, sim = rope(swinging, seconds, 0.002)
        yield Check(f"{'swinging' if swinging else 'hanging'}, dt 2 ms: stretch of a link", worst, 0.01, sim)
    theory = math.sqrt(1.0 / (LOAD * G))
    low, high = 0.5 * theory, 2.0 * theory
    while high > 1.02 * low:
        middle = (low + high) / 2
        low, high = (middle, high) if rope(False, 1000 * middle, middle)[0] < 0.01 else (low, middle)
    off = abs(low / theory - 1.0)
    yield Check(
        f"largest stable dt, hanging, {1e3 * low:.2f} ms, off sqrt(m l / T) = {1e3 * theory:.2f} ms by", off, 0.1
    )
    worst, sim = rope(False, seconds, 3.0 * theory, across=None)
    yield Check(f"hanging, rows across, dt {3e3 * theory:.1f} ms: stretch of a link", worst, 0.01, sim)


# ---------------------------------------------------------------- bullets

TARGETS = ("wall 2 cm thin", "chain", "free plate 2 cm thin", "disc", "bullet")


def shoot(target: str, v: float, phase: float, **settings: Any) -> tuple[bool, dc.Simulation]:
    """Whether a disc of 0.1 m radius at v [m/s] passes its target; ``phase``: of the step at the hit.

    It does if it is ever beyond it, or, in a stack, whose boxes tumble away, if it keeps three quarters of its speed.
    """
    builder = world(gravity=(0.0, -G) if target == "stack" else (0.0, 0.0))
    static = {"type": dc.BodyType.STATIC}
    aim = 0.0
    if target == "stack":
        floor(builder)
        bodies = [box(builder, (5.0, 0.25 + 0.5 * i), 0.25, 0.25) for i in range(9)]
        hit, aim = bodies[4], 2.25
    elif target == "disc":
        hit = disc(builder, (5.0, 0.0), 0.1)
    elif target == "bullet":
        hit = disc(builder, (5.0 + phase * v * DT, 0.0), 0.1, velocity=(-v, 0.0))
    else:
        hit = builder.add_body((5.0, 0.0), **({"mass": 1.0} if target.startswith("free") else static))  # type: ignore
        if target == "chain":
            builder.add_chain(hit, [(0.0, -5.0), (0.0, 0.05), (0.0, 5.0)])
        else:
            builder.add_box(hit, 0.01, 5.0)
    bullet = disc(builder, (-phase * v * DT, aim), 0.1, velocity=(v, 0.0))
    sim = simulate(builder, **settings)
    steps = math.ceil((5.0 / v + 0.1) / DT)
    if target == "stack":
        sim.run(steps, DT)
        return bool(sim.state.numpy("velocity")[bullet, 0] > 0.75 * v), sim
    beyond = watch(sim, steps * DT, lambda s: pose(s)[bullet, 0] - pose(s)[hit, 0], every=DT)
    return bool((beyond > 0).any()), sim


@cases.add
def bullets(quick: bool) -> Iterator[Check]:
    """A fast disc never is beyond what it is shot at: a gap that the step closes is a contact, whatever the speed.

    20 shots a speed, a 20th of a step apart. The stack of boxes of the same mass rests on the ground: sharing its
    momentum with one of them leaves a bullet half its speed.
    """
    speeds = (10.0, 1000.0, 1e6) if quick else (10.0, 30.0, 100.0, 300.0, 1000.0, 1e4, 1e5, 1e6)
    phases = np.linspace(0.0, 1.0, 4 if quick else 20, endpoint=False)
    for target in (*TARGETS, "stack"):
        worst, shots, at = 0, 0, None
        for v in speeds:
            if target == "stack" and v > 1000.0:
                continue
            for phase in phases:
                through, sim = shoot(target, v, float(phase))
                worst, shots = worst + through, shots + 1
                at = sim if through or at is None else at
        fastest = 1000 if target == "stack" else 1e6
        yield Check(f"shots through a {target} of {shots} at 10 to {fastest:g} m/s", float(worst), 0.0, at)


def deflection(v: float, clearance: float, angle: float, phase: float) -> float:
    """Change of the velocity of a disc that passes a static one, both 0.1 m, over its speed."""
    builder = world(gravity=(0.0, 0.0))
    builder.add_disc(builder.add_body(type=dc.BodyType.STATIC), 0.1, friction=0.0)
    along = np.array([math.cos(angle), math.sin(angle)])
    beside = np.array([-along[1], along[0]])
    start = (0.2 + clearance) * beside - (5.0 + phase * v * DT) * along
    bullet = disc(builder, start, 0.1, mu=0.0, velocity=v * along)
    sim = simulate(builder)
    sim.run(math.ceil(8.0 / v / DT), DT)
    return float(np.hypot(*(sim.state.numpy("velocity")[bullet] - v * along)) / v)


@cases.add
def near_misses(quick: bool) -> Iterator[Check]:
    """What passes at a distance that it covers in a step is left alone: clearance v dt, up to 10 diameters a step.

    A contact is held against the direction in which the pair lies at the beginning of a step, so what passes nearer may
    be deflected although it would miss, measured up to .37 v dt: the limit of speculative contacts.
    """
    for v in (1.0, 5.0, 20.0) if quick else (1.0, 5.0, 10.0, 20.0, 50.0, 200.0):
        clearance = v * DT
        turned = max(
            deflection(v, clearance, angle, phase)
            for angle in (0.0, 0.1, math.pi / 4)
            for phase in np.linspace(0.0, 1.0, 5 if quick else 20, endpoint=False)
        )
        yield Check(f"{v:g} m/s past a disc at {clearance:g} m: change of velocity over speed", turned, 1e-6)


# ---------------------------------------------------------------- overlap


@cases.add
def recovery(quick: bool) -> Iterator[Check]:
    """Two bodies that begin overlapping by 10 to 100 % part, and leave no faster than the correction allows.

    The default correction moves bodies without a velocity: they part at 0 m/s (limit 1 mm/s) down to 1 % of the size
    within 1 s. Baumgarte's becomes velocity: at most max_correction / dt between them (limit: 1.01 of it).
    """
    for name, overlaps in (("discs", (0.1, 0.5, 0.9, 1.0)), ("boxes", (0.1, 0.5, 0.9, 1.0))):
        for method in ("ngs", "baumgarte"):
            fastest, left = 0.0, 0.0
            for overlap in overlaps:
                builder = world(gravity=(0.0, 0.0))
                for x in (0.0, 1.0 - overlap):
                    _ = disc(builder, (x, 0.0), 0.5) if name == "discs" else box(builder, (x, 0.0), 0.5, 0.5)
                sim = simulate(builder, position_correction=method)
                exits = watch(sim, 1.0, lambda s: np.hypot(*np.diff(velocities(s), axis=0)[0]), every=DT)
                fastest, left = max(fastest, float(exits.max())), max(left, depth(sim))
            bound = 1e-3
            if method == "baumgarte":
                bound = 1.01 * sim.config.max_correction * float(sim.model.numpy("length_scale")[0]) / DT
            yield Check(f"{name}, {method}: exit speed [m/s]", fastest, bound, sim)
            yield Check(f"{name}, {method}: overlap after 1 s over size", left, 0.01, sim)


@cases.add
def coincident(quick: bool) -> Iterator[Check]:
    """Bodies at one and the same place separate without a speed, and everything stays finite.

    Coincident discs have no direction: all take the x axis, so that a hundred leave as a line, by diffusion, in
    minutes; 30 instead of 3 iterations of the correction part them within one.
    """
    for name in ("discs", "boxes", "triangles"):
        for count in (2, 10) if quick else (2, 10, 100):
            builder = world(gravity=(0.0, 0.0))
            for _ in range(count):
                if name == "triangles":
                    builder.add_polygon(builder.add_body(), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
                else:
                    _ = disc(builder, (0.0, 0.0), 0.5) if name == "discs" else box(builder, (0.0, 0.0), 0.5, 0.5)
            settings = {"position_iterations": 30} if count == 100 else {}
            sim = simulate(builder, **settings)  # type: ignore[arg-type]
            fastest = float(watch(sim, 60.0 if count == 100 else 5.0, speed).max())
            what = f"{count} {name}, {named(settings)}"
            yield Check(f"{what}: overlap at the end over size", depth(sim), 0.01, sim)
            yield Check(f"{what}: largest speed [m/s]", fastest, 1e-3, sim)
            yield finite(sim)


@cases.add
def packed_box(quick: bool) -> Iterator[Check]:
    """More area than a closed box of 6 m holds, dropped at random: comes to rest, stays inside, overlap stays bounded.

    Speeds stay below sqrt(2 g 6 m), that of a fall from the top; the kinetic energy of the last second is held against
    1e-6 of the weight times 1 m; overlap against the diameter, 1 m: no two bodies may change places.
    """
    side = 6.0
    for name, ratio in (("discs", 1.2), ("discs", 2.0), ("boxes", 1.2)):
        rng = np.random.default_rng(0)
        builder = world()
        half = side / 2
        for x, y, w, h in (
            (half, -2, half + 4, 2),
            (half, side + 2, half + 4, 2),
            (-2, half, 2, half),
            (8, half, 2, half),
        ):
            builder.add_box(builder.add_body((x, y), type=dc.BodyType.STATIC), w, h)
        count = int(ratio * side * side / (math.pi / 4 if name == "discs" else 1.0))
        for position in rng.uniform(0.5, side - 0.5, (count, 2)):
            _ = (
                disc(builder, position, 0.5)
                if name == "discs"
                else box(builder, position, 0.5, 0.5, angle=rng.uniform(0, 6))
            )
        sim = simulate(builder)
        before = depth(sim)
        rows = watch(sim, 5.0 if quick else 60.0, lambda s: (speed(s), measure.kinetic_energy(s)[0], depth(s)))
        what = f"{count} {name}, {ratio:g} of the area"
        inside = pose(sim)[4:, :2]
        yield Check(f"{what}: largest speed over that of a fall", rows[:, 0].max() / math.sqrt(2 * G * side), 1.0, sim)
        yield Check(
            f"{what}: kinetic energy at the end over weight x 1 m", rows[-10:, 1].max() / (count * G), 1e-6, sim
        )
        yield Check(f"{what}: deepest overlap over the one of the start", rows[-1, 2] / before, 1.0, sim)
        yield Check(
            f"{what}: centres outside the box", float(((inside < 0) | (inside > side)).any(axis=1).sum()), 0.0, sim
        )


# ---------------------------------------------------------------- driven


@cases.add
def tumbler(quick: bool) -> Iterator[Check]:
    """1000 discs for an hour in a closed square turned at 0.5 rad/s: no growth of energy (quick: 200 discs, 60 s).

    Only the drive does work, at most what lifts all to the top: no sample of the energy exceeds that of the start by
    more than the weight times the half diagonal h, the mean of the last third exceeds that of the first (the fall
    excluded) by less than 1 % of it (quick: 5 %, as in a minute both vary by 1 %), and no disc is faster than a fall
    over 2 h. dt is 0.02 s and the cap 50 sweeps, which makes the hour a matter of minutes; the default cap keeps
    overlaps of these falls smaller.
    """
    count, seconds, dt, rate = (200, 60.0, 0.02, 0.5) if quick else (1000, 3600.0, 0.02, 0.5)
    radius = 0.25
    half = 1.6 * radius * math.sqrt(count)
    builder = world()
    drum = builder.add_body(angular_velocity=rate, type=dc.BodyType.KINEMATIC)
    for x, y, w, h in ((0, -1, 1, 0), (0, 1, 1, 0), (-1, 0, 0, 1), (1, 0, 0, 1)):
        middle = ((half + 0.5) * x, (half + 0.5) * y)
        builder.add_box(drum, w * (half + 1.0) or 0.5, h * (half + 1.0) or 0.5, center=middle)
    columns = math.isqrt(count) + 1
    places = np.stack(np.divmod(np.arange(count), columns), axis=1)[:, ::-1] - (columns - 1) / 2
    builder.add_discs(2.2 * radius * places, radius)
    sim = simulate(builder, max_sweeps=50)
    start = energy(sim)
    lift = float(sim.model.numpy("mass").sum()) * G * math.sqrt(2) * half
    rows = watch(sim, seconds, lambda s: (energy(s), speed(s), depth(s)), dt=dt, every=1.0)
    third = len(rows) // 3
    growth = float(rows[-third:, 0].mean() - rows[min(10, third) : third, 0].mean())
    what = f"{count} discs, {seconds:g} s"
    yield Check(f"{what}: energy above the start's over weight x h", float(rows[:, 0].max() - start) / lift, 1.0, sim)
    most = 0.05 if quick else 0.01
    yield Check(f"{what}: growth from first to last third over weight x h", growth / lift, most, sim)
    yield Check(
        f"{what}: speed over that of a fall", rows[:, 1].max() / math.sqrt(4 * math.sqrt(2) * G * half), 1.0, sim
    )
    yield Check(f"{what}: deepest overlap over diameter", float(rows[:, 2].max()) / (2 * radius), 0.5, sim)
    far = np.hypot(*pose(sim)[1:, :2].T) > math.sqrt(2) * half
    yield Check(f"{what}: discs outside", float(far.sum()), 0.0, sim)
    yield finite(sim)
