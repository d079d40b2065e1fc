"""Chains of bodies that move: the ground of a moving frame, bowls that fall, joints that nothing catches on."""

import numpy as np
import pytest

import dc_kernels as dc
from tests.parity.test_parity import assert_close

DT = 0.01
G = 9.8
HILLS = np.array([(5, 1.0), (4, 0.2), (3, 0.0), (2, 0.3), (1, 0.0), (0, 0), (-1, 0), (-2, 0.4), (-3, 0.0), (-5, 1.2)])


def load(builder, at=(0.0, 0.0), velocity=(0.0, 0.0)):
    """Shapes of all kinds above the hills, all of which move by a velocity more."""
    draw = np.random.default_rng(1)
    for i in range(9):
        place = np.array([0.9 * i - 3.6, 1.3 + 0.2 * (i % 3)]) + at
        body = builder.add_body(place, draw.uniform(-3, 3), draw.normal(0, 1, 2) + velocity, draw.normal())
        if i % 3 == 0:
            builder.add_disc(body, 0.25, friction=0.3)
        elif i % 3 == 1:
            builder.add_box(body, 0.3, 0.2, friction=0.4)
        else:
            builder.add_capsule(body, (-0.2, 0.0), (0.2, 0.1), 0.15, restitution=0.3)


def hills(kind, velocity=(0.0, 0.0), first=True, backend="warp", steps=250, **options):
    """The load on hills that belong to a static or kinematic body, made before or after what lies on them."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G), length_scale=0.5)
    if not first:
        load(builder, velocity=velocity)
    ground = builder.add_body(velocity=velocity, type=kind)
    builder.add_chain(ground, HILLS, friction=0.5)
    if first:
        load(builder, velocity=velocity)
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), **options)
    sim.run(steps, DT)
    moving = np.flatnonzero(sim.model.numpy("inv_mass"))
    frame = sim.state.numpy("position")[ground] - sim.model.numpy("center_of_mass")[ground]
    return sim, sim.state.numpy("position")[moving] - frame


@pytest.mark.parametrize("first", [True, False])
def test_a_moving_chain_is_the_ground_of_its_frame(first):
    """A ground that moves evenly gives what one at rest gives, to what round-off grows to, whichever is the first."""
    _, still = hills(dc.BodyType.STATIC, steps=120)
    sim, moved = hills(dc.BodyType.KINEMATIC, (1.7, 0.4), first, steps=120)
    np.testing.assert_allclose(moved, still, atol=1e-5)  # solved to a tolerance
    assert sim.state.numpy("position")[0 if first else -1] == pytest.approx([1.7 * 1.2, 0.4 * 1.2])


def test_what_slides_over_joints_of_a_moving_chain_is_not_caught():
    """Without friction and at any order of the bodies: the box keeps its height and its speed."""
    for kind in (dc.BodyType.KINEMATIC, dc.BodyType.DYNAMIC):
        for first in (True, False):
            builder = dc.ModelBuilder()
            builder.add_world(gravity=(0.0, 0.0), length_scale=0.5)

            def add_box(builder=builder):
                box = builder.add_body((-3.5, 0.2), velocity=(4.0, -0.5), fixed_rotation=True)
                builder.add_box(box, 0.3, 0.2, friction=0.0)
                return box

            box = None if first else add_box()
            ground = builder.add_body(type=kind, mass=1e9, inertia=1e9)
            chain = np.stack([np.linspace(4, -4, 81), np.zeros(81)], axis=1)
            builder.add_chain(ground, chain, friction=0.0)
            box = add_box() if first else box
            sim = dc.Simulation(*builder.finalize("float64"))
            for _ in range(150):
                sim.step(DT)
                assert sim.state.numpy("velocity")[box] == pytest.approx([4.0, 0.0], abs=1e-6)
            assert sim.state.numpy("angle")[box] == 0.0


def bowl_of(kind, **body):
    """A half circle of radius 1 that is open above, as a chain of the body."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G))
    turn = np.linspace(0, -np.pi, 17)
    bowl = builder.add_body(type=kind, **body)
    builder.add_chain(bowl, np.stack([np.cos(turn), np.sin(turn)], axis=1), friction=0.6)
    return builder, bowl


def test_the_mass_of_a_chain_lies_along_it():
    """Centre and moment of inertia of a half ring: 2 r / pi below its axis, m r^2 about that."""
    builder, bowl = bowl_of(dc.BodyType.DYNAMIC, mass=3.0)
    rod = builder.add_body((9.0, 0.0), mass=2.0)
    builder.add_chain(rod, [(0.0, 0.0), (3.0, 0.0)])
    disc = builder.add_body((20.0, 0.0))
    builder.add_disc(disc, 0.5)
    builder.add_chain(disc, [(0.0, 0.0), (3.0, 0.0)])  # which weighs nothing beside a disc
    model = builder.finalize("float64")[0]
    centre = -2.0 / np.pi
    assert model.numpy("center_of_mass")[[bowl, rod, disc]] == pytest.approx(
        np.array([(0.0, centre), (1.5, 0.0), (0.0, 0.0)]), abs=5e-3
    )
    inertia = [3.0 * (1.0 - centre**2), 2.0 * 3.0**2 / 12.0, np.pi / 4 * 0.5**2 / 2]
    assert model.numpy("inertia")[[bowl, rod, disc]] == pytest.approx(inertia, rel=2e-2)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_bowl_that_falls_and_what_falls_into_it(backend):
    """A chain of a dynamic body lands on a floor and holds a disc and a box; their contacts bear the weights."""
    builder, bowl = bowl_of(dc.BodyType.DYNAMIC, position=(0.0, 1.2), mass=3.0)
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
    disc, box = builder.add_body((0.2, 2.0)), builder.add_body((-0.1, 2.6), 0.3)
    builder.add_disc(disc, 0.3)
    builder.add_box(box, 0.2, 0.15)
    sim = dc.Simulation(*builder.finalize("float64", backend=backend))
    sim.run(400 if backend == "warp" else 60, DT)
    if backend == "numpy":
        other = dc.Simulation(*builder.finalize("float64"))
        other.run(60, DT)
        np.testing.assert_allclose(sim.state.numpy("position"), other.state.numpy("position"), atol=1e-8)
        return
    assert abs(sim.state.numpy("velocity")).max() < 0.05
    force = dc.net_contact_forces(sim).force
    weight = sim.model.numpy("mass") * G
    assert force[floor, 1] == pytest.approx(-weight.sum(), rel=0.05)
    assert force[[disc, box], 1] == pytest.approx(weight[[disc, box]], rel=0.1)
    place = sim.state.numpy("position")
    assert np.hypot(*(place[disc] - place[bowl])).max() < 1.0 and place[box, 1] > 0.0


def test_momentum_is_kept_where_a_chain_is_hit():
    """Without gravity: linear and angular momentum of a free bowl and of balls that fly into it."""
    builder, bowl = bowl_of(dc.BodyType.DYNAMIC, mass=2.0, angular_velocity=1.0)
    builder._worlds[-1] = builder._worlds[-1]._replace(gravity=(0.0, 0.0))
    builder.add_discs([(0.3, 1.0), (-0.5, 1.6), (0.0, 2.2)], 0.15, velocity=(0.0, -3.0), restitution=0.5)
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(position_correction="none"))
    before = dc_momentum(sim)
    sim.run(150, DT)
    np.testing.assert_allclose(dc_momentum(sim), before, atol=2e-2)
    assert abs(sim.state.numpy("velocity")[bowl, 1]) > 0.2  # it was hit


def dc_momentum(sim):
    """Linear and angular momentum of all bodies."""
    mass, spin = sim.model.numpy("mass"), sim.state.numpy("angular_velocity")
    place, velocity = sim.state.numpy("position"), sim.state.numpy("velocity")
    turning = mass * (place[:, 0] * velocity[:, 1] - place[:, 1] * velocity[:, 0]) + sim.model.numpy("inertia") * spin
    return np.array([*(mass[:, None] * velocity).sum(axis=0), turning.sum()])


@pytest.mark.parametrize("first", [True, False])
def test_the_oracle_agrees_on_moving_chains(first):
    found = [hills(dc.BodyType.KINEMATIC, (0.5, 0.3), first, backend, 75) for backend in ("warp", "numpy")]
    for name in ("key", "gap", "normal", "impulse"):
        one, two = (sim.contacts.numpy(name)[: sim.contacts.numpy("contact_count")[0]] for sim, _ in found)
        assert len(one) > 6
        assert_close(name, two, one, 1e-8)
    assert_close("position", found[1][1], found[0][1], 1e-9)


def test_segments_do_not_meet_segments_and_a_body_may_begin_to_move():
    builder, bowl = bowl_of(dc.BodyType.DYNAMIC, position=(0.0, 0.5), mass=1.0)
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(5.0, 0.0), (-5.0, 0.0)])
    ball = builder.add_discs([(3.0, 0.3)], 0.3)[0]
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.run(50, DT)
    assert sim.state.numpy("velocity")[bowl, 1] == pytest.approx(-G * 0.5)
    types = sim.model.numpy("body_type").copy()
    types[ground] = dc.BodyType.KINEMATIC
    sim.change_model(body_type=types)
    sim.state.numpy("velocity")[ground] = (0.0, 1.0)
    sim.run(50, DT)
    assert sim.state.numpy("position")[[ground, ball], 1] == pytest.approx([0.5, 0.8], abs=2e-3)
    assert sim.state.numpy("velocity")[ball, 1] == pytest.approx(1.0, abs=1e-3)
