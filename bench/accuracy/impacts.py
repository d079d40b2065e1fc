"""Impacts of discs, and the ball that bounces for ever in finite time.

The simulator's law: Newton's restitution of the normal speed in every contact that closes within a step, Coulomb's
friction on the impulses, all contacts of a step at once (Moreau 1988, Unilateral Contact and Dry Friction in Finite
Freedom Dynamics).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import (
    EXACT,
    G,
    at_least,
    cases,
    disc,
    floor,
    leftover,
    loads,
    near,
    order_check,
    pose,
    record,
    simulation,
    velocity,
    world,
)
from bench.verdicts import Check
from dc_kernels import measure

MASSES, RADII = np.array([1.0, 2.5]), np.array([0.5, 0.3])


def pair_impact(
    masses: np.ndarray, radii: np.ndarray, before: np.ndarray, normal: np.ndarray, e: float, mu: float, k: float = 0.5
) -> np.ndarray:
    """v, w (2, 3) of two discs after an impact, normal from the first to the second (Foerster, Louge et al. 1994).

    J_n = (1 + e) m u_n with m = m1 m2 / (m1 + m2); the slip s ends by J_t = m s / (1 + 1 / k) if that is below mu J_n,
    else J_t = mu J_n.
    """
    tangent = np.array([normal[1], -normal[0]])
    reduced = masses.prod() / masses.sum()
    approach = (before[0, :2] - before[1, :2]) @ normal
    # the surface at +r n moves by w x r n = -w r t, at -r n by +w r t
    slip = (before[0, :2] - before[1, :2]) @ tangent - before[0, 2] * radii[0] - before[1, 2] * radii[1]
    along = (1 + e) * reduced * approach
    across = float(np.clip(reduced * slip / (1 + 1 / k), -mu * along, mu * along))
    impulse = along * normal + across * tangent
    after = before.copy()
    after[:, :2] += np.array([-impulse, impulse]) / masses[:, None]
    after[:, 2] += across / (k * masses * radii)
    return after


def add_discs(
    builder: dc.ModelBuilder, normal: np.ndarray, before: np.ndarray, gap: float, radii: np.ndarray, e: float, mu: float
) -> None:
    """A world of two discs without gravity, ``gap`` apart, the normal from the first to the second."""
    builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
    for at, v, m, r in zip(((0.0, 0.0), (radii.sum() + gap) * normal), before, MASSES, radii, strict=True):
        disc(builder, at, r, mass=m, mu=mu, restitution=e, velocity=v[:2], angular_velocity=v[2])


@cases.add
def disc_impacts(quick: bool) -> Iterator[Check]:
    """Two discs that touch, any e and mu: sticking and sliding impulses in closed form.

    J_n = (1 + e) m u_n; J_t = m s / (1 + 1 / k) or mu J_n, whichever is less (Routh 1905; Foerster, Louge, Chang,
    Allia, Measurements of the collision properties of small spheres, Physics of Fluids 6, 1994). Exact if they touch.
    """
    hits = []
    for angle in (-1.2, -0.3, 0.4, 1.0):
        normal = np.array([math.cos(angle), math.sin(angle)])
        hits += [(normal, np.array([[3.0, 0.5, spin], [-1.0, 0.25, 2.0]])) for spin in (-8.0, 0.0, 8.0)]
    stuck = slid = 0
    for dtype, acceleration in EXACT:
        for e in (0.0, 0.4, 1.0):
            for mu in (0.0, 0.1, 0.4):
                builder = dc.ModelBuilder()
                for normal, before in hits:
                    add_discs(builder, normal, before, 0.0, RADII, e, mu)
                sim = simulation(builder, dtype, acceleration)
                sim.step(1 / 1024)
                after = np.concatenate([pair_impact(MASSES, RADII, before, n, e, mu) for n, before in hits])
                force, _, _ = loads(sim, 1.0)
                slides = np.abs(np.abs(force[:, 1]) - mu * force[:, 0]) < 1e-6
                slid, stuck = slid + int(slides.sum()), stuck + int((~slides).sum())
                # rounding: spins of 30 rad/s after impulses over the inertia of the small disc
                limit = leftover(dtype, 1, 30.0, mass=0.5 * MASSES.min() * RADII.min())
                yield near(f"e {e}, mu {mu}, {dtype} {acceleration}: v, w", velocity(sim), after, limit)
    yield at_least("impacts of the rarer kind, sticking or sliding", min(stuck, slid), 20)


@cases.add
def disc_impacts_from_afar(quick: bool) -> Iterator[Check]:
    """The same impacts after a flight: the gap g < u dt at which they happen turns normal and arms, an O(dt).

    Against the closed form with the normal of the impact: arms of r + g / 2 change the slip by (|w1| + |w2|) g / 2, the
    mass that it meets by g / r of itself at most, and the torque by g / (2 r).
    """
    for dt in (1 / 64, 1 / 256, 1 / 1024):
        for e, mu in ((1.0, 0.0), (0.5, 0.02), (0.8, 0.9)):
            before = np.array([[3.0, 0.5, 8.0], [-1.0, 0.25, -3.0]])
            builder = dc.ModelBuilder()
            add_discs(builder, np.array([0.8, 0.6]), before, 0.15, RADII, e, mu)
            sim = simulation(builder)
            while not sim.contacts.numpy("impulse")[:1, 0].any() and sim.state.numpy("time")[0] < 1.0:
                sim.step(dt)
            normal, gap = sim.contacts.numpy("normal")[0].copy(), float(sim.contacts.numpy("gap")[0])
            impulse = sim.contacts.numpy("impulse")[0].copy()
            after = pair_impact(MASSES, RADII, before, normal, e, mu)
            approach = float((before[0, :2] - before[1, :2]) @ normal)
            where = f"e {e}, mu {mu}, dt 1/{1 / dt:.0f}"
            yield Check(f"{where}: gap over u dt", gap / (approach * dt), 1.0 + 1e-9)
            reduced, small = MASSES.prod() / MASSES.sum(), RADII.min()
            off = reduced / 3 * np.abs(before[:, 2]).sum() * gap / 2 + 1.5 * abs(impulse[1]) * gap / small
            limit = leftover("float64", round(0.2 / dt), 30.0) + (off if mu else 0.0) / (0.5 * MASSES * RADII).min()
            yield near(f"{where}: v, w", velocity(sim), after, limit, sim)


@cases.add
def disc_hits_floor(quick: bool) -> Iterator[Check]:
    """A spinning disc on a floor: the slip s = v_x + w r ends if |s| <= (1 + 1 / k) mu (1 + e) v_n, else it slides on.

    dv_x = -s k / (1 + k), or -mu (1 + e) v_n sign(s); dw = dv_x / (k r); v_y = e v_n (Routh 1905).
    """
    radius, mu, e, vx, vn = 0.3, 0.25, 0.6, 1.5, 4.0
    for dtype, acceleration in EXACT:
        for k in (0.5, 1.0):
            for spin in (-40.0, -3.0, 0.0, 2.0, 40.0):
                builder = world((0.0, 0.0))
                floor(builder, friction=mu, restitution=e)
                body = disc(
                    builder, (0.0, radius), radius, k=k, mu=mu, restitution=e, velocity=(vx, -vn), angular_velocity=spin
                )
                sim = simulation(builder, dtype, acceleration)
                sim.run(5, 1 / 128)
                slip, most = vx + spin * radius, mu * (1 + e) * vn
                change = float(np.clip(-slip * k / (1 + k), -most, most))
                expected = (vx + change, e * vn, spin + change / (k * radius))
                limit = leftover(dtype, 5, max(abs(spin), 30.0), mass=k * radius)
                yield near(f"k {k}, spin {spin:g}, {dtype} {acceleration}: v, w", velocity(sim)[body], expected, limit)


def oblique_hit(dtype: str, shape: str, e: float, mu: float, offset: float, correction: str) -> tuple[float, float]:
    """Change of the angular momentum, over its value, and what position correction may change it by, in 50 steps.

    Correction moves a pair by less than their overlap at each contact, at velocities v: by m* v times that, m* the
    reduced mass.
    """
    builder = world((0.0, 0.0))
    for x, y, v in ((-1.5, offset, 10.0), (1.5, 0.0, -5.0)):
        body = builder.add_body((x, y), 0.3 * offset, (v, 0.0), 3.0 * offset)
        if shape == "disc":
            builder.add_disc(body, 0.5, friction=mu, restitution=e)
        else:
            builder.add_box(body, 0.5, 0.5, friction=mu, restitution=e)
    sim = simulation(builder, dtype, position_correction=correction)
    before, start = measure.momentum(sim).angular[0], velocity(sim)
    moved = 0.0
    for _ in range(50):
        sim.step(0.01)
        used = sim.contacts.numpy("gap")[: sim.contacts.numpy("contact_count")[0]]
        speed = float(np.hypot(*(velocity(sim)[0] - velocity(sim)[1])[:2]))
        moved += float(np.maximum(-used, 0.0).sum()) * speed * sim.model.numpy("mass")[0] / 2
    if np.abs(velocity(sim) - start).max() < 0.1:
        raise ValueError(f"the {shape} at offset {offset} missed the other one")
    return abs(measure.momentum(sim).angular[0] / before - 1), moved / abs(before)


@cases.add
def oblique_hits_keep_angular_momentum(quick: bool) -> Iterator[Check]:
    """Both impulses of a contact act at one point, so sum(r x m v + I w) stays (Euler); to 1e-5 at dt 0.01.

    A study of 2026 saw Box2D v3 lose 7.8 % in an oblique elastic hit at this step. float64 keeps it to rounding.
    Position correction moves bodies at the velocities they have, which changes it where they overlap: after inelastic
    hits.
    """
    for dtype, bar in (("float64", 1e-12), ("float32", 1e-5)):
        for shape in ("disc", "box"):
            for e, mu in ((1.0, 0.0), (1.0, 0.5), (0.5, 0.5), (0.0, 0.5)):
                for correction in ("ngs", "none") if shape == "box" and e == 0 else ("ngs",):
                    hits = [oblique_hit(dtype, shape, e, mu, offset, correction) for offset in (-0.9, -0.5, 0.3, 0.7)]
                    change = max(loss for loss, _ in hits)
                    limit = bar + (max(moved for _, moved in hits) if shape == "box" and e == 0 else 0.0)
                    limit = bar if correction == "none" else limit
                    yield Check(f"{shape}, e {e}, mu {mu}, {dtype}, {correction}: relative change of L", change, limit)


@cases.add
def billiard(quick: bool) -> Iterator[Check]:
    """Equal elastic discs without friction part at a right angle: |v|^2 = |v1|^2 + |v2|^2, v = v1 + v2 (Huygens 1669).

    The struck one leaves along the line of centres, sin(phi) = b / (2 r) at impact parameter b; the gap g <= v dt at
    the impact takes tan(phi) g / (2 r) off phi.
    """
    radius, v0 = 0.5, 4.0
    for dtype in ("float64", "float32"):
        for b in (0.0, 0.3, 0.7, 0.9):
            for dt in (1 / 64, 1 / 1024):
                builder = world((0.0, 0.0))
                disc(builder, (-1.5, b), radius, mu=0.0, restitution=1.0, velocity=(v0, 0.0))
                disc(builder, (0.0, 0.0), radius, mu=0.0, restitution=1.0)
                sim = simulation(builder, dtype)
                n = round(0.6 / dt)
                sim.run(n, dt)
                v = velocity(sim)[:, :2]
                limit = leftover(dtype, n, v0) * v0
                where = f"b {b}, {dtype}, dt 1/{1 / dt:.0f}"
                yield near(f"{where}: v1 . v2 [m^2/s^2]", v[0] @ v[1], 0.0, limit, sim)
                yield near(f"{where}: energy [m^2/s^2]", (v * v).sum(), v0**2, 2 * limit, sim)
                if b:
                    phi = math.asin(b / (2 * radius))
                    off = math.tan(phi) * v0 * dt / (2 * radius) + limit
                    yield near(f"{where}: direction [rad]", math.atan2(-v[1, 1], v[1, 0]), phi, off, sim)


@cases.add
def three_ball_cradle(quick: bool) -> Iterator[Check]:
    """Touching balls, e = 1: (v, 0, 0) -> (-1/3, 2/3, 2/3) v. With gaps, one impact after the other: (0, 0, v).

    Touching: Newton's law in the contact that closes, no approach in the other, both at once (Moreau 1988; Glocker and
    Aeberhard, The Geometry of Newton's Cradle, 2006); momentum and energy stay. The real cradle, whose waves run
    through the balls one after the other, does as with gaps (Herrmann and Seitz 1982).
    """
    v = 3.0
    for dtype, acceleration in EXACT:
        for gap, expected in ((0.0, (-v / 3, 2 * v / 3, 2 * v / 3)), (0.05, (0.0, 0.0, v))):
            builder = world((0.0, 0.0))
            for i in range(3):
                disc(builder, (i * (1.0 + gap), 0.0), 0.5, mu=0.0, restitution=1.0, velocity=(v * (i == 0), 0.0))
            sim = simulation(builder, dtype, acceleration)
            n = 64
            sim.run(n, 1 / 1024)
            limit = leftover(dtype, n, v)
            yield near(f"gap {gap:g} m, {dtype} {acceleration}: v [m/s]", velocity(sim)[:, 0], expected, limit, sim)


def bounces(dt: float, e: float, heights: np.ndarray, time: float, dtype: str = "float64") -> np.ndarray:
    """Height of each of a batch of bouncing balls after each step, (steps, balls)."""
    builder = dc.ModelBuilder()
    for h in heights:
        builder.add_world(gravity=(0.0, -G))
        floor(builder, restitution=e)
        disc(builder, (0.0, 0.1 + h), 0.1, restitution=e)
    sim = simulation(builder, dtype, slop=1e-6)
    return record(sim, round(time / dt), dt, lambda s: s.state.numpy("position")[1::2, 1] - 0.1)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def turns(height: np.ndarray) -> np.ndarray:
    """Indices at which a height is least between a fall and a rise."""
    return 1 + np.flatnonzero((height[1:-1] <= height[:-2]) & (height[1:-1] < height[2:]))


@cases.add
def zeno_ball(quick: bool) -> Iterator[Check]:
    """The n-th bounce reaches h e^(2n); all bounces end after sqrt(2 h / g) (1 + e) / (1 - e) (Goldsmith 1960, Impact).

    A ball that comes down at v bounces at y <= v dt, before it touches, with v^2 = 2 g (h - y) - g v dt, and goes on to
    y + u^2 / (2 g) + u dt / 2, u = e v: up to (1 - e) (1 + 3/2 e) v dt too high, first order. Errors are root mean
    squares over balls from 48 heights, as where a step meets the floor is a matter of chance. Launched at u within
    u dt / e it is back at u + (1 / e - 1) g dt at most, so leaves at u' <= e u + (1 - e) g dt: after N bounces, each
    longer by 2 dt + dt / e at most, it stays below u dt / e + u^2 / (2 g) with u = g dt, here 1.1 times that as N is
    finite.
    """
    e = 0.7
    heights = np.linspace(0.9, 1.1, 48)
    steps = (1 / 256, 1 / 512, 1 / 1024, 1 / 2048) + (() if quick else (1 / 4096, 1 / 8192))
    end = math.sqrt(2 * 1.1 / G) * (1 + e) / (1 - e)
    fourth = np.sqrt(2 * heights / G) * (1 + 2 * (e + e**2 + e**3))
    errors: list[list[float]] = [[], [], [], []]
    for dt in steps:
        number = math.log(10 * e * math.sqrt(2 * G * 1.1) / (G * dt)) / math.log(1 / e)
        late = end + number * (2 + 1 / e) * dt
        height = bounces(dt, e, heights, late + 0.2)
        for n in (1, 2, 3):
            tops = np.array([column[turns(-column)[n - 1]] for column in height.T])
            errors[n - 1].append(rms(tops / (heights * e ** (2 * n)) - 1))
        times = np.array([turns(column)[3] + 1 for column in height.T]) * dt
        errors[3].append(rms(times - fourth))
        launch = 1.1 * G * dt
        left = float(height[round(late / dt) :].max())
        yield Check(f"dt 1/{1 / dt:.0f}: height after the end [m]", left, 1e-6 + launch * dt / e + launch**2 / (2 * G))
    dt = steps[-1]
    for n in (1, 2, 3):
        yield order_check(f"the height of bounce {n}", steps, errors[n - 1])
        before = np.arange(n)
        speeds = math.sqrt(2 * G * 0.9) * e**before
        limit = float(((1 - e) * (1 + 1.5 * e) * speeds * dt / (0.9 * e ** (2 * before + 2))).sum())
        yield Check(f"bounce {n}, dt 1/{1 / dt:.0f}: relative error of its height", errors[n - 1][-1], limit)
    yield order_check("the time of the fourth impact", steps, errors[3])


@cases.add
def elastic_ball(quick: bool) -> Iterator[Check]:
    """An elastic ball without friction returns to its height for ever: its steps mirror (Moreau 1988, u+ = -e u-).

    With u- the speed before the step's forces, v_n+1 = -v_n and y_n+1 = y_n - v_n dt = y_n-1: semi-implicit Euler runs
    backwards to where it began, to rounding, and again.
    """
    for dtype in ("float64", "float32"):
        for dt in (1 / 64, 1 / 512):
            heights = np.array([0.7, 1.0, 1.3])
            height = bounces(dt, 1.0, heights, 20.0, dtype)
            tops = np.array([[column[i] for i in turns(-column)[:15]] for column in height.T])
            limit = 4 * float(np.finfo(dtype).eps) * 1.3 * round(20.0 / dt)
            where = f"{dtype}, dt 1/{1 / dt:.0f}"
            yield near(f"{where}: heights of 15 bounces [m]", tops.T, heights, limit)


@cases.add
def resting_ball(quick: bool) -> Iterator[Check]:
    """What rests does not bounce, whatever e: its speed before the step's forces is zero (Moreau 1988)."""
    for e in (0.5, 1.0):
        builder = world()
        floor(builder, restitution=e)
        disc(builder, (0.0, 0.5), 0.5, restitution=e)
        sim = simulation(builder)
        path = record(sim, 200, 0.01, lambda s: velocity(s)[1, 1])
        yield near(f"e {e}: v [m/s]", path, 0.0, leftover("float64", 1, 1.0), sim)


@cases.add
def bounce_threshold(quick: bool) -> Iterator[Check]:
    """Below ``restitution_threshold`` a contact does not bounce, above it does with e: the setting's definition.

    It is a multiple of sqrt(gravity length_scale), here 1 m/s by a pull of 1 m/s^2 along the floor.
    """
    for speed, rebound in ((0.9, 0.0), (1.1, 0.55)):
        builder = world((1.0, 0.0), length_scale=1.0)
        floor(builder, restitution=0.5)
        body = disc(builder, (0.0, 0.6), 0.5, velocity=(0.0, -speed))
        sim = simulation(builder, restitution_threshold=1.0)
        sim.run(30, 0.01)
        yield near(f"{speed} m/s: v [m/s]", velocity(sim)[body, 1], rebound, leftover("float64", 30, 1.0), sim)


@cases.add
def gap_closes(quick: bool) -> Iterator[Check]:
    """Without restitution v = gap / dt is let through: a body arrives at gap 0, neither short of it nor through it."""
    for speed in (0.5, 3.0, 30.0):
        builder = world((0.0, 0.0))
        floor(builder)
        disc(builder, (0.0, 1.237), 0.5, velocity=(0.0, -speed))
        sim = simulation(builder)
        height = record(sim, round(1.5 / speed / 0.01) + 5, 0.01, lambda s: pose(s)[1, 1])
        yield near(f"{speed:g} m/s: end [m]", height[-1], 0.5, 1e-12, sim)
        yield near(f"{speed:g} m/s: lowest [m]", height.min(), 0.5, 1e-12, sim)
