"""Structures that stand or fall: stacks, a pyramid, a card house, an arch, an overhang, a stack relieved of its load.

Boxes are 1 m wide and weigh 1 kg unless said; g = 9.8 m/s^2; drift is the largest horizontal move of a body.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import G, at_least, box, disc, floor, pose, world
from bench.stability.common import DT, EXACT, carried, depth, drift, energy, named, simulate, watch
from bench.verdicts import Cases, Check
from dc_kernels import measure
from pipeline import scenes

cases = Cases()


def stack(count: int, offset: float) -> dc.ModelBuilder:
    """Boxes on top of each other, every other one ``offset`` [m] beside."""
    builder = world()
    floor(builder)
    for i in range(count):
        box(builder, (offset * (i % 2), 0.5 + i), 0.5, 0.5)
    return builder


def standing(count: int, seconds: float, **settings: Any) -> Iterator[Check]:
    """Drift and loads of stacks without and with offsets of 1 cm."""
    above = G * DT * np.arange(count, 0, -1)
    for offset in (0.0, 0.01):
        sim = simulate(stack(count, offset), **settings)
        start = pose(sim)[:, 0]

        def read(s: dc.Simulation, start: np.ndarray = start) -> tuple[float, ...]:
            return float(np.abs(pose(s)[:, 0] - start).max()), *carried(s)[1:]

        rows = watch(sim, seconds, read)
        what = f"{count} boxes, offsets {offset:g} m, {seconds:g} s, {named(settings)}"
        yield Check(f"{what}: drift over width", float(rows[:, 0].max()), 0.01, sim)
        loads = rows[len(rows) // 2 :, 1:].mean(axis=0)
        yield Check(f"{what}: error of loads", float(np.abs(loads / above - 1.0).max()), 0.01, sim)


@cases.add
def stack_of_10(quick: bool) -> Iterator[Check]:
    """Statics: nothing moves, and box k carries g times the mass above it (each world's mean of its second half).

    The tolerance is 1e-5 N s: with the default, 1e-4, ten boxes drift by some 2 % in a minute.
    """
    yield from standing(10, 10.0 if quick else 60.0, tolerance=1e-5)


@cases.add
def stack_of_50(quick: bool) -> Iterator[Check]:
    """As ten boxes, solved to 1e-8 N s in float64 within 5000 sweeps.

    Relative velocities u left at n joints move the top by n^2 u / 2, and the condition of a column against bending
    grows with n^4, so that a first-order solver has to be pushed further the taller it is.
    """
    yield from standing(50, 1.0 if quick else 60.0, **EXACT)


@cases.add
def stack_of_100(quick: bool) -> Iterator[Check]:
    """As 50 boxes, with the same settings."""
    yield from standing(100, 0.5 if quick else 60.0, **EXACT)


@cases.add_slow
def tallest_stack(quick: bool) -> Iterator[Check]:
    """What the default settings hold for a minute: the tallest of the stacks tried that drifts by less than 1, 10 %."""
    heights = (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40)
    drifts = {n: float(drift(simulate(stack(n, 0.01)), 60.0)[0]) for n in heights}
    for limit, least in ((0.01, 5), (0.1, 15)):
        good = max((n for n in heights if all(drifts[m] <= limit for m in heights if m <= n)), default=0)
        yield at_least(f"default settings, drift below {limit:.0%} of the width in 60 s: {good} boxes", good, least)


@cases.add
def pyramid(quick: bool) -> Iterator[Check]:
    """5 050 boxes in 100 rows (quick: 210 in 20) stand: no box leaves its place by more than 1 % of its width.

    The tolerance is 1e-5 N s, a ten-thousandth of what one box presses with in a step.
    """
    rows, seconds = (20, 10.0) if quick else (100, 60.0)
    builder = scenes.scene("pyramid", rows=rows).build()
    sim = simulate(builder, tolerance=1e-5)
    across, down = drift(sim, seconds)
    yield Check(f"{rows} rows, {seconds:g} s: horizontal drift over width", across, 0.01, sim)
    yield Check(f"{rows} rows, {seconds:g} s: vertical drift over width", down, 0.01, sim)


@cases.add
def relieved_stack(quick: bool) -> Iterator[Check]:
    """A disc 1 000 times heavier than each body below it is taken away at rest: rigid bodies do not jump.

    Rise of the highest body [diameter] and its largest upward speed over the second after; discs and boxes. What the
    cache starts from is then a thousand times too much.
    """
    for count in (1, 5) if quick else (1, 2, 5, 10):
        for shape in (disc, box):
            builder = world()
            floor(builder)
            size = (0.5,) if shape is disc else (0.5, 0.5)
            bodies = [shape(builder, (0.0, 0.5 + i), *size) for i in range(count)]  # type: ignore[operator]
            heavy = disc(builder, (0.0, 0.5 + count), 0.5, mass=1000.0)
            sim = simulate(builder)
            sim.run(200, DT)
            sim.state.numpy("position")[heavy] = (20.0, 0.5)
            sim.state.numpy("velocity")[heavy] = 0.0
            start = pose(sim)[bodies, 1]

            def read(s: dc.Simulation, bodies: list[int] = bodies, start: np.ndarray = start) -> tuple[float, float]:
                rise = float((pose(s)[bodies, 1] - start).max())
                return rise, float(s.state.numpy("velocity")[bodies, 1].max())

            rise, up = watch(sim, 1.0, read, every=DT).max(axis=0)
            what = f"{count} {'discs' if shape is disc else 'boxes'}"
            yield Check(f"{what} relieved of 1000 times their mass: rise over size", rise, 1e-3, sim)
            yield Check(f"{what}: upward speed [m/s]", up, 5e-3, sim)


def card_house(levels: int, lean: float, friction: float) -> dc.ModelBuilder:
    """Tents of two cards 1 m long and 2 cm thick, ``lean`` [rad] off the vertical, with flat cards between levels."""
    builder = world()
    floor(builder, friction=friction)
    half, thin = 0.5, 0.01
    cosine, sine = math.cos(lean), math.sin(lean)
    width, height = thin * cosine + half * sine, thin * sine + half * cosine
    pitch, base = 4.08 * width, 0.0
    for level in range(levels):
        tents = levels - level
        for i in range(tents):
            x = (i - (tents - 1) / 2) * pitch
            for side in (-1, 1):
                card = builder.add_body((x + side * width, base + height), angle=side * lean)
                builder.add_box(card, thin, half, friction=friction)
        base += 2 * height
        for i in range(tents - 1):
            card = builder.add_body(((i - (tents - 2) / 2) * pitch, base + thin))
            builder.add_box(card, (1.2 if tents == 2 else 0.96) * pitch / 2, thin, friction=friction)
        base += 2 * thin
    return builder


@cases.add
def house_of_cards(quick: bool) -> Iterator[Check]:
    """Three levels of cards stand for 30 s; two capsules that lean on each other stand 10 % above their limit of mu.

    A foot carries N = m g and T = m g l sin(lean) / (2 l cos(lean) + r), with 2 l between the centres of a capsule's
    ends of radius r, so that mu has to exceed T / N. Cards weigh 20 g.
    """
    seconds = 5.0 if quick else 30.0
    for lean, friction in ((0.25, 0.5), (0.3, 0.6)):
        sim = simulate(card_house(3, lean, friction))
        moved = float(drift(sim, seconds).max())
        yield Check(f"3 levels, lean {lean:g}, mu {friction:g}, {seconds:g} s: drift [m]", moved, 1e-3, sim)
    half, radius, lean = 0.5, 0.02, 0.4
    limit = half * math.sin(lean) / (2 * half * math.cos(lean) + radius)
    for factor in (1.1, 0.9):
        builder = world()
        floor(builder, friction=factor * limit)
        for side in (-1, 1):
            x, y = side * (half * math.sin(lean) + radius), half * math.cos(lean) + radius
            card = builder.add_body((x, y), angle=side * lean)
            builder.add_capsule(card, (0.0, -half), (0.0, half), radius, friction=factor * limit)
        sim = simulate(builder)
        moved = float(drift(sim, seconds).max())
        what = f"a tent at {factor:g} of its limiting friction, {seconds:g} s: drift [m]"
        yield Check(what, moved, 1e-3, sim) if factor > 1 else at_least(what, moved, 0.1, sim)


def voussoirs(count: int, thickness: float) -> np.ndarray:
    """Corners of a semicircular arch's blocks, mean radius 1 m: inner, outer, outer, inner, (count, 4, 2) [m]."""
    angle = np.linspace(math.pi, 0.0, count + 1)
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    inner, outer = (1 - thickness / 2) * ring, (1 + thickness / 2) * ring
    return np.stack((inner[:-1], outer[:-1], outer[1:], inner[1:]), axis=1)


def arch_stands(count: int, thickness: float, friction: float) -> bool:
    """Whether forces N >= 0, |T| <= mu N at the ends of the joints balance the weights (Heyman's safe theorem)."""
    from scipy.optimize import linprog

    angle = np.linspace(math.pi, 0.0, count + 1)
    along = np.stack((np.sin(angle), -np.cos(angle)), axis=1)  # across joint k, from block k - 1 to block k
    across = np.stack((along[:, 1], -along[:, 0]), axis=1)
    balance, weight = np.zeros((3 * count, 4 * (count + 1))), np.zeros(3 * count)
    for k, corners in enumerate(voussoirs(count, thickness)):
        after = np.roll(corners, -1, axis=0)
        cross = corners[:, 0] * after[:, 1] - after[:, 0] * corners[:, 1]
        center = ((corners + after) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
        weight[3 * k + 1] = abs(cross.sum()) / 2 * G
        for joint, sign, points in ((k, 1.0, corners[:2]), (k + 1, -1.0, corners[[3, 2]])):
            for i, point in enumerate(points):
                arm = point - center
                for j, force in enumerate((along[joint], across[joint])):
                    column = 4 * joint + 2 * i + j
                    balance[3 * k : 3 * k + 2, column] += sign * force
                    balance[3 * k + 2, column] += sign * (arm[0] * force[1] - arm[1] * force[0])
    points = 2 * (count + 1)
    cone = np.kron(np.eye(points), np.array([[-friction, 1.0], [-friction, -1.0]]))
    bounds = [(0, None), (None, None)] * points
    return bool(linprog(np.zeros(2 * points), cone, np.zeros(2 * points), balance, weight, bounds).status == 0)


def arch_limit(count: int, friction: float) -> float:
    """The least thickness of an arch that stands, by bisection to 1e-5 [m]."""
    low, high = 0.02, 0.4
    while high - low > 1e-5:
        middle = (low + high) / 2
        low, high = (low, middle) if arch_stands(count, middle, friction) else (middle, high)
    return high


def arch(count: int, thickness: float, friction: float) -> dc.ModelBuilder:
    """The arch on a floor."""
    builder = world()
    floor(builder, friction=friction)
    for corners in voussoirs(count, thickness):
        middle = corners.mean(axis=0)
        builder.add_polygon(builder.add_body(middle), corners - middle, friction=friction)
    return builder


@cases.add
def arch_thickness(quick: bool) -> Iterator[Check]:
    """A semicircular arch of n blocks stands 10 % above its limiting thickness and falls 10 % below it.

    The limit of these very blocks is that of a linear programme (safe theorem: Heyman 1969); it tends to .1075 of the
    mean radius, 1 m, with n (Milankovitch 1907). Drift of what stands: below 1 % of that radius.
    """
    friction, seconds = 0.8, 5.0 if quick else 30.0
    for count in (7, 15) if quick else (7, 11, 15, 21, 27):
        limit = arch_limit(count, friction)
        sim = simulate(arch(count, 1.1 * limit, friction))
        moved = float(drift(sim, seconds).max())
        yield Check(f"{count} blocks, 1.1 of {limit:.4f} m, {seconds:g} s: drift [m]", moved, 0.01, sim)
        sim = simulate(arch(count, 0.9 * limit, friction))
        moved = float(drift(sim, 3.0).max())
        yield at_least(f"{count} blocks, 0.9 of it: drift within 3 s [m]", moved, 0.5, sim)


@cases.add
def overhang(quick: bool) -> Iterator[Check]:
    """Blocks of half length 1 m over the edge of a table by f / k, the k-th from the top: they stand if f < 1.

    The harmonic stack (Hall 2005, Fun with stacking blocks): the centre of mass of the upper k lies f / k before the
    edge below them, so that .99 stands and 1.01 tips.
    """
    seconds = 5.0 if quick else 60.0
    for count in (3, 10):
        for factor in (0.99, 1.01):
            builder = world()
            floor(builder)
            table = builder.add_body((0.0, 2.75), type=dc.BodyType.STATIC)
            builder.add_box(table, 1.0, 0.25)
            reach = np.cumsum([factor / k for k in range(count, 0, -1)])
            for i, x in enumerate(reach):
                box(builder, (float(x), 3.25 + 0.5 * i), 1.0, 0.25)
            sim = simulate(builder)
            moved = float(drift(sim, seconds).max())
            what = f"{count} blocks at {factor:g}, {seconds:g} s: drift [m]"
            yield Check(what, moved, 0.01, sim) if factor < 1 else at_least(what, moved, 1.0, sim)


@cases.add
def piles(quick: bool) -> Iterator[Check]:
    """Discs and polygons without friction and with mu = 10 come to rest: at 20 s the energy lies below the start's.

    Kinetic energy at the end is held against the weight times 1 cm of all bodies together; overlap against 1 % of a
    diameter (1 m). Eight worlds, as bodies that no friction stops slosh on: 1 of 16 has twice the mean energy. With
    mu = 10 sweeps go in a circle in half of the steps with polygons: friction couples normals more strongly than a
    sweep contracts. Plain sweeps stay bounded there; accelerated ones go back where they led astray.
    """
    for friction in (0.0, 10.0):
        for name in ("thesis", "mixed"):
            worlds = 1 if quick and friction > 0.0 else 8
            sim = simulate(scenes.scene(name, friction=friction).build(worlds))
            start = energy(sim)
            rows = watch(sim, 20.0, lambda s: (energy(s), depth(s)), every=0.5)
            weight = float(sim.model.numpy("mass").sum()) * G
            moving = float(measure.kinetic_energy(sim).sum())
            what = f"{name}, mu {friction:g}"
            yield Check(f"{what}: largest energy over the start's", float(rows[:, 0].max()) / start, 1.0, sim)
            yield Check(f"{what}: kinetic energy at 20 s over weight x 1 cm", moving / (weight * 0.01), 1e-2, sim)
            yield Check(f"{what}: deepest overlap after 10 s [m]", float(rows[len(rows) // 2 :, 1].max()), 0.01, sim)
