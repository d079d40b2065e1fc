"""Fast bodies: what they miss leaves them alone, and they pass through nothing."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from bench.faults.tiles import SHAPES
from dc_kernels.model.config import check_awake

STATIC = dc.BodyType.STATIC
DT = 1 / 60
ON = dc.SolverConfig(continuous=True)
PHASES = (0.03, 0.37, 0.68, 0.97)  # of a step, by which a flight begins earlier


def diamond(builder, body):
    builder.add_box(body, 0.3, 0.3, angle=math.pi / 4, friction=0.0)


def rod(builder, body):
    builder.add_box(body, 0.5, 0.02)


def triangle(builder, body):
    builder.add_polygon(body, 0.4 * np.array([(1.0, 0.0), (-0.5, 0.866), (-0.5, -0.866)]))


FLYERS = {**{name: SHAPES[name] for name in ("box", "disc", "capsule")}, "diamond": diamond}
TOPS = {"box": 0.4, "disc": 0.4, "capsule": 0.4, "diamond": 0.3 * math.sqrt(2)}
SHOTS = {**FLYERS, "rod": rod, "triangle": triangle, "bullet": lambda builder, body: builder.add_disc(body, 0.02)}


def fly(build, cases, config=ON, backend="warp", threads=1):
    """A world without gravity for each case; the simulation, what ``build`` returned, motions at first."""
    builder, bodies = dc.ModelBuilder(), []
    for case in cases:
        builder.add_world(gravity=(0, 0), length_scale=1.0)
        bodies.append(build(builder, *case))
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config, threads=threads)
    return sim, np.array(bodies), motions(sim)


def motions(sim):
    """Velocity and spin of all bodies, (n, 3)."""
    return np.c_[sim.state.numpy("velocity"), sim.state.numpy("angular_velocity")]


def deflected(build, cases, steps, config):
    """Worlds in which a velocity or a spin has changed."""
    sim, _, before = fly(build, cases, config)
    sim.run(steps, DT)
    changed = np.abs(motions(sim) - before).max(axis=1) > 1e-9
    return int(np.logical_or.reduceat(changed, sim.model.numpy("body_start")[:-1]).sum())


def to_rod(x, y, spin, time):
    """Distance of a rod of 1 m x 40 mm at the origin, turned by spin * time, from a point at (x, y) [m]."""
    c, s = np.cos(spin * time), np.sin(spin * time)
    u, v = c * x + s * y, -s * x + c * y
    return np.hypot(np.maximum(np.abs(u) - 0.5, 0), np.maximum(np.abs(v) - 0.02, 0))


@pytest.mark.parametrize("post", ["disc", "box"])
def test_rods_that_turn_pass_what_they_miss(post):
    """By a millimetre and more, at 10 to 100 m/s and up to 5 rad a step."""
    draw, cases, time = np.random.default_rng(1), [], np.linspace(0.0, 0.25, 4001)
    while len(cases) < 60:
        speed, spin = draw.choice([10.0, 31.0, 100.0]), draw.choice([-1, 1]) * draw.uniform(20.0, 300.0)
        angle, off, begin = draw.uniform(0, 6.28), draw.uniform(0.25, 0.8), -1.2 - draw.uniform() * speed * DT
        x, y = begin + speed * time, off
        c, s = math.cos(angle), math.sin(angle)  # seen from the rod, that begins with no angle
        if to_rod(-(c * x + s * y), s * x - c * y, spin, time).min() > 0.2 + 0.001:
            cases.append((speed, spin, angle, off, begin))

    def build(builder, speed, spin, angle, off, begin):
        body = builder.add_body(type=STATIC)
        if post == "disc":
            builder.add_disc(body, 0.2)
        else:
            builder.add_box(body, 0.14, 0.14)
        flyer = builder.add_body((begin, off), angle=angle, velocity=(speed, 0.0), angular_velocity=spin)
        rod(builder, flyer)
        return body, flyer

    assert deflected(build, cases, 15, None) > 5  # it can fail
    assert deflected(build, cases, 15, ON) == 0


def test_what_flies_by_is_not_deflected():
    """A post at rest, or a body whose way is crossed: by a millimetre to 0.3 m, at 7 to 100 m/s."""

    def build(builder, first, second, miss, phase, speed, crossing):
        sides = TOPS[first] + TOPS[second]
        if crossing:
            start = 1.5 + (1.5 + phase) * speed * DT
            away = math.sqrt(2) * (sides + miss) + sides
            one = builder.add_body((0.0, start + away), velocity=(0.0, -speed))
            two = builder.add_body((-start, 0.0), velocity=(speed, 0.0))
        else:
            one = builder.add_body(type=STATIC)
            two = builder.add_body((-3.0 - phase * speed * DT, sides + miss), velocity=(speed, 0.0))
        FLYERS[first](builder, one)
        FLYERS[second](builder, two)
        return one, two

    cases = [
        (a, b, miss, phase, speed, crossing)
        for a in FLYERS
        for b in FLYERS
        for miss in (1e-3, 0.1, 0.3)
        for phase in PHASES[:3]
        for speed in (7.0, 31.0, 100.0)
        for crossing in (False, True)
    ]
    assert deflected(build, cases, 40, None) > 5
    assert deflected(build, cases, 40, ON) == 0


def passed(sim, bodies, steps):
    """Worlds in which a body has come to the other side of x = 0 in some step."""
    through = np.zeros(len(bodies), bool)
    for _ in range(steps):
        sim.step(DT)
        through |= (sim.state.numpy("position")[bodies][..., 0] > 0).any(axis=1)
    return int(through.sum())


def add_wall(builder, kind):
    """20 mm at x = 0, or nothing at all."""
    body = builder.add_body(type=STATIC)
    if kind == "box":
        builder.add_box(body, 0.01, 500.0)
    else:
        builder.add_chain(body, [(0.0, -500.0), (0.0, 0.0), (0.0, 500.0)])


def shots(spread):
    """Shapes at 10 to 1000 m/s at a thin wall, of which half turn by up to 5 rad a step."""
    draw = np.random.default_rng(5)

    def build(builder, shape, speed, tilt, kind, phase, spin, angle):
        add_wall(builder, kind)
        velocity = (speed * math.cos(tilt), speed * math.sin(tilt))
        body = builder.add_body((-0.7 - phase * speed * DT, 0.0), angle, velocity, spin)
        SHOTS[shape](builder, body)
        return (body,)

    return build, [
        (shape, speed, tilt, kind, draw.uniform(), draw.choice([0.0, draw.uniform(-300, 300)]), draw.uniform(0, 6))
        for shape in SHOTS
        for speed in (10.0, 100.0, 1000.0)
        for tilt in (-1.0, 0.0, 0.4)
        for kind in ("box", "chain")
        for _ in range(spread)
    ]


def test_nothing_passes_a_thin_wall():
    build, cases = shots(3)
    sim, bodies, _ = fly(build, cases, None)
    assert passed(sim, bodies, 25) > 0
    sim, bodies, _ = fly(build, cases)
    assert passed(sim, bodies, 25) == 0


def test_what_an_impact_sets_in_motion_passes_no_wall():
    """A body of up to 0.5 m before the wall is hit at 30 to 1000 m/s."""

    def build(builder, speed, phase, away, kind, shape):
        add_wall(builder, kind)
        hit = builder.add_body((-away - 0.45, 0.0))
        bullet = builder.add_body((-away - 1.5 - phase * speed * DT, 0.02), velocity=(speed, 0.0))
        for body in (hit, bullet):
            FLYERS[shape](builder, body)
        return hit, bullet

    cases = [
        (speed, phase, away, kind, shape)
        for speed in (30.0, 100.0, 1000.0)
        for phase in PHASES[:2]
        for away in (0.001, 0.2, 0.5)
        for kind in ("box", "chain")
        for shape in FLYERS
    ]
    sim, bodies, _ = fly(build, cases, None)
    assert passed(sim, bodies, 30) > 0
    sim, bodies, _ = fly(build, cases)
    assert passed(sim, bodies, 30) == 0


@pytest.mark.parametrize("kinematic", [False, True])
def test_bullets_pass_no_thin_body_that_moves(kinematic):
    """A plate of 20 mm is hit at 30 to 1000 m/s by what turns.

    A dynamic one comes or goes at up to 20 m/s, and turns; a kinematic one goes by less than half of itself a step.
    """
    draw, cases = np.random.default_rng(3), []
    for i in range(80):
        speed = draw.choice([30.0, 100.0, 300.0, 1000.0])
        flyer = ((-3.0 - draw.uniform() * speed * DT, draw.uniform(-0.5, 0.5)), draw.uniform(-200, 200))
        plate = (draw.uniform(-0.6, 0.6), 0.0) if kinematic else (draw.uniform(-20, 20), draw.uniform(-3, 3))
        cases.append((speed, *flyer, *plate, i % 2))

    def build(builder, speed, at, spin, drift, turn, disc):
        options = {"type": dc.BodyType.KINEMATIC} if kinematic else {"mass": 1000.0}
        plate = builder.add_body(velocity=(drift, 0.0), angular_velocity=turn, **options)
        builder.add_box(plate, 0.01, 200.0)
        bullet = builder.add_body(at, velocity=(speed, 0.0), angular_velocity=spin)
        if disc:
            builder.add_disc(bullet, 0.03)
        else:
            builder.add_box(bullet, 0.2, 0.02)
        return plate, bullet

    sim, bodies, _ = fly(build, cases)
    for _ in range(25):
        sim.step(DT)
        place, angle = sim.state.numpy("position")[bodies], sim.state.numpy("angle")[bodies[:, 0]]
        beyond = place[:, 1] - place[:, 0]
        assert (np.cos(angle) * beyond[:, 0] + np.sin(angle) * beyond[:, 1]).max() < 0


def crowd(shape, restitution, count=60):
    """Shapes that fly among each other at 30 m/s."""
    draw = np.random.default_rng(1)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    for i in range(count):
        spin = draw.normal() * 30.0 * (shape != "disc")
        place = (1.2 * (i % 8), 1.2 * (i // 8))
        body = builder.add_body(place, draw.uniform(0, 6), draw.normal(size=2) * 30.0, spin)
        if shape == "disc":
            builder.add_disc(body, 0.4, friction=0.0, restitution=restitution)
        else:
            builder.add_box(body, 0.5, 0.02, friction=0.5 * (1 - restitution), restitution=restitution)
    return builder


def invariants(sim):
    """Momentum, angular momentum about the origin, kinetic energy."""
    mass, inertia = (1 / sim.model.numpy(name) for name in ("inv_mass", "inv_inertia"))
    x, (v, w) = sim.state.numpy("position"), np.split(motions(sim), [2], axis=1)
    turning = mass * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]) + inertia * w[:, 0]
    energy = 0.5 * (mass * (v**2).sum(axis=1) + inertia * w[:, 0] ** 2)
    return np.array([*(mass[:, None] * v).sum(axis=0), turning.sum(), energy.sum()])


@pytest.mark.parametrize(("shape", "restitution"), [("disc", 1.0), ("rod", 0.0), ("rod", 1.0)])
def test_momentum_is_kept_to_rounding(shape, restitution):
    """What is stopped short goes along its velocity; what is let go by takes no impulse."""
    config = dc.SolverConfig(continuous=True, position_correction="none")
    sim = dc.Simulation(*crowd(shape, restitution).finalize("float64"), config=config)
    before = invariants(sim)
    for _ in range(40):
        sim.step(DT)
        now = invariants(sim)
        np.testing.assert_allclose(now[:3], before[:3], atol=1e-9)
        assert now[3] <= before[3] * 1.005


def test_what_joints_hold_is_stopped_together():
    """Five capsules in a row fly at a wall: none passes, and their hinges come no farther apart than without."""

    def build(builder, speed, angle, phase):
        add_wall(builder, "box")
        row = []
        for k in range(5):
            place = (-4.0 - phase * speed * DT - 0.5 * k * math.cos(angle), -0.5 * k * math.sin(angle))
            row.append(builder.add_body(place, angle, (speed, 0.0)))
            builder.add_capsule(row[-1], (-0.2, 0.0), (0.2, 0.0), 0.04)
            if k:
                builder.add_revolute_joint(row[-2], row[-1], (-0.25, 0.0))
        return row

    def apart(config):
        """How far the hinges come apart, at most and at the end; the farthest that a body comes."""
        speeds = (30.0, 100.0, 300.0)
        cases = [(speed, angle, phase) for speed in speeds for angle in (0.0, 0.4, 1.2) for phase in PHASES]
        sim, bodies, _ = fly(build, cases, config)
        widest, farthest = 0.0, -math.inf
        for _ in range(60):  # one of them is kept apart for 30, as the links on both sides are stopped in turn
            sim.step(DT)
            place, angle = sim.state.numpy("position")[bodies], sim.state.numpy("angle")[bodies]
            arm = 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            gap = np.linalg.norm(place[:, :-1] - arm[:, :-1] - place[:, 1:] - arm[:, 1:], axis=-1).max()
            widest, farthest = max(widest, gap), max(farthest, place[..., 0].max())
        return widest, gap, farthest

    without, now = apart(None), apart(ON)
    assert now[0] < without[0]
    assert now[1] < 0.1
    assert now[2] < 0 < without[2]


def test_one_way_shapes_let_through_what_they_did():
    def build(builder, speed):
        shelf = builder.add_body(type=STATIC)
        builder.add_box(shelf, 0.01, 5.0, one_way=(-1.0, 0.0))
        body = builder.add_body((3.0, 0.0), velocity=(-speed, 0.0))
        builder.add_disc(body, 0.2)
        return (body,)

    cases = [(speed,) for speed in (10.0, 30.0, 300.0)]
    sim, bodies, before = fly(build, cases)
    sim.run(60, DT)
    assert sim.state.numpy("position")[bodies[:, 0], 0] == pytest.approx(3.0 + before[bodies[:, 0], 0])
    sim.state.numpy("velocity")[bodies[:, 0]] *= -1  # and what comes from the other side it holds
    sim.run(70, DT)
    assert (sim.state.numpy("position")[bodies[:, 0], 0] < 0).all()


def test_the_oracle_agrees():
    build, cases = shots(1)
    cases = cases[::6]
    sims = [fly(build, cases, backend=backend)[0] for backend in ("warp", "numpy")]
    chosen = crowd("rod", 0.0, 16)
    sims += [dc.Simulation(*chosen.finalize("float64", backend=backend), config=ON) for backend in ("warp", "numpy")]
    for one, two in (sims[:2], sims[2:]):
        for _ in range(2):
            for sim in (one, two):
                sim.step(DT)
            np.testing.assert_array_equal(one.contacts.numpy("contact_count"), two.contacts.numpy("contact_count"))
            np.testing.assert_allclose(one.motion.numpy("displacement"), two.motion.numpy("displacement"), atol=1e-7)
            np.testing.assert_array_equal(one.motion.numpy("solved")[:, 3], one.motion.numpy("predicted")[:, 3])


def test_bits_depend_on_nothing_else(tmp_path):
    """Threads, other worlds, a snapshot; where nothing is fast they are those without."""
    build, cases = shots(1)
    sim, bodies, _ = fly(build, cases)
    sim.run(3, DT)
    sim.save(tmp_path / "fast.h5")
    sim.run(5, DT)
    want = sim.state.numpy("position").tobytes()
    shared, _, _ = fly(build, cases, threads=2)
    shared.run(8, DT)
    loaded = dc.Simulation.load(tmp_path / "fast.h5")
    assert loaded.config.continuous
    loaded.run(5, DT)
    assert shared.state.numpy("position").tobytes() == loaded.state.numpy("position").tobytes() == want
    alone, own, _ = fly(build, cases[7:8])
    alone.run(8, DT)
    assert (alone.state.numpy("position")[own[0]] == sim.state.numpy("position")[bodies[7]]).all()

    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=STATIC), 5.0, 0.5, center=(0.0, -0.5))
    for i in range(5):
        builder.add_box(builder.add_body((0.0, 0.5 + i)), 0.5, 0.5)
    stacks = [dc.Simulation(*builder.finalize("float64"), config=config) for config in (None, ON)]
    for stack in stacks:
        stack.run(30, DT)
    assert stacks[0].state.numpy("position").tobytes() == stacks[1].state.numpy("position").tobytes()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_is_switched_off_is_passed_and_nothing_else(backend):
    """A disc at 1.7 m a step, a wall whose contacts are off, and one behind it that holds; the walls come last."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    disc = builder.add_body((-3.0, 0.0), velocity=(100.0, 0.0))
    builder.add_disc(disc, 0.1)
    walls = [builder.add_body((x, 0.0), type=STATIC) for x in (0.0, 3.0)]
    for wall in walls:
        builder.add_box(wall, 0.01, 5.0)
    config = dc.SolverConfig(continuous=True, contact_switches=True)
    for off, low, high in ((False, -0.2, 0.0), (True, 2.8, 3.0)):
        sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config)
        for _ in range(8):
            sim.collide(DT)
            slots, _ = dc.contact_slots(sim.contacts)
            ends = [sim.contacts.numpy(name)[slots] for name in ("body_a", "body_b")]
            sim.change_contacts(enabled=(not off) | ((ends[0] != walls[0]) & (ends[1] != walls[0])))
            sim.solve()
            sim.advance()
        assert low < sim.state.numpy("position")[disc, 0] < high


def test_what_it_does_not_go_with_is_refused():
    builder = dc.ModelBuilder()
    builder.add_world()
    with pytest.raises(ValueError, match="continuous is True"):
        check_awake(ON)
    pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)
    with pytest.raises(ValueError, match="continuous detection"):
        dc.Simulation(*builder.finalize(backend="taichi"), config=ON)
