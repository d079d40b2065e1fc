"""Pendula and chains of distance joints.

With its velocities half a step behind, semi-implicit Euler with joints is the leapfrog with constraints (SHAKE; Hairer,
Lubich, Wanner, Geometric Numerical Integration, 2006, VII.1.4): places at a given time are first order, as a start at
rest is half a step off; periods and the energy of whole swings are second order, without drift.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import (
    G,
    cases,
    leftover,
    near,
    order_check,
    pose,
    record,
    relative,
    simulation,
    velocity,
    world,
)
from bench.verdicts import Check
from dc_kernels import measure


def bob(builder: dc.ModelBuilder, position: Any, **body: Any) -> int:
    """A point mass of 1 kg."""
    return builder.add_body(position, mass=1.0, **body)


def down(theta: float) -> np.ndarray:
    """The direction at an angle from below, (2,)."""
    return np.array((math.sin(theta), -math.cos(theta)))


@cases.add
def turning_dumbbell(quick: bool) -> Iterator[Check]:
    """Two masses on a rod turn at constant w, angular momentum and length kept (Newton).

    Chords in place of arcs: with x = (w dt)^2 the spin is off by less than x for ever, second order. Without position
    correction the length grows by x^2 / 8 a step, what the second-order account of its turn leaves, and angular
    momentum stays to rounding, as each impulse acts along the line.
    """
    spin = 3.0

    def turn(dt: float, end: float, correction: str) -> tuple[dc.Simulation, float]:
        builder = world((0.0, 0.0), length_scale=0.1)
        a = bob(builder, (-0.5, 0.0), velocity=(0.0, -spin / 2))
        b = bob(builder, (0.5, 0.0), velocity=(0.0, spin / 2))
        builder.add_distance_joint(a, b)
        sim = simulation(builder, position_correction=correction)
        before = measure.momentum(sim).angular[0]
        sim.run(round(end / dt), dt)
        return sim, float(measure.momentum(sim).angular[0] / before - 1)

    steps = tuple(1 / n for n in (64, 128, 256, 512))
    losses, lengths = [], []
    for dt in steps:
        for end in (1.0, 10.0):
            speed = float(np.hypot(*velocity(turn(dt, end, "ngs")[0])[1, :2]))
            if end == 1.0:
                losses.append(1 - speed / (spin / 2))
            loss = abs(1 - speed / (spin / 2))
            yield Check(f"dt 1/{1 / dt:.0f}, {end:g} s: relative loss of speed", loss, (spin * dt) ** 2)
        sim, change = turn(dt, 1.0, "none")
        lengths.append(math.dist(*pose(sim)[:, :2]) - 1)
        where = f"uncorrected, dt 1/{1 / dt:.0f}"
        yield Check(f"{where}: relative change of L", abs(change), leftover("float64", round(1 / dt), 1.0))
        # the spin falls with the square of the length; the next term of the series is x / 4 of this one
        yield relative(f"{where}: growth of the length", lengths[-1], spin**4 * dt**3 / 8, (spin * dt) ** 2)
    yield order_check("the loss of speed", steps, losses, 2.0)
    yield order_check("the uncorrected length", steps, lengths, 3.0)


def crossings(x: np.ndarray, dt: float) -> np.ndarray:
    """Times at which x, after each step, passes zero, by linear interpolation."""
    i = np.flatnonzero(x[:-1] * x[1:] < 0)
    return (i + 1 + x[i] / (x[i] - x[i + 1])) * dt


def tops(height: np.ndarray) -> np.ndarray:
    """Where a height, after each step, turns down, from the parabola through three of them."""
    i = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:]))
    low, top, high = height[i - 1], height[i], height[i + 1]
    return top - (high - low) ** 2 / (8 * (high - 2 * top + low))


@cases.add
def pendulum(quick: bool) -> Iterator[Check]:
    """T = 4 sqrt(L / g) K(sin(theta0 / 2)), 2 pi sqrt(L / g) if small (Huygens 1673; Landau, Lifshitz, Mechanics, 11).

    Small swings in steps: sin(w' dt / 2) = w dt / 2, so the period is shorter by (w dt)^2 / 24. Chords in place of arcs
    change the period, and the height of each swing, by less than (v dt / L)^2, v the largest speed; what they take from
    rising and falling cancels to third order, which is the drift. On two parallel rods a plate moves in a circle, and
    turns by what the rods' lengths may differ, dt^3 v a / 2 <= g^1.5 dt^3 at L = 1.
    """
    from scipy.special import ellipk

    steps = tuple(1 / n for n in (64, 128, 256, 512) + (() if quick else (1024,)))
    swings = 4 if quick else 10
    for degrees, plate in ((2.0, False), (60.0, False), (60.0, True), (150.0, False)):
        theta = math.radians(degrees)
        period = 4 / math.sqrt(G) * float(ellipk(math.sin(theta / 2) ** 2))
        name = f"{degrees:g} deg{', plate' if plate else ''}"
        periods, drifts = [], []
        for dt in steps:
            builder = world(length_scale=0.1)
            pivot = builder.add_body(type=dc.BodyType.STATIC)
            body = builder.add_body(down(theta), mass=1.0, inertia=0.2)
            for side in (-0.4, 0.4) if plate else (0.0,):
                builder.add_distance_joint(pivot, body, (side, 0.0), (side, 0.0), 1.0)
            sim = simulation(builder)
            places = record(sim, round((swings + 0.1) * period / dt), dt, lambda s: pose(s)[1])
            where = f"{name}, dt 1/{1 / dt:.0f}"
            t = crossings(places[:, 0], dt)
            periods.append(float((t[2] - t[0]) / period - 1))
            limit = max(2 * G * (1 - math.cos(theta)), G) * dt**2
            yield Check(f"{where}: relative error of the period", abs(periods[-1]), limit)
            heights = tops(places[:, 1])[1 : 2 * swings : 2] + math.cos(theta)
            worst = float(np.abs(heights / np.arange(1, swings + 1)).max())
            yield Check(f"{where}: lost height over number of swings [m]", worst, limit)
            drifts.append(float(heights[-1] - heights[0]) / (swings - 1))
            if plate:
                yield near(f"{where}: turns [rad]", places[:, 2], 0.0, G**1.5 * dt**3)
        if degrees == 2.0:
            yield relative(f"{name}: its (w dt)^2 / 24", periods, -G * np.square(steps) / 24, 0.02)
        if degrees == 150.0:  # at less it is lost in rounding, or in the phase at which a swing turns
            yield order_check(f"{name}: the drift of {drifts[0]:.1e} m a swing at dt 1/64", steps, drifts, 3.0)
        else:  # near the top the period depends on the height by its logarithm
            yield order_check(f"{name}: the period", steps, periods, 2.0)


def double_pendulum(parameters: tuple[float, ...], start: tuple[float, float], end: float) -> np.ndarray:
    """Angles and rates of Lagrange's equations to 1e-11.

    T = A w1^2 / 2 + B w2^2 / 2 + C cos(t1 - t2) w1 w2, V = -P cos(t1) - Q cos(t2); parameters A, B, C, P, Q.
    """
    from scipy.integrate import solve_ivp

    a, b, c, p, q = parameters

    def rate(_: float, s: np.ndarray) -> tuple[float, ...]:
        t1, t2, w1, w2 = s
        cosine, sine = c * math.cos(t1 - t2), c * math.sin(t1 - t2)
        f1, f2 = -sine * w2 * w2 - p * math.sin(t1), sine * w1 * w1 - q * math.sin(t2)
        det = a * b - cosine * cosine
        return w1, w2, (b * f1 - cosine * f2) / det, (a * f2 - cosine * f1) / det

    return solve_ivp(rate, (0.0, end), (*start, 0.0, 0.0), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


@cases.add
def double_pendula(quick: bool) -> Iterator[Check]:
    """Two masses in a row, and a rod hung by its end, against Lagrange's equations (Landau, Lifshitz, Mechanics, 5).

    The reference is DOP853 at 1e-12. Places after a second are first order, within the speed times dt at the tip.
    """
    l1, l2, inertia, end = 1.0, 0.7, 0.15, 1.0
    start = (1.2, 2.0)
    steps = tuple(1 / n for n in (128, 256, 512, 1024) + (() if quick else (2048, 4096)))
    for name, parameters in (
        ("two masses", (2 * l1**2, l2**2, l1 * l2, 2 * G * l1, G * l2)),
        ("rod on a joint", (l1**2, l2**2 + inertia, l1 * l2, G * l1, G * l2)),
    ):
        t1, t2, *_ = double_pendulum(parameters, start, end)
        exact = l1 * down(t1) + l2 * down(t2)
        errors = []
        for dt in steps:
            builder = world(length_scale=0.1)
            pivot = builder.add_body(type=dc.BodyType.STATIC)
            knee, tip = l1 * down(start[0]), l1 * down(start[0]) + l2 * down(start[1])
            if name == "two masses":
                first, second = bob(builder, knee), bob(builder, tip)
                builder.add_distance_joint(pivot, first)
                builder.add_distance_joint(first, second)
            else:
                second = builder.add_body(tip, mass=1.0, inertia=inertia, angle=start[1])
                builder.add_distance_joint(pivot, second, anchor_b=(0.0, l2))
            sim = simulation(builder)
            sim.run(round(end / dt), dt)
            errors.append(float(np.hypot(*(pose(sim)[second, :2] - exact))))
        yield order_check(f"{name}: the tip", steps, errors)
        # half a step off at the start, at a speed of at most sqrt(2 g h), h the largest fall
        speed = math.sqrt(2 * G * 2 * (l1 + l2))
        yield Check(f"{name}, dt 1/{1 / steps[-1]:.0f}: the tip [m]", errors[-1], speed * steps[-1])


def hung(number: int, span: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n + 2, 2) and tensions (n + 1,) of a chain of n masses of 1 kg between two pegs at equal height."""
    from scipy.optimize import brentq

    link = length / (number + 1)
    sides = (np.arange(number + 1) - number / 2) * G  # vertical force in each link
    pull = float(brentq(lambda h: link * (h / np.hypot(h, sides)).sum() - span, 1e-9, 1e9 * G, xtol=1e-14, rtol=1e-14))
    tension = np.hypot(pull, sides)
    steps = link * np.stack((np.full(number + 1, pull), sides), axis=1) / tension[:, None]
    return np.concatenate((np.zeros((1, 2)), steps.cumsum(axis=0))), tension


@cases.add
def hanging_chain(quick: bool) -> Iterator[Check]:
    """Slopes of a hung chain of n masses grow by m g / H a link; of many, y = a cosh(x / a) (Joh. Bernoulli 1691).

    Links k = 0 .. n carry (H, (k - n / 2) m g) (funicular polygon, Varignon 1725). The polygon's sag tends to the
    catenary's as 1 / n^2. Started in equilibrium it stays, and its joints carry the tensions.
    """
    from scipy.optimize import brentq

    span, length, dt = 2.0, 3.0, 1 / 128
    a = float(brentq(lambda a: 2 * a * math.sinh(span / (2 * a)) - length, 0.1, 10.0, xtol=1e-14))
    sag = a * (math.cosh(span / (2 * a)) - 1)
    numbers = (5, 10, 20, 40)
    sags = [float(-hung(n, span, length)[0][:, 1].min()) - sag for n in (7, 15, 31, 63)]
    yield order_check("the polygon's sag (1 / links for dt)", [1 / 8, 1 / 16, 1 / 32, 1 / 64], sags, 2.0)
    for number in numbers[:2] if quick else numbers:
        for dtype in ("float64", "float32"):
            places, tension = hung(number, span, length)
            builder = world(length_scale=0.1)
            bodies = [
                builder.add_body(at, type=dc.BodyType.STATIC) if i in (0, number + 1) else bob(builder, at)
                for i, at in enumerate(places)
            ]
            for left, right in itertools.pairwise(bodies):
                builder.add_distance_joint(left, right, length=length / (number + 1))
            sim = simulation(builder, dtype, max_sweeps=20_000)
            n = 64
            sim.run(n, dt)
            limit = leftover(dtype, n, 1.0)
            where = f"{number} masses, {dtype}"
            yield near(f"{where}: places [m]", pose(sim)[:, :2], places, limit)
            pull = -sim.joints.numpy("joint_impulse") / dt
            # errors of a step's impulses add up along the chain
            yield near(f"{where}: tensions [N]", pull, tension, number * leftover(dtype, 1, 1.0) / dt)


@cases.add
def chain_frequencies(quick: bool) -> Iterator[Check]:
    """A hanging chain swings at j_0k / 2 sqrt(g / L), zeros of J_0 (D. Bernoulli 1733); of n masses at sqrt(g x / l).

    x are the zeros of the Laguerre polynomial L_n, the mode is L_i(x) at mass i from below. In steps
    sin(w' dt / 2) = w dt / 2; the swing of a / L changes the period by its square.
    """
    from scipy.special import eval_laguerre, jn_zeros, roots_laguerre

    number, length, dt, swing = 12, 2.0, 1 / 256, 2e-4
    link = length / number
    for mode in (0, 1, 2):
        x = float(roots_laguerre(number)[0][mode])
        w = math.sqrt(G * x / link)
        bessel = float(jn_zeros(0, mode + 1)[-1]) / 2 * math.sqrt(G / length)
        yield relative(f"mode {mode + 1}: {w:.4f} rad/s, continuous {bessel:.4f}", w, bessel, (mode + 1) / number)
        shape = swing * np.array([eval_laguerre(i, x) for i in range(number + 1)])[::-1]  # from the peg
        builder = world(length_scale=0.1)
        before, at = builder.add_body(type=dc.BodyType.STATIC), np.zeros(2)
        for step in np.diff(shape):
            at = at + np.array((step, -math.sqrt(link**2 - step**2)))
            body = bob(builder, at)
            builder.add_distance_joint(before, body, length=link)
            before = body
        sim = simulation(builder, max_sweeps=20_000)
        end = 4 * 2 * math.pi / w
        t = crossings(record(sim, round(end / dt), dt, lambda s: pose(s)[-1, 0]), dt)
        found = 2 * math.pi * (len(t) - 1) / 2 / (t[-1] - t[0])
        stepped = 2 / dt * math.asin(w * dt / 2)
        # interpolation of a crossing: (w dt)^2 / 8 of dt; amplitude: slopes squared
        limit = float(np.abs(np.diff(shape)).max() / link) ** 2 + (w * dt) ** 3
        yield relative(f"mode {mode + 1}: w' in steps", found, stepped, limit)
