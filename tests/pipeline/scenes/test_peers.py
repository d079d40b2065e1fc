"""Our worlds in pymunk and Box2D: what stands there, what moves as here, and what these engines cannot hold."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

import dc_kernels as dc
from pipeline import scenes

ENGINES = {"pymunk": scenes.to_pymunk, "Box2D": scenes.to_box2d}


@pytest.fixture(params=ENGINES)
def engine(request):
    """The name of an engine that is installed."""
    pytest.importorskip(request.param)
    return request.param


def step(engine, space, dt, steps):
    for _ in range(steps):
        if engine == "pymunk":
            space.step(dt)
        else:
            space.Step(dt, 10, 10)


def spin(engine, body):
    return body.angular_velocity if engine == "pymunk" else body.angularVelocity


def motion(engine, body):
    """Position and velocity."""
    velocity = body.velocity if engine == "pymunk" else body.linearVelocity
    return tuple(body.position), tuple(velocity)


def builder_with(**material):
    """A static floor and a disc of 0.5 m in the second of two worlds."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_world(gravity=(0.0, -10.0))
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, [(-5.0, 0.0), (5.0, 0.0)], friction=material.get("friction", 0.5))
    builder.add_disc(builder.add_body((0.0, 0.5), velocity=(2.0, 0.0)), 0.5, **material)
    return builder


def test_nothing_of_the_engines_is_imported_before_a_call():
    code = "import sys, pipeline.scenes; assert not {'pymunk', 'Box2D'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_disc_slides_as_coulomb_says(engine):
    """A disc that slides without rolling loses mu g t of its speed until it rolls, with 2/3 of it."""
    space, (_, disc) = ENGINES[engine](builder_with(friction=0.2), 1)
    step(engine, space, 0.001, 200)
    assert motion(engine, disc)[1][0] == pytest.approx(2.0 - 0.2 * 10.0 * 0.2, abs=0.02)
    assert spin(engine, disc) == pytest.approx(-0.2 * 10.0 * 0.2 / (0.5 * 0.5), rel=0.05)
    step(engine, space, 0.001, 400)
    assert motion(engine, disc)[1][0] == pytest.approx(2.0 * 2.0 / 3.0, abs=0.02)


def test_bodies_have_masses_filters_and_their_motion(engine):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    moved = builder.add_body((3.0, 0.0), type=dc.BodyType.KINEMATIC, velocity=(0.0, 1.0))
    builder.add_box(moved, 0.2, 0.2)
    thin = builder.add_body((0.0, 0.0), angle=0.3, velocity=(1.0, 0.0), angular_velocity=2.0)
    builder.add_capsule(thin, (-0.3, 0.0), (0.3, 0.0), 0.1, density=2.0, category=4, mask=0)
    rod = builder.add_body((0.0, 2.0))
    builder.add_disc(rod, 0.1)
    builder.add_distance_joint(moved, rod, (0.0, 0.0), (0.0, 0.0), length=math.hypot(3.0, 2.0))
    sim = dc.Simulation(*builder.finalize("float64"))
    space, bodies = ENGINES[engine](sim)
    for b in (1, 2):
        mass, inertia = (float(sim.model.numpy(name)[b]) for name in ("mass", "inertia"))
        found = (bodies[b].mass, bodies[b].moment) if engine == "pymunk" else (bodies[b].mass, bodies[b].inertia)
        assert found == pytest.approx((mass, inertia), rel=1e-5)
    step(engine, space, 0.01, 100)
    sim.run(100, 0.01)
    places = np.array([motion(engine, body)[0] for body in bodies])
    np.testing.assert_allclose(places, sim.state.numpy("position"), atol=0.03)
    assert bodies[1].angle == pytest.approx(0.3 + 2.0, abs=1e-4)
    again = ENGINES[engine](sim)  # as the simulation now stands
    np.testing.assert_allclose(motion(engine, again.bodies[1])[0], (1.0, 0.0), atol=1e-5)


def test_a_scene_is_built_from_its_seed(engine):
    for seed in (3, 4):
        _, state, _ = scenes.Thesis(bodies=5).build(2, seed).finalize("float64")
        _, bodies = ENGINES[engine](scenes.Thesis(bodies=5), 1, seed=seed)
        places = np.array([motion(engine, body)[0] for body in bodies])
        np.testing.assert_allclose(places, state.numpy("position")[6:], atol=1e-5)


def test_a_ball_bounces_to_its_height_times_e_squared():
    """Box2D takes the larger coefficient of a pair, as we do."""
    pytest.importorskip("Box2D")
    builder = builder_with(restitution=0.5)
    state = builder.finalize("float64")
    state[1].numpy("position")[1] = 0.0, 3.0
    state[1].numpy("velocity")[1] = 0.0
    space, (_, ball) = scenes.to_box2d(state, 1)
    heights = []
    for _ in range(1100):
        step("Box2D", space, 0.001, 1)
        heights.append(ball.position[1] - 0.5)
    landed = int(np.argmin(heights))
    assert max(heights[landed:]) == pytest.approx(2.5 * 0.25, abs=0.02)


def test_what_an_engine_cannot_hold_is_named(engine):
    to = ENGINES[engine]
    model, state, joints = builder_with().finalize("float64")
    state.numpy("force")[1] = 1.0
    with pytest.raises(ValueError, match=r"force\[1\] is \[1. 1.\]; it must be 0"):
        to((model, state, joints), 1)
    to((model, state, joints), 0)  # of another world
    with pytest.raises(ValueError, match=r"world is 2; it must lie in \[0, 2\)"):
        to((model, state, joints), 2)
    for wrong in ("thesis", (model, state), None):
        with pytest.raises(TypeError, match=r"scene is .*; it must be a scene, a ModelBuilder, a Simulation"):
            to(wrong)


def test_pymunk_holds_one_coefficient_of_restitution():
    pytest.importorskip("pymunk")
    with pytest.raises(ValueError, match=r"shape_restitution\[1\] is 0.5 and \[0\] is 0; they must be equal"):
        scenes.to_pymunk(builder_with(restitution=0.5), 1)


def test_box2d_holds_16_bits_and_no_small_polygons():
    pytest.importorskip("Box2D")
    with pytest.raises(ValueError, match=r"shape_category\[1\] is 0x10000; Box2D has 16 bits"):
        scenes.to_box2d(builder_with(category=1 << 16), 1)
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(), 0.001, 0.5)
    with pytest.raises(ValueError, match=r"shape 0 has vertices 0.002 m apart; Box2D welds those nearer than"):
        scenes.to_box2d(builder)


def add_joints(builder, kinds):
    """Pairs of a fixed body and a box, one pair a joint, in a row."""
    for i, add in enumerate(kinds):
        base = builder.add_body((4.0 * i, 0.0), type=dc.BodyType.STATIC, angle=0.2)
        box = builder.add_body((4.0 * i + 0.8, 0.3), angle=0.5)
        builder.add_box(box, 0.5, 0.2, mask=0)
        add(base, box)


def joint_kinds(builder, engine):
    """Calls that add joints which both engines have, or the one of this name."""
    ends = {"anchor_a": (0.2, 0.1), "anchor_b": (-0.4, 0.0)}
    spring = {"frequency": 2.0, "damping_ratio": 0.3}
    kinds = [
        lambda a, b: builder.add_distance_joint(a, b, **ends, collide_connected=False),
        lambda a, b: builder.add_distance_joint(a, b, **ends, **spring, upper=1.0),
        lambda a, b: builder.add_rope_joint(a, b, **ends, max_length=0.9),
        lambda a, b: builder.add_revolute_joint(a, b, (0.2, 0.1), lower=-0.4, upper=0.3),
        lambda a, b: builder.add_revolute_joint(a, b, (0.2, 0.1), motor_speed=2.0, max_motor_torque=30.0),
        lambda a, b: builder.add_revolute_joint(a, b, (0.2, 0.1), motor_speed=2.0, max_motor_torque=0.5),
        lambda a, b: builder.add_prismatic_joint(a, b, (0.6, -0.8), (0.2, 0.1), lower=-1.0, upper=0.3),
        lambda a, b: builder.add_weld_joint(a, b, (0.2, 0.1)),
        lambda a, b: builder.add_wheel_joint(a, b, (0.0, 1.0), (0.2, 0.1), **spring),
        lambda a, b: builder.add_wheel_joint(a, b, (0.0, 1.0), motor_speed=3.0, max_motor_torque=0.3),
    ]
    if engine == "pymunk":
        kinds.append(lambda a, b: builder.add_wheel_joint(a, b, **spring, lower=-0.1, upper=0.1))
    else:
        kinds.append(lambda a, b: builder.add_prismatic_joint(a, b, (0.6, -0.8), motor_speed=0.2, max_motor_force=9.0))
    return kinds


def test_joints_of_all_kinds_move_as_here(engine):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    add_joints(builder, joint_kinds(builder, engine))
    sim = dc.Simulation(*builder.finalize("float64"))
    space, bodies = ENGINES[engine](sim)
    step(engine, space, 0.001, 500)
    sim.run(500, 0.001)
    places = np.array([motion(engine, body)[0] for body in bodies])
    moved = np.linalg.norm(sim.state.numpy("position") - builder.finalize("float64")[1].numpy("position"), axis=1)
    assert (moved[1::2] > 0.05).sum() >= 9  # all but the weld
    # of a spring of ours the stiffness follows the mass at its end as the body turns; that of pymunk is constant
    at, turned = (0.04, 0.15) if engine == "pymunk" else (0.002, 0.005)
    np.testing.assert_allclose(places, sim.state.numpy("position"), atol=at)
    np.testing.assert_allclose([body.angle for body in bodies], sim.state.numpy("angle"), atol=turned)


def test_joints_that_an_engine_lacks_are_named(engine):
    def refused(message, add):
        builder = dc.ModelBuilder()
        builder.add_world()
        add_joints(builder, [lambda a, b: add(builder, a, b)])
        with pytest.raises(ValueError, match=message):
            ENGINES[engine](builder)

    refused(r"joint_kind\[0\] is GEAR; other engines have none as ours", lambda m, a, b: m.add_gear_joint(a, b, 2.0))
    refused(r"joint_break_force\[0\] is 5 N", lambda m, a, b: m.add_weld_joint(a, b, break_force=5.0))
    if engine == "pymunk":
        slider = {"motor_speed": 1.0, "max_motor_force": 1.0}
        refused("slider with a motor; pymunk has none", lambda m, a, b: m.add_prismatic_joint(a, b, (1, 0), **slider))
    else:
        refused("wheel with limits; Box2D 2.3 has none", lambda m, a, b: m.add_wheel_joint(a, b, upper=1.0))
        refused(
            r"joint_lower\[0\] is 0.1 m; Box2D 2.3 has no least", lambda m, a, b: m.add_rope_joint(a, b, min_length=0.1)
        )
