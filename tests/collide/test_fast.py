"""Fast bodies: what they miss leaves them alone, what they hit they hit where and when they do."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from tests.collide.test_tiles import SHAPES, STATIC

DT = 1 / 60


def diamond(builder, body):
    builder.add_box(body, 0.3, 0.3, angle=math.pi / 4, friction=0.0)


FLYERS = {**{name: SHAPES[name] for name in ("box", "disc", "capsule")}, "diamond": diamond}
TOPS = {"box": 0.4, "disc": 0.4, "capsule": 0.4, "diamond": 0.3 * math.sqrt(2)}
PHASES = (0.03, 0.37, 0.68, 0.97)  # of a step, by which the flight begins earlier


def fly(build, cases, steps, dt=DT, dtype="float64", backend="warp", config=None):
    """A world without gravity for each case, stepped; the simulation, what ``build`` returned, velocities at first."""
    builder, bodies = dc.ModelBuilder(), []
    for case in cases:
        builder.add_world(gravity=(0, 0), length_scale=1.0)
        bodies.append(build(builder, *case))
    sim = dc.Simulation(*builder.finalize(dtype=dtype, backend=backend), config=config)
    before = np.c_[sim.state.numpy("velocity"), sim.state.numpy("angular_velocity")]
    for _ in range(steps):
        sim.step(dt)
    return sim, np.array(bodies), before


def change(sim, before):
    """Of the velocities and spins, the largest of any body."""
    return np.abs(np.c_[sim.state.numpy("velocity"), sim.state.numpy("angular_velocity")] - before).max()


@pytest.mark.parametrize("dt", [1 / 60, 1 / 100])
@pytest.mark.parametrize("speed", [0.2, 7.0, 31.0, 100.0])
def test_bodies_whose_ways_cross_pass_each_other(speed, dt):
    """Of two that fly at right angles one has passed when the other comes, by 1 mm to 0.3 m."""
    config = dc.SolverConfig(continuous=0.0)

    def build(builder, first, second, miss, phase):
        start = 1.5 + (1.5 + phase) * speed * dt
        sides = TOPS[first] + TOPS[second]
        away = math.sqrt(2) * (sides + miss) + sides
        one = builder.add_body((0.0, start + away), velocity=(0.0, -speed))
        two = builder.add_body((-start, 0.0), velocity=(speed, 0.0))
        FLYERS[first](builder, one)
        FLYERS[second](builder, two)
        return one, two

    cases = [(a, b, miss, p) for a in FLYERS for b in FLYERS for miss in (1e-3, 0.1, 0.3) for p in PHASES]
    steps = 8 if speed < 1 else int(6.0 / (speed * dt)) + 4
    for setting in (None, config) if speed > 20 else (config,):
        sim, _, before = fly(build, cases, steps, dt, config=setting)
        assert change(sim, before) < 1e-6 * speed


def test_diamonds_that_pass_by_are_not_deflected():
    """The face that would be reached ends before it is."""

    def build(builder, post, miss, phase, speed):
        body = builder.add_body()
        FLYERS[post](builder, body)
        flyer = builder.add_body(
            (-3.0 - phase * speed * DT, TOPS[post] + TOPS["diamond"] + miss), velocity=(speed, 0.0)
        )
        diamond(builder, flyer)
        return body, flyer

    cases = [(p, miss, ph, v) for p in FLYERS for miss in (1e-3, 0.02, 0.3) for ph in PHASES for v in (31.0, 100.0)]
    sim, _, before = fly(build, cases, 14)
    assert change(sim, before) < 1e-6


def rod_to_disc(x, y, spin, time):
    """Distance of a rod of 1 m x 40 mm, turned by spin * time, at the origin from a point at (x, y) [m]."""
    c, s = np.cos(spin * time), np.sin(spin * time)
    u, v = c * x + s * y, -s * x + c * y
    return np.hypot(np.maximum(np.abs(u) - 0.5, 0), np.maximum(np.abs(v) - 0.02, 0))


def test_what_turns_passes_what_it_misses():
    """Rods that fly and turn by up to 5 rad a step past a disc; they miss it by 1 cm and more."""
    draw, cases, time = np.random.default_rng(1), [], np.linspace(0.0, 0.25, 8001)
    while len(cases) < 60:
        speed, spin = draw.choice([10.0, 31.0, 100.0]), draw.choice([-1, 1]) * draw.uniform(20.0, 300.0)
        angle, off, begin = draw.uniform(0, 6.28), draw.uniform(0.25, 0.8), -1.2 - draw.uniform() * speed * DT
        x, y = begin + speed * time, off
        c, s = math.cos(angle), math.sin(angle)  # seen from the rod, that begins with no angle
        if rod_to_disc(-(c * x + s * y), s * x - c * y, spin, time).min() > 0.2 + 0.01:
            cases.append((speed, spin, angle, off, begin))

    def build(builder, speed, spin, angle, off, begin):
        post = builder.add_body(type=STATIC)
        builder.add_disc(post, 0.2)
        rod = builder.add_body((begin, off), angle=angle, velocity=(speed, 0.0), angular_velocity=spin)
        builder.add_box(rod, 0.5, 0.02)
        return post, rod

    sim, _, before = fly(build, cases, 15, dtype="float32")
    assert change(sim, before) < 1e-4


def only_contact(sim, world):
    """Normal, gap and arms of the one contact of a world."""
    first = int(sim.contacts.numpy("contact_start")[world])
    assert sim.contacts.numpy("contact_count")[world] == 1
    return [sim.contacts.numpy(name)[first] for name in ("normal", "gap", "arm_a", "arm_b")]


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("others", [False, True])
def test_swift_discs_meet_along_the_normal_of_that_time(backend, others):
    """Closed form: |d + w t| = R; elastic discs leave with what they have along that normal exchanged."""
    cases = [(b, p) for b in (0.0, 0.3, 0.6, 0.79) for p in (0.1, 0.5, 0.9)]
    speed = 100.0

    def build(builder, off, phase):
        begin = -math.sqrt(0.64 - off**2) - phase * speed * DT
        one, two = builder.add_body(), builder.add_body((begin, off), velocity=(speed, 0.0))
        for body in (one, two):
            builder.add_disc(body, 0.4, friction=0.0, restitution=1.0)
        if others:  # a world with boxes has a kernel of its own
            builder.add_box(builder.add_body((50.0, 50.0)), 0.5, 0.5)
        return one, two

    sim, bodies, _ = fly(build, cases, 0, backend=backend)
    sim.collide(DT)
    for world, (off, phase) in enumerate(cases):
        n = np.array([-math.sqrt(0.64 - off**2), off]) / 0.8
        normal, gap, arm_a, arm_b = only_contact(sim, world)
        np.testing.assert_allclose(normal, n, atol=1e-9)
        assert gap == pytest.approx(-n[0] * speed * DT * phase, abs=1e-9)
        np.testing.assert_allclose([arm_a, arm_b], [0.4 * n, -0.4 * n], atol=1e-9)
    sim.solve()
    sim.advance()
    for (off, _), (one, two) in zip(cases, bodies, strict=True):
        n = np.array([-math.sqrt(0.64 - off**2), off]) / 0.8
        taken = n * (n[0] * speed)
        np.testing.assert_allclose(sim.state.numpy("velocity")[one], taken, atol=1e-6)
        np.testing.assert_allclose(sim.state.numpy("velocity")[two], (speed - taken[0], -taken[1]), atol=1e-6)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("first", ["rod", "disc"])
def test_a_rod_that_turns_meets_a_disc_along_its_face_of_that_time(first, backend):
    """Closed form: its centre line comes to half a width and a radius from the disc's centre."""
    width, radius = 0.02, 0.05
    cases = [(r, phi) for r in (0.2, 0.35, 0.45) for phi in (0.7, 1.2, 2.0)]
    spin = 2.2 / DT

    def build(builder, r, phi):
        def rod():
            builder.add_box(builder.add_body(angular_velocity=spin, mass=1.0), 0.5, width)

        def disc():
            builder.add_disc(builder.add_body((r * math.cos(phi), r * math.sin(phi)), mass=1e3), radius)

        for add in (rod, disc) if first == "rod" else (disc, rod):
            add()
        return (0,)

    sim, _, _ = fly(build, cases, 0, backend=backend)
    sim.collide(DT)
    for world, (r, phi) in enumerate(cases):
        angle = phi - math.asin((width + radius) / r)
        normal, gap, arm_a, arm_b = only_contact(sim, world)
        sign = 1 if first == "rod" else -1
        np.testing.assert_allclose(sign * normal, (-math.sin(angle), math.cos(angle)), atol=5e-3)
        along = math.sqrt(r**2 - (width + radius) ** 2)
        closed = spin * along * angle / spin  # what the point's speed covers until then
        assert gap == pytest.approx(closed, abs=2e-3)
        on_rod, on_disc = (arm_a, arm_b) if first == "rod" else (arm_b, arm_a)
        np.testing.assert_allclose(on_disc, -radius * sign * normal, atol=1e-3)
        assert np.linalg.norm(on_rod) == pytest.approx(math.hypot(along, width), abs=2e-3)


def at_random(pairs):
    """Two shapes a world, fast and turning."""
    draw = np.random.default_rng(3)

    def build(builder, one, two):
        ids = []
        for add, at in ((one, (0.0, 0.0)), (two, (1.6, 0.0))):
            place = np.array(at) + draw.uniform(-0.2, 0.2, 2)
            toward = (1 if at[0] == 0 else -1) * draw.uniform(0.0, 40.0)
            ids.append(
                builder.add_body(
                    place,
                    angle=draw.uniform(0, 6),
                    velocity=(toward, draw.uniform(-20, 20)),
                    angular_velocity=draw.choice([0.0, draw.uniform(-200, 200)]),
                )
            )
            FLYERS[add](builder, ids[-1])
        return ids

    return build, [(a, b) for a in FLYERS for b in FLYERS for _ in range(pairs)]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_oracle_follows_alike(dtype):
    found = []
    for backend in ("warp", "numpy"):
        build, cases = at_random(12)
        sim, _, _ = fly(build, cases, 0, dtype=dtype, backend=backend)
        sim.collide(DT)
        first, count = sim.contacts.numpy("contact_start"), sim.contacts.numpy("contact_count")
        used = np.concatenate([np.arange(i, i + n) for i, n in zip(first, count, strict=False)])
        found.append({name: sim.contacts.numpy(name)[used] for name in ("key", "normal", "gap", "arm_a", "arm_b")})
    assert len(found[0]["key"]) > 50
    np.testing.assert_array_equal(found[0]["key"], found[1]["key"])
    for name in ("normal", "gap", "arm_a", "arm_b"):
        np.testing.assert_allclose(found[0][name], found[1][name], atol=1e-8 if dtype == "float64" else 1e-3)


def test_bullets_that_meet_head_on_exchange_their_speeds():
    def build(builder, speed, phase):
        ids = []
        for side in (-1, 1):
            body = builder.add_body((side * (1.0 + phase * speed * DT), 0.0), velocity=(-side * speed, 0.0))
            builder.add_disc(body, 0.03, friction=0.0, restitution=1.0)
            ids.append(body)
        return ids

    cases = [(v, p) for v in (30.0, 300.0, 1000.0) for p in PHASES]
    sim, bodies, before = fly(build, cases, 8)
    np.testing.assert_allclose(
        sim.state.numpy("velocity")[bodies[:, 0]], before[bodies[:, 1], :2], rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("wall", ["box", "chain"])
def test_nothing_that_does_not_turn_passes_a_thin_wall(wall):
    """20 mm, or nothing at all, at up to 1000 m/s and from up to 60 degrees."""

    def build(builder, shape, speed, phase, tilt):
        post = builder.add_body(type=STATIC)
        if wall == "box":
            builder.add_box(post, 0.01, 500.0)
        else:
            builder.add_chain(post, [(0.0, -500.0), (0.0, 500.0)])
        velocity = (speed * math.cos(tilt), speed * math.sin(tilt))
        body = builder.add_body((-0.6 - phase * speed * DT, 0.0), velocity=velocity, fixed_rotation=True)
        FLYERS[shape](builder, body)
        return post, body

    cases = [(s, v, p, t) for s in FLYERS for v in (30.0, 300.0, 1000.0) for p in PHASES for t in (-1.0, 0.0, 0.4)]
    sim, bodies, _ = fly(build, cases, 0, dtype="float32")
    for _ in range(6):
        sim.step(DT)
        assert sim.state.numpy("position")[bodies[:, 1], 0].max() < 0.0
