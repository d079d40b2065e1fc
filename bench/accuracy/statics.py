"""Loads and thresholds of things that stand: stacks, notches, ladders, blocks, piles of three discs.

What stands is solved to its rest in each step, so it moves by what rounding leaves, and by less than the slop where
surfaces overlap at the start; what falls moves as the closed form says, or by a stated least way.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import (
    G,
    at_least,
    box,
    cases,
    creep,
    disc,
    floor,
    leftover,
    loads,
    near,
    order_check,
    pose,
    relative,
    simulation,
    tilted,
    velocity,
    world,
)
from bench.verdicts import Check


@cases.add
def stack_loads(quick: bool) -> Iterator[Check]:
    """Contact k of a stack carries g times the masses above it (Newton 1687, third law); corners of a box alike.

    What rounding leaves is larger by the condition number of the stack's Delassus matrix, of unit diagonal; in the
    corners once more by (height / half width)^2.
    """
    dt = 1 / 128
    masses = np.array([3.0, 0.5, 2.0, 1.0, 1.5, 0.8, 2.5, 1.0, 0.6, 1.2])
    expected = G * masses[::-1].cumsum()[::-1]
    delassus = np.diag(1 / masses + np.append(0, 1 / masses[:-1])) - np.diag(1 / masses[:-1], 1)
    delassus -= np.diag(1 / masses[:-1], -1)
    condition = float(np.linalg.cond(delassus / np.sqrt(np.outer(np.diag(delassus), np.diag(delassus)))))
    for kind in ("discs", "boxes"):
        for dtype, method, acceleration in (
            ("float64", "pgs", "none"),
            ("float64", "pgs", "aitken"),
            ("float64", "pgs", "adaptive"),
            ("float64", "jacobi", "aitken"),
            ("float32", "pgs", "adaptive"),
        ):
            builder = world()
            bodies = [floor(builder)]
            for i, mass in enumerate(masses):
                at = (0.0, 0.25 + 0.5 * i)
                bodies.append(
                    disc(builder, at, 0.25, mass=mass) if kind == "discs" else box(builder, at, 0.4, 0.25, mass=mass)
                )
            sim = simulation(builder, dtype, acceleration, method=method, max_sweeps=20_000)
            # the cache brings the loads of the step before, so each step takes the error on by its contraction
            sim.run(20, dt)
            force, _, upper = loads(sim, dt)
            carried = np.array([force[upper == body, 0].sum() for body in bodies[1:]])
            limit = 1e-9 if dtype == "float64" else condition * float(np.finfo(dtype).eps)
            where = f"{kind}, {dtype} {method} {acceleration}"
            yield Check(f"{where}: relative error of a load", float(np.abs(carried / expected - 1).max()), limit, sim)
            if kind == "boxes":
                pairs = force[np.argsort(upper, kind="stable"), 0].reshape(-1, 2)
                uneven = float(np.abs(pairs[:, 0] / pairs[:, 1] - 1).max())
                yield Check(f"{where}: corners differ by", uneven, (5.0 / 0.4) ** 2 * limit, sim)


@cases.add
def disc_in_a_groove(quick: bool) -> Iterator[Check]:
    """Between smooth planes of slopes a and b each carries N_a = m g sin(b) / sin(a + b) (Lami's theorem, 1679)."""
    dt = 1 / 128
    for dtype in ("float64", "float32"):
        for a, b in np.radians(((35.0, 35.0), (20.0, 60.0), (5.0, 80.0), (45.0, 5.0))):
            builder = world()
            ground = builder.add_body(type=dc.BodyType.STATIC)
            left, right = 4 * np.array([-math.cos(a), math.sin(a)]), 4 * np.array([math.cos(b), math.sin(b)])
            builder.add_chain(ground, (left, (0.0, 0.0), right), friction=0.0)
            # on the bisector of the groove, at distance r from both planes
            axis = math.pi / 2 + (a - b) / 2 * -1
            away = 0.5 / math.sin((math.pi - a - b) / 2)
            disc(builder, (away * math.cos(axis), away * math.sin(axis)), 0.5, mu=0.0, mass=2.0)
            sim = simulation(builder, dtype)
            sim.run(10, dt)
            force, _, _ = loads(sim, dt)
            expected = 2.0 * G * np.array([math.sin(b), math.sin(a)]) / math.sin(a + b)
            # the smaller the angle between the normals, the worse conditioned the two loads
            limit = leftover(dtype, 1, 1.0) / dt / math.sin((a + b) / 2) ** 2
            yield near(
                f"{dtype}, {math.degrees(a):.0f} and {math.degrees(b):.0f} deg: N [N]", force[:, 0], expected, limit
            )


@cases.add
def toppling_box(quick: bool) -> Iterator[Check]:
    """A box b wide and h high on a rough slope topples if tan(theta) > b / h.

    alpha = g (h' sin - b' cos) / (4/3 (b'^2 + h'^2)), b' and h' halves: moments about the lower corner (Hibbeler,
    Dynamics, chapter 17). The first step's spin is alpha dt exactly; then the lever grows: alpha t is a lower bound.
    """
    dt = 1 / 128
    sizes = ((0.5, 0.5), (0.3, 0.6), (0.4, 1.2))
    for (half_width, half_height), dtype in itertools.product(sizes, ("float64", "float32")):
        for share in (0.5, 0.99, 0.999, 1.001, 1.01, 1.2):
            theta = math.atan(share * half_width / half_height)
            builder = world(tilted(theta))
            floor(builder, friction=2.0)
            body = box(builder, (0.0, half_height), half_width, half_height, mu=2.0)
            sim = simulation(builder, dtype)
            where = f"b/h {half_width / half_height:.3g}, {share:g} of the angle, {dtype}"
            sim.step(dt)
            square = 4 / 3 * (half_width**2 + half_height**2)
            alpha = G * (half_height * math.sin(theta) - half_width * math.cos(theta)) / square
            limit = leftover(dtype, 1, 1.0) / half_width
            yield near(f"{where}: w after a step", velocity(sim)[body, 2], -max(alpha, 0.0) * dt, limit, sim)
            sim.run(127, dt)
            if share < 1:
                start = np.array((0.0, half_height, 0.0))
                # its tilt is as much worse conditioned as it is slender
                limit = creep(dtype, 1.0, (half_height / half_width) ** 2)
                yield near(f"{where}: stands, moved [m]", pose(sim)[body], start, limit, sim)
            else:
                yield at_least(f"{where}: falls, turned", -pose(sim)[body, 2], alpha / 2, sim)


@cases.add
def ladder(quick: bool) -> Iterator[Check]:
    """A ladder slips below tan(theta) = (1 - mu_f mu_w) / (2 mu_f), floor and wall both at their limit.

    Forces and moments (Hibbeler, Statics, chapter 8). Here it is a capsule of radius r, whose contacts lie r below its
    lower and r beside its upper centre: L cos / 2 (1 + mu_f mu_w) = mu_f (L sin + r + mu_w (L cos + r)) there.
    """
    from scipy.optimize import brentq

    length, radius, dt = 4.0, 0.05, 1 / 64

    for mu_f, mu_w in ((0.3, 0.2), (0.5, 0.0), (0.4, 0.6)):

        def excess(t: float, mu_f: float = mu_f, mu_w: float = mu_w) -> float:
            up, out = length * math.sin(t), length * math.cos(t)
            return out / 2 * (1 + mu_f * mu_w) - mu_f * (up + radius + mu_w * (out + radius))

        threshold = float(brentq(excess, 0.01, 1.57))
        thin = math.atan((1 - mu_f * mu_w) / (2 * mu_f))
        yield near(f"mu {mu_f}, {mu_w}: threshold to that of a thin one [rad]", threshold, thin, 2 * radius / length)
        for share in (0.98, 0.995, 1.005, 1.02):
            theta = share * threshold
            foot = np.array((length * math.cos(theta), 0.0)) + radius
            top = np.array((0.0, length * math.sin(theta))) + radius
            builder = world()
            for at, half, mu in (((0.0, -1.0), (9.0, 1.0), mu_f), ((-1.0, 4.0), (1.0, 5.0), mu_w)):
                body = builder.add_body(at, type=dc.BodyType.STATIC)
                # the friction of a pair is the root of both shapes': the ladder has 1
                builder.add_box(body, *half, friction=mu**2)
            rod = builder.add_body((foot + top) / 2, mass=1.0)
            builder.add_capsule(rod, foot - (foot + top) / 2, top - (foot + top) / 2, radius, friction=1.0)
            sim = simulation(builder)
            start = pose(sim)[rod]
            sim.run(128, dt)
            moved = float(np.abs(pose(sim)[rod] - start).max())
            where = f"mu {mu_f}, {mu_w}, {share:g} of the angle"
            if share > 1:
                yield Check(f"{where}: stands, moved [m]", moved, creep("float64", 2.0), sim)
            else:
                yield at_least(f"{where}: slips [m]", moved, 0.02, sim)


def three_discs(phi: float, mu_dd: float, mu_f: float, dtype: str = "float64") -> dc.Simulation:
    """A disc on two others, the line of centres phi from the vertical; radius 0.5."""
    radius = 0.5
    builder = world()
    # the friction of a pair is the root of both shapes'
    floor(builder, friction=mu_f**2 / mu_dd if mu_dd else 0.0)
    for x, y in ((-math.sin(phi), 0.0), (math.sin(phi), 0.0), (0.0, math.cos(phi))):
        disc(builder, (2 * radius * x, radius + 2 * radius * y), radius, mu=mu_dd)
    return simulation(builder, dtype)


@cases.add
def three_disc_pile(quick: bool) -> Iterator[Check]:
    """A disc on two equal ones stands iff mu_dd >= tan(phi / 2) and mu_f >= tan(phi / 2) / 3.

    phi: of the line of centres to the vertical, 30 deg if the lower ones touch: 2 - sqrt(3) and a third of it. Moments
    of a lower disc make both its friction forces F equal; N sin(phi) = F (1 + cos(phi)), so F = N tan(phi / 2); the
    upper one's weight is W = 2 N, the floor carries 3/2 W under each (derived here; F / N is that of any disc in a
    wedge of angle phi).
    """
    for degrees in (30.0, 31.0, 40.0):
        phi = math.radians(degrees)
        need = math.tan(phi / 2)
        for name, mu_dd, mu_f, stands in (
            ("mu_dd 1.01", 1.01 * need, 1.0, True),
            ("mu_dd 0.99", 0.99 * need, 1.0, False),
            ("mu_f 1.01", 1.0, 1.01 * need / 3, True),
            ("mu_f 0.99", 1.0, 0.99 * need / 3, False),
            ("both 1.01", 1.01 * need, 1.01 * need / 3, True),
        ):
            for dtype in ("float64", "float32"):
                sim = three_discs(phi, mu_dd, mu_f, dtype)
                start = pose(sim)
                sim.run(128, 1 / 64)
                moved = float(np.abs(pose(sim) - start).max())
                where = f"{degrees:g} deg, {name} of its threshold, {dtype}"
                if stands:
                    yield Check(f"{where}: stands, moved [m]", moved, creep(dtype, 2.0), sim)
                else:
                    yield at_least(f"{where}: falls [m]", moved, 0.01, sim)
    sim = three_discs(math.radians(40.0), 1.0, 1.0)
    sim.run(32, 1 / 64)
    force, lower, upper = loads(sim, 1 / 64)
    between = (upper == 3) & (lower > 0)
    # mass 1: N = W / 2, F = N tan(phi / 2)
    expected = np.array([[0.5, 0.5 * math.tan(math.radians(20.0))]] * 2) * G
    yield relative("forces between discs", np.abs(force[between]), expected, leftover("float64", 1, 1.0) * 64, sim)


@cases.add
def three_disc_slide(quick: bool) -> Iterator[Check]:
    """Without friction the upper disc drives the others apart: x^2 + y^2 = 4 r^2 until the contacts open.

    With x = 2 r sin(p), y = 2 r cos(p): T = 2 m r^2 (1 + cos(p)^2) p'^2, V = 2 m r g cos(p); Lagrange's equation is
    solved by DOP853 at 1e-12. First order in dt.
    """
    from scipy.integrate import solve_ivp

    radius, p0, end = 0.5, math.radians(35.0), 0.25

    def rate(_: float, s: np.ndarray) -> tuple[float, float]:
        p, w = s
        sine, cosine = math.sin(p), math.cos(p)
        inertia = 4 * radius**2 * (1 + cosine**2)
        return w, (2 * radius * G * sine + 4 * radius**2 * cosine * sine * w * w) / inertia

    solution = solve_ivp(rate, (0.0, end), (p0, 0.0), method="DOP853", rtol=1e-12, atol=1e-13)
    p, w = solution.y[:, -1]
    energy = 2 * radius * G * (math.cos(p0) - math.cos(p)) - 2 * radius**2 * (1 + math.cos(p) ** 2) * w**2
    yield near("energy of the reference [m^2/s^2]", energy, 0.0, 1e-9)
    steps = tuple(1 / n for n in (64, 128, 256, 512, 1024))
    errors = []
    for dt in steps:
        sim = three_discs(p0, 0.0, 0.0)
        sim.run(round(end / dt), dt)
        errors.append(float(pose(sim)[3, 1] - radius - 2 * radius * math.cos(p)))
    force, lower, _ = loads(sim, steps[-1])
    pressing = int((force[lower > 0, 0] > 0).sum())
    yield near("contacts between discs that press at the end", pressing, 2, 0.0, sim)
    yield order_check("the height of the upper disc", steps, errors)
    # steps: a fall of g t dt / 2, and what the arc leaves, (v dt)^2 / (4 r) a step: together below g t dt
    yield Check(f"height, dt 1/{1 / steps[-1]:.0f} [m]", abs(errors[-1]), G * end * steps[-1], sim)
