"""Free fall, sliding and rolling.

Routh 1905: E. J. Routh, The Elementary Part of a Treatise on the Dynamics of a System of Rigid Bodies, 7th ed.
Irodov: I. E. Irodov, Problems in General Physics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import (
    EXACT,
    G,
    box,
    cases,
    disc,
    floor,
    leftover,
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

DTS = (1 / 32, 1 / 64, 1 / 128, 1 / 256, 1 / 512)


@cases.add
def free_fall(quick: bool) -> Iterator[Check]:
    """Free fall: v = v0 - g t, y = y0 + v0 t - g t^2 / 2 (Galilei); in steps lower by g t dt / 2 exactly.

    Semi-implicit Euler with n = t / dt: v_n = v0 - n g dt, y_n = y0 + n v0 dt - n (n + 1) g dt^2 / 2 (Hairer, Lubich,
    Wanner, Geometric Numerical Integration, 2006, I.1.2). The body also turns by w0 t.
    """
    for dtype in ("float64", "float32"):
        for dt in DTS[1:4:2]:
            builder = world()
            disc(builder, (0.0, 3.0), 0.5, velocity=(1.0, 2.0), angular_velocity=3.0)
            sim = simulation(builder, dtype)
            n = round(1 / dt)
            sim.run(n, dt)
            fall = 3.0 + n * 2.0 * dt - n * (n + 1) / 2 * G * dt**2
            yield near(f"{dtype} dt 1/{n}, pose [m]", pose(sim)[0], (1.0, fall, 3.0), leftover(dtype, n, G))
            yield near(f"{dtype} dt 1/{n}, v [m/s]", velocity(sim)[0], (1.0, 2.0 - G, 3.0), leftover(dtype, n, G))
    errors = []
    for dt in DTS:
        builder = world()
        disc(builder, (0.0, 3.0), 0.5, velocity=(1.0, 2.0))
        sim = simulation(builder)
        sim.run(round(1 / dt), dt)
        errors.append(pose(sim)[0, 1] - (5.0 - G / 2))
    yield order_check("a fall's way", DTS, errors)
    yield relative("its constant: error / (g t dt / 2) - 1", -np.array(errors) / (G / 2 * np.array(DTS)), 1.0, 1e-9)


@cases.add
def applied_force_and_torque(quick: bool) -> Iterator[Check]:
    """Constant force and torque: v = F t / m, w = M t / I (Newton, Euler); the ways are longer by a t dt / 2."""
    dt, n = 1 / 64, 64
    for dtype in ("float64", "float32"):
        builder = world((0.0, 0.0))
        disc(builder, (0.0, 0.0), 0.5, mass=2.0)
        sim = simulation(builder, dtype)
        sim.state.assign("force", np.array([[3.0, -1.0]], sim.dtype))
        sim.state.assign("torque", np.array([0.5], sim.dtype))
        sim.run(n, dt)
        rates = np.array([1.5, -0.5, 0.5 / (0.5 * 2.0 * 0.25)])
        yield near(f"{dtype} velocity [m/s]", velocity(sim)[0], rates, leftover(dtype, n, 2.0))
        yield near(f"{dtype} pose [m]", pose(sim)[0], rates / 2 * (1 + dt), leftover(dtype, n, 2.0))


@cases.add
def coulomb_stop(quick: bool) -> Iterator[Check]:
    """A sliding box stops after v0^2 / (2 mu g) (Coulomb 1785); in steps v_k = max(v0 - k mu g dt, 0).

    The way in steps is dt times the sum of v_k, some v0 dt / 2 shorter: first order.
    """
    v0, mu = 3.0, 0.4

    def slide(dt: float, dtype: str = "float64", acceleration: str = "none") -> np.ndarray:
        builder = world()
        floor(builder, friction=mu)
        body = box(builder, (0.0, 0.1), 0.5, 0.1, mu=mu, velocity=(v0, 0.0))
        sim = simulation(builder, dtype, acceleration)
        sim.run(round(1 / dt), dt)
        return np.array((*pose(sim)[body], *velocity(sim)[body]))

    for dtype, acceleration in EXACT:
        for dt in (1 / 16, 1 / 128):
            n = round(1 / dt)
            way = dt * np.maximum(v0 - mu * G * dt * np.arange(1, n), 0.0).sum()
            now = slide(dt, dtype, acceleration)
            limit = leftover(dtype, n, v0)
            yield near(f"{dtype} {acceleration} dt 1/{n}, x, y, angle [m]", now[:3], (way, 0.1, 0.0), limit)
            yield near(f"{dtype} {acceleration} dt 1/{n}, rest [m/s]", now[3:], 0.0, limit)
    errors = [slide(dt)[0] - v0**2 / (2 * mu * G) for dt in DTS]
    yield order_check("the way of a sliding box", DTS, errors)


@cases.add
def incline_box(quick: bool) -> Iterator[Check]:
    """A box on a slope rests if tan(theta) <= mu, else a = g (sin(theta) - mu cos(theta)) (Coulomb 1785).

    A constant force: v is exact in steps, x = a t^2 / 2 (1 + dt / t). With tilted gravity and with a tilted floor.
    """
    for theta in np.radians((10.0, 20.0, 35.0)):
        sine, cosine, tangent = math.sin(theta), math.cos(theta), math.tan(theta)
        for share in (0.0, 0.5, 0.999, 1.001, 3.0):
            mu = share * tangent
            a = max(0.0, G * (sine - mu * cosine))
            for dt in (1 / 16, 1 / 64) if quick else (1 / 16, 1 / 64, 1 / 256, 1 / 1024):
                builder = world(tilted(theta))
                floor(builder, friction=mu)
                body = box(builder, (0.0, 0.1), 0.4, 0.1, mu=mu)
                sim = simulation(builder)
                n = round(1 / dt)
                sim.run(n, dt)
                limit = leftover("float64", n, G)
                where = f"{math.degrees(theta):.0f} deg, mu {share:g} tan, dt 1/{n}"
                yield near(f"{where}: v [m/s]", velocity(sim)[body], (a, 0.0, 0.0), limit, sim)
                yield near(f"{where}: pose [m]", pose(sim)[body], (a / 2 * (1 + dt), 0.1, 0.0), limit, sim)
    theta, dt, n = math.radians(20.0), 1 / 64, 64
    for dtype, acceleration in EXACT:
        for mu in (0.40, 0.33):
            along = np.array([math.cos(theta), math.sin(theta)])
            out = np.array([-along[1], along[0]])
            builder = world()
            ground = builder.add_body(-out, angle=theta, type=dc.BodyType.STATIC)
            builder.add_box(ground, 40.0, 1.0, friction=mu)
            body = box(builder, 0.1 * out, 0.4, 0.1, mu=mu, angle=theta)
            sim = simulation(builder, dtype, acceleration)
            sim.run(n, dt)
            a = max(0.0, G * (math.sin(theta) - mu * math.cos(theta)))
            now = velocity(sim)[body]
            # the normal, turned by rounding of the angle, tilts gravity: eps times g t; the friction follows by tan
            limit = leftover(dtype, n, G)
            yield near(f"tilted, {dtype} {acceleration}, mu {mu}: v [m/s]", (-now[:2] @ along, now[2]), (a, 0), limit)


def roll(theta: float, k: float, mu: float, dt: float, dtype: str = "float64", acceleration: str = "none") -> tuple:
    """Pose and velocity after 1 s on a slope."""
    builder = world(tilted(theta))
    floor(builder, friction=mu)
    body = disc(builder, (0.0, 0.25), 0.25, k=k, mu=mu)
    sim = simulation(builder, dtype, acceleration)
    sim.run(round(1 / dt), dt)
    return pose(sim)[body], velocity(sim)[body], sim


@cases.add
def rolling(quick: bool) -> Iterator[Check]:
    """A round body rolls down with a = g sin(theta) / (1 + k) if tan(theta) <= mu (1 + 1 / k), else it slips.

    k = I / (m r^2): 1/2 for a solid disc, so 2/3 g sin(theta) up to tan(theta) = 3 mu; 1 for a ring: half, up to 2 mu.
    Slipping: a = g (sin(theta) - mu cos(theta)), spin mu g cos(theta) / (k r) (Routh 1905). Exact in v.
    """
    for k in (0.5, 1.0, 0.1):
        for theta in np.radians((10.0, 30.0)):
            threshold = math.tan(theta) / (1 + 1 / k)
            for share in (0.3, 0.999, 1.001, 2.0):
                mu = share * threshold
                rolls = share > 1
                a = G * math.sin(theta) / (1 + k) if rolls else G * (math.sin(theta) - mu * math.cos(theta))
                alpha = -a / 0.25 if rolls else -mu * G * math.cos(theta) / (k * 0.25)
                settings = EXACT if share in (0.3, 2.0) and k == 0.5 else EXACT[:1]
                for dtype, acceleration in settings:
                    for dt in (1 / 64,) if quick else (1 / 16, 1 / 64, 1 / 256):
                        x, v, sim = roll(theta, k, mu, dt, dtype, acceleration)
                        where = (
                            f"k {k}, {math.degrees(theta):.0f} deg, {share:g} mu, {dtype} {acceleration}, dt {dt:.3g}"
                        )
                        # an impulse acts on the surface by 1 / (k m)
                        limit = leftover(dtype, round(1 / dt), abs(alpha), mass=k * 0.25)
                        yield near(f"{where}: v, w", v, (a, 0.0, alpha), limit, sim)
                        yield near(f"{where}: x [m]", x[0], a / 2 * (1 + dt), limit, sim)
    errors = [roll(0.3, 0.5, 0.5, dt)[0][0] - G * math.sin(0.3) / 3 for dt in DTS]
    yield order_check("the way of a rolling disc", DTS, errors)


@cases.add
def slide_to_roll(quick: bool) -> Iterator[Check]:
    """A disc thrown at v0 without spin rolls at v0 / (1 + k) after t1 = v0 k / ((1 + k) mu g), whatever mu.

    Angular momentum about a point of the floor (Routh 1905): solid disc 2/3 v0 after v0 / (3 mu g). In steps the disc
    rolls after ceil(t1 / dt) of them.
    """
    v0, radius = 3.0, 0.4

    def throw(dt: float, mu: float, k: float, dtype: str, acceleration: str) -> tuple[np.ndarray, np.ndarray, int]:
        builder = world()
        floor(builder, friction=mu)
        body = disc(builder, (0.0, radius), radius, k=k, mu=mu, velocity=(v0, 0.0))
        sim = simulation(builder, dtype, acceleration)
        slips = []
        n = round(1.5 / dt)
        for _ in range(n):
            sim.step(dt)
            v = velocity(sim)[body]
            slips.append(abs(v[0] + v[2] * radius))
        rolls = int(np.argmax(np.array(slips) <= leftover(dtype, n, v0, mass=k))) + 1
        return pose(sim)[body], velocity(sim)[body], rolls

    dt = 1 / 128
    for dtype, acceleration in EXACT:
        for mu, k in ((0.1, 0.5), (0.6, 0.5), (0.3, 1.0)):
            x, v, rolls = throw(dt, mu, k, dtype, acceleration)
            speed = v0 / (1 + k)
            where = f"k {k}, mu {mu}, {dtype} {acceleration}"
            limit = leftover(dtype, 192, v0 / radius, mass=k * radius)
            yield near(f"{where}: v, w", v, (speed, 0.0, -speed / radius), limit)
            first = math.ceil(v0 * k / ((1 + k) * mu * G) / dt)
            yield near(f"{where}: step at which it rolls", rolls, first, 0.0)
            way = dt * np.maximum(v0 - mu * G * dt * np.arange(1, 193), speed).sum()
            yield near(f"{where}: x [m]", x[0], way, 1.5 * limit)
    a = 0.25 * G
    t1 = v0 / (3 * a)
    exact = v0 * t1 - a * t1**2 / 2 + 2 / 3 * v0 * (1.5 - t1)
    errors = [throw(step, 0.25, 0.5, "float64", "none")[0][0] - exact for step in DTS]
    yield order_check("the way of a disc that comes to roll", DTS, errors)


@cases.add
def spinning_disc_dropped(quick: bool) -> Iterator[Check]:
    """A disc of spin w set down on the floor rolls away at v = R w k / (1 + k) at last: R w / 3 if solid (Routh 1905).

    Angular momentum about the floor stays. Dropped, its first impulse acts through a gap of at most v dt, at half the
    gap above the floor: that changes the angular momentum by mu m v gap / 2 at most, and v by that over m R (1 + k).
    """
    radius, spin, mu = 0.5, 20.0, 0.4

    def drop(height: float, k: float, dt: float, dtype: str = "float64") -> np.ndarray:
        builder = world()
        floor(builder, friction=mu)
        body = disc(builder, (0.0, radius + height), radius, k=k, mu=mu, angular_velocity=-spin)
        sim = simulation(builder, dtype)
        sim.run(round(2.5 / dt), dt)
        return velocity(sim)[body]

    for dtype in ("float64", "float32"):
        for k in (0.5, 1.0):
            final = radius * spin * k / (1 + k)
            limit = leftover(dtype, 320, spin, mass=k * radius)
            yield near(
                f"set down, k {k}, {dtype}: v, w", drop(0.0, k, 1 / 128, dtype), (final, 0, -final / radius), limit
            )
    for dt in (1 / 64, 1 / 256):
        height = 0.3
        speed = math.sqrt(2 * G * height) + G * dt
        limit = mu * speed * speed * dt / 2 / (radius * 1.5)
        v = drop(height, 0.5, dt)
        yield near(f"dropped {height} m, dt 1/{1 / dt:.0f}: v [m/s]", v[0], radius * spin / 3, limit)
        yield near(f"dropped {height} m, dt 1/{1 / dt:.0f}: slip [m/s]", v[0] + v[2] * radius, 0.0, 1e-9)


@cases.add
def board_on_rollers(quick: bool) -> Iterator[Check]:
    """A board (M) on two rollers (m, k) moves twice as far as they do, on a slope too.

    There the rollers have a = g sin(theta) (2 M + 2 m) / (4 M + 2 m (1 + k)): power (2 M + 2 m) g sin(theta) v equals
    d/dt [M (2 v)^2 / 2 + 2 (1 + k) m v^2 / 2] (d'Alembert; Irodov, chapter 1.5). Exact in v, as the geometry stays.
    """
    big, small, radius, mu = 3.0, 0.7, 0.2, 0.9
    for dtype, acceleration in EXACT:
        for theta, k, v0 in ((0.2, 0.5, 0.0), (0.2, 1.0, 0.0), (0.0, 0.5, 0.5)):
            builder = world(tilted(theta))
            floor(builder, friction=mu)
            rollers = [
                disc(
                    builder,
                    (x, radius),
                    radius,
                    k=k,
                    mu=mu,
                    mass=small,
                    velocity=(v0, 0),
                    angular_velocity=-v0 / radius,
                )
                for x in (-0.8, 0.8)
            ]
            board = box(builder, (0.0, 2 * radius + 0.05), 2.0, 0.05, mu=mu, mass=big, velocity=(2 * v0, 0.0))
            sim = simulation(builder, dtype, acceleration)
            dt, n = 1 / 128, 64
            sim.run(n, dt)
            a = G * math.sin(theta) * (2 * big + 2 * small) / (4 * big + 2 * small * (1 + k))
            v, x = velocity(sim), pose(sim)
            way = v0 * n * dt + a / 2 * (n * dt) ** 2 * (1 + 1 / n)
            where = f"theta {theta}, k {k}, {dtype} {acceleration}"
            limit = leftover(dtype, n, 4.0, mass=small * k)
            yield near(f"{where}: rollers' v [m/s]", v[rollers, 0], v0 + a * n * dt, limit, sim)
            yield near(f"{where}: board's v [m/s]", v[board], (2 * (v0 + a * n * dt), 0.0, 0.0), limit, sim)
            yield near(f"{where}: ways [m]", x[[*rollers, board], 0], (way - 0.8, way + 0.8, 2 * way), limit, sim)


@cases.add
def cylinder_in_a_corner(quick: bool) -> Iterator[Check]:
    """A cylinder spinning in a corner slows down by 2 mu (1 + mu) g / (r (1 + mu^2)) (Irodov, chapter 1.5).

    Both contacts slip: N_wall = mu N_floor, N_floor + mu N_wall = m g, so N_floor = m g / (1 + mu^2).
    """
    radius, mu, spin, dt = 0.3, 0.25, 30.0, 1 / 128
    for dtype, acceleration in EXACT:
        builder = world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(-5.0, 0.0), (0.0, 0.0), (0.0, 5.0)], friction=mu)
        # turning clockwise it drives itself towards the wall at its right
        body = disc(builder, (-radius, radius), radius, mu=mu, angular_velocity=-spin)
        sim = simulation(builder, dtype, acceleration)
        n = 32
        sim.run(n, dt)
        slows = 2 * mu * (1 + mu) * G / (radius * (1 + mu**2))
        limit = leftover(dtype, n, spin, mass=0.5 * radius)
        yield near(
            f"{dtype} {acceleration}: v, w", velocity(sim)[body], (0.0, 0.0, -(spin - slows * n * dt)), limit, sim
        )
        force = sim.contacts.numpy("impulse")[:2, 0] / dt
        expected = np.array([1.0, mu]) * G / (1 + mu**2)
        # forces: the impulses over dt, with what one step leaves of them
        yield near(f"{dtype} {acceleration}: forces [N]", force, expected, leftover(dtype, 1, spin) / dt, sim)
        steps = math.ceil(spin / slows / dt) - n
        sim.run(steps, dt)
        yield near(f"{dtype} {acceleration}: at rest [m/s]", velocity(sim)[body], 0.0, 2 * limit, sim)
        way = dt * np.maximum(spin - slows * dt * np.arange(1, n + steps), 0.0).sum()
        yield near(f"{dtype} {acceleration}: way turned [rad]", -pose(sim)[body, 2], way, 2 * limit * spin / slows, sim)
