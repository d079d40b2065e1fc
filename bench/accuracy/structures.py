"""Blocks: overhang, arch, rocking, and Painlevé's rod."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import (
    EXACT,
    G,
    at_least,
    box,
    cases,
    creep,
    floor,
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


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@cases.add
def overhang(quick: bool) -> Iterator[Check]:
    """A stack of n blocks reaches out half a length times 1 + 1/2 + ... + 1/n at most (Paterson, Zwick 2009, Overhang).

    Block k from above overhangs the one below by l / (2 k) at most, the centre of what it carries then above its edge.
    """
    half, thick = 0.5, 0.1
    for number in (3, 5) if quick else (3, 5, 8):
        for dtype in ("float64", "float32"):
            for share in (0.5, 0.99, 1.01):
                builder = world()
                # the table ends at x = 0
                table = builder.add_body((-5.0, -1.0), type=dc.BodyType.STATIC)
                builder.add_box(table, 5.0, 1.0)
                x = 0.0
                for i in range(number):
                    x += share * half / (number - i)
                    box(builder, (x - half, (2 * i + 1) * thick), half, thick)
                sim = simulation(builder, dtype, max_sweeps=20_000)
                moved = movement(sim)
                where = f"{number} blocks, {share:g} of the overhang, {dtype}"
                if share < 1:
                    yield Check(f"{where}: stands, moved [m]", moved, creep(dtype, 2.0, number**2), sim)
                else:
                    yield at_least(f"{where}: falls [m]", moved, 0.01, sim)


def movement(sim: dc.Simulation) -> float:
    """Largest change of a place or an angle in two seconds [m]."""
    start = pose(sim)
    sim.run(128, 1 / 64)
    return float(np.abs(pose(sim) - start).max())


def voussoirs(number: int, thickness: float) -> list[np.ndarray]:
    """Corners of the blocks of a semicircular arch of mean radius 1, from the right."""
    angles = np.linspace(0.0, math.pi, number + 1)
    inner, outer = 1 - thickness / 2, 1 + thickness / 2
    ray = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    return [np.stack((inner * a, outer * a, outer * b, inner * b)) for a, b in itertools.pairwise(ray)]


def arch_imbalance(number: int, thickness: float) -> float:
    """Least sum of moments [N m] that the joints of an arch leave unbalanced, at weights of its area times 1 N/m^2.

    A linear programme: pressures at both ends of each joint and a shear force; each block's forces in balance.
    """
    from scipy.optimize import linprog

    from dc_kernels.model.shapes import mass_properties

    joints = 3 * (number + 1)
    balance, load = np.zeros((3 * number, joints + 2 * number)), np.zeros(3 * number)
    for j, angle in enumerate(np.linspace(0.0, math.pi, number + 1)):
        ray = np.array((math.cos(angle), math.sin(angle)))
        forward = np.array((-ray[1], ray[0]))  # from block j - 1 to block j
        for i, (direction, reach) in enumerate(
            ((forward, 1 - thickness / 2), (forward, 1 + thickness / 2), (ray, 1.0))
        ):
            moment = reach * (ray[0] * direction[1] - ray[1] * direction[0])
            for block, sign in ((j - 1, -1.0), (j, 1.0)):
                if 0 <= block < number:
                    balance[3 * block : 3 * block + 3, 3 * j + i] = sign * np.array((*direction, moment))
    for i, corners in enumerate(voussoirs(number, thickness)):
        area, centroid, _ = mass_properties(corners)
        load[3 * i : 3 * i + 3] = 0.0, area, area * centroid[0]
        balance[3 * i + 2, joints + 2 * i : joints + 2 * i + 2] = 1.0, -1.0
    bounds = [(0, None), (0, None), (None, None)] * (number + 1) + [(0, None)] * (2 * number)
    cost = np.concatenate((np.zeros(joints), np.ones(2 * number)))
    return float(linprog(cost, A_eq=balance, b_eq=load, bounds=bounds, method="highs").fun)


def least_thickness(number: int) -> float:
    """Thickness over mean radius below which no thrust line lies in the arch, to 1e-6 (by bisection)."""
    low, high = 0.03, 0.2
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if arch_imbalance(number, middle) > 1e-9 else (low, middle)
    return high


@cases.add
def arch_thickness(quick: bool) -> Iterator[Check]:
    """A semicircular arch needs t / R = 0.1075 at least (Couplet 1730; Milankovitch 1907, who gave the number).

    Of a finite number of blocks, which can open at their joints only, it needs less: that limit is a linear programme
    over thrust lines (Heyman 1966), which tends to 0.1075. Simulated 10 % above and below it, friction 2.
    """
    for number in (9, 21) if quick else (9, 15, 21, 31):
        limit = least_thickness(number)
        yield near(f"{number} blocks: t / R {limit:.4f} to 0.1075, of few blocks", limit, 0.1075, 0.5 / number)
        for dtype in ("float64", "float32"):
            for share in (1.1, 0.9):
                builder = world()
                ground = builder.add_body(type=dc.BodyType.STATIC)
                builder.add_box(ground, 3.0, 0.5, center=(0.0, -0.5), friction=2.0)
                for corners in voussoirs(number, share * limit):
                    builder.add_polygon(builder.add_body(mass=1.0), corners, friction=2.0)
                sim = simulation(builder, dtype, max_sweeps=20_000)
                moved = movement(sim)
                where = f"{number} blocks, {share} of it, {dtype}"
                if share > 1:
                    yield Check(f"{where}: stands, moved [m]", moved, creep(dtype, 2.0, number**2), sim)
                else:
                    yield at_least(f"{where}: falls [m]", moved, 0.05, sim)


@cases.add
def rocking_block(quick: bool) -> Iterator[Check]:
    """A block let go at theta0 comes down after a quarter period and goes on with r = 1 - 3/2 sin(alpha)^2 of its spin.

    Housner 1963, The behavior of inverted pendulum structures during earthquakes: tan(alpha) = b / h,
    p^2 = 3 g / (4 R), theta'' = -p^2 sin(alpha - theta); T / 4 = acosh(1 / (1 - theta0 / alpha)) / p for a slender one,
    here the integral of d theta / sqrt(2 p^2 (cos(alpha - theta0) - cos(alpha - theta))). No friction limit, e = 0.
    """
    from scipy.integrate import quad

    half_width, half_height = 0.2, 0.8
    alpha, reach = math.atan2(half_width, half_height), math.hypot(half_width, half_height)
    p = math.sqrt(3 * G / (4 * reach))
    starts = np.linspace(0.4, 0.6, 16) * alpha

    def quarter(theta0: float) -> float:
        # theta = theta0 (1 - s^2) takes the root out of the integrand's end
        def integrand(s: float) -> float:
            theta = theta0 * (1 - s * s)
            return 2 * theta0 * s / math.sqrt(2 * p * p * (math.cos(alpha - theta0) - math.cos(alpha - theta)))

        return float(quad(integrand, 0.0, 1.0, epsabs=1e-12)[0])

    exact = np.array([quarter(t) for t in starts])
    slender = math.acosh(1 / (1 - starts[0] / alpha)) / p
    yield relative("Housner's quarter period to the integral", slender, exact[0], alpha**2 / 6)
    steps = (
        tuple(1 / n for n in (128, 256, 512, 1024, 2048)) if not quick else tuple(1 / n for n in (128, 256, 512, 1024))
    )
    times, ratios = [], []
    for dt in steps:
        builder = dc.ModelBuilder()
        for t in starts:
            builder.add_world(gravity=(0.0, -G))
            floor(builder, friction=4.0)
            # turned by -t about its lower right corner, which stays at the origin
            centre = reach * np.array([-math.sin(alpha - t), math.cos(alpha - t)])
            box(builder, centre, half_width, half_height, mu=4.0, angle=-t)
        sim = simulation(builder, slop=1e-7)  # gaps below the slop count as closed: it would come down too early
        spin = record(sim, round(1.4 / dt), dt, lambda s: s.state.numpy("angular_velocity")[1::2])
        down = np.argmax(spin, axis=0)
        times.append(rms((down + 1) * dt - exact))
        # the impact takes up to two steps, one that closes the gap and one with it closed; gravity goes on
        after = spin[down + 3, np.arange(len(starts))] + p * p * math.sin(alpha) * 3 * dt
        ratios.append(rms(after / spin.max(axis=0) - (1 - 1.5 * math.sin(alpha) ** 2)))
    yield order_check("the quarter period", steps, times)
    dt = steps[-1]
    # half a step off at the start, up to two at the impact; the spin then grows by p^2 sin(alpha) dt a step
    yield Check(f"quarter period, dt 1/{1 / dt:.0f} [s]", times[-1], 2.5 * dt)
    yield order_check("the restitution of the spin", steps, ratios)
    limit = 2 * p * p * math.sin(alpha) * dt / float(spin.max(axis=0).min())
    yield Check(f"restitution of the spin, dt 1/{1 / dt:.0f}", ratios[-1], limit)


@cases.add
def painleve_rod(quick: bool) -> Iterator[Check]:
    """A rod sliding on its tip where no finite force exists: an impulse stops the tip in one step, whatever dt.

    Uniform rod, half length l, tip at (-l cos, -l sin) of its centre: normal acceleration per N is
    (1 + 3 cos (cos - mu sin)) / m (Painlevé 1895), negative about tan = 2 for mu > 4/3. Then time stepping gives a
    finite impulse that ends the slip (Stewart and Trinkle 1996; Stewart 2000, Rigid-body dynamics with friction and
    impact): W lambda = -u at the tip with W its 2 x 2 inverse mass. At mu < 4/3 the tip slides on under a force.
    """
    theta, half, radius, slip = math.atan(2.0), 1.0, 1e-3, -2.0
    arm = np.array((-half * math.cos(theta), -half * math.sin(theta) - radius))
    inertia = half**2 / 3
    coupling = -arm[0] * arm[1] / inertia
    w = np.array([[1 + arm[0] ** 2 / inertia, coupling], [coupling, 1 + arm[1] ** 2 / inertia]])
    for dtype, acceleration in EXACT:
        for mu in (0.5, 1.3, 1.4, 1.6, 3.0):
            found, steps = [], (1e-2, 1e-3, 1e-4, 1e-5)
            for dt in steps:
                builder = world()
                floor(builder, friction=mu)
                body = builder.add_body((0.0, -arm[1]), velocity=(slip, 0.0), mass=1.0, inertia=inertia)
                end = half * np.array((math.cos(theta), math.sin(theta)))
                builder.add_capsule(body, -end, end, radius, friction=mu)
                sim = simulation(builder, dtype, acceleration, max_sweeps=50_000)
                sim.step(dt)
                impulse, v = sim.contacts.numpy("impulse")[0].astype(float), velocity(sim)[body]
                press = w[0, 0] + mu * w[0, 1]  # normal acceleration per N, the friction pushing to the right
                expected = np.array((1.0, mu)) * G * dt / press
                if press < 0 or slip + w[1] @ expected > 0:  # no such force, or it ends the slip within the step
                    expected = np.linalg.solve(w, (G * dt, -slip))
                where = f"mu {mu}, {dtype} {acceleration}, dt {dt:g}"
                # the two impulses are nearly dependent: the condition number of W
                limit = leftover(dtype, 1, 2.0) * np.linalg.cond(w) / min(abs(press), 1.0)
                yield near(f"{where}: impulse [N s]", impulse, expected, limit, sim)
                yield near(f"{where}: normal speed of the tip [m/s]", v[1] + v[2] * arm[0], 0.0, limit, sim)
                found.append(float(impulse[0]))
            if mu > 4 / 3 and dtype == "float64":
                limit_impulse = np.linalg.solve(w, (0.0, -slip))[0]
                yield order_check(f"the impulse at mu {mu}, {acceleration}", steps, np.array(found) - limit_impulse)
