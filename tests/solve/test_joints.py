"""Joints of all kinds against closed forms, on both backends; break, forces, warm start, snapshots."""

import io
import math

import numpy as np
import pytest

import dc_kernels as dc
from bench.peers.gauge import Gauge
from pipeline import scenes

G = 9.8
DT = 1 / 60
EXACT = dc.SolverConfig(tolerance=1e-12, relative_tolerance=1e-12, max_sweeps=3000)
SOFT = dc.SolverConfig(method="tgs_soft", substeps=4)


def wall_and_rod(builder, angle=0.0, length=1.0, **joint):
    """A rod that hangs on a hinge at the origin by its end, at an angle from straight down."""
    wall = builder.add_body(type=dc.BodyType.STATIC)
    half = length / 2
    rod = builder.add_body((half * math.sin(angle), -half * math.cos(angle)), angle=angle)
    builder.add_box(rod, 0.005, half)
    builder.add_revolute_joint(wall, rod, (0, 0), (0, half), reference_angle=0.0, **joint)
    return rod


def gallery():
    """A world of each kind of joint, with all parts, near its limits; and one where a tree meets a floor."""
    builder = dc.ModelBuilder()

    def world():
        builder.add_world(gravity=(1.0, -G), length_scale=1.0)
        wall = builder.add_body(type=dc.BodyType.STATIC)
        block = builder.add_body((0.5, 0.1), angle=0.2, velocity=(0.3, 0.0), angular_velocity=0.5)
        builder.add_box(block, 0.3, 0.1, mask=0)
        other = builder.add_body((1.3, 0.2), angle=-0.1)
        builder.add_box(other, 0.2, 0.2, mask=0)
        builder.add_revolute_joint(wall, block, (0.2, 0.0))
        return block, other

    block, other = world()
    builder.add_distance_joint(block, other, (0.3, 0), (0, 0.1), 0.7, frequency=2.0, damping_ratio=0.3, upper=0.9)
    block, other = world()
    builder.add_rope_joint(block, other, max_length=0.85, min_length=0.5)
    block, other = world()
    builder.add_revolute_joint(block, other, (0.3, 0), lower=-0.2, upper=0.1, motor_speed=1.0, max_motor_torque=0.05)
    block, other = world()
    builder.add_prismatic_joint(
        block, other, (1.0, 0.5), (0.3, 0), lower=-0.05, upper=0.1, motor_speed=0.5, max_motor_force=0.3
    )
    block, other = world()
    builder.add_weld_joint(block, other, (0.3, 0))
    block, other = world()
    builder.add_weld_joint(block, other, (0.3, 0), frequency=3.0, damping_ratio=0.5)
    block, other = world()
    builder.add_wheel_joint(block, other, (0.2, 1.0), (0.5, 0), motor_speed=2.0, max_motor_torque=0.1, upper=0.02)
    block, other = world()
    builder.add_target_joint(block, other, (0.6, 0.0), max_force=0.5)
    block, other = world()
    builder.add_gear_joint(block, other, -2.0)
    block, other = world()
    builder.add_general_joint(block, other, (0, -1.0, -0.2), (0.5, 1.0, 0.1), speed=0.1, lower=-1.0)
    block, other = world()  # a tree of joints on a floor, which breaks
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(floor, 5.0, 0.5, center=(0, -0.7))
    disc = builder.add_discs([(1.3, 0.1)], 0.25)[0]
    builder.add_revolute_joint(block, other, (0.3, 0), break_force=8.0)
    builder.add_distance_joint(other, disc, length=0.3)
    rope_of_rods(builder, 4, 30.0, angle=0.5)
    return builder


def rope_of_rods(builder, links, load, angle=0.0):
    """A world of light discs on rods, let go from a straight line, with a load at the end; its index."""
    builder.add_world(gravity=(0, -G))
    body = builder.add_body(type=dc.BodyType.STATIC)
    for i in range(1, links + 1):
        here = builder.add_body(
            (0.25 * i * math.cos(angle), 0.25 * i * math.sin(angle)), mass=load if i == links else 1.0
        )
        builder.add_disc(here, 0.05, mask=0)
        builder.add_distance_joint(body, here, across=None)
        body = here
    return body


def run(builder, steps, dt=DT, dtype="float64", backend="warp", config=EXACT, **options):
    sim = dc.Simulation(*builder.finalize(dtype, backend=backend), config=config, **options)
    sim.run(steps, dt)
    return sim


@pytest.mark.parametrize("config", [EXACT, SOFT])
def test_both_backends_agree_on_every_kind_and_part(config):
    fast, oracle = (run(gallery(), 12, backend=backend, config=config) for backend in ("warp", "numpy"))
    assert not fast.state.numpy("flags").any()
    for name in ("position", "angle", "velocity", "angular_velocity"):
        np.testing.assert_allclose(fast.state.numpy(name), oracle.state.numpy(name), atol=1e-9, err_msg=name)
    for name in ("joint_impulse", "joint_broken", "joint_color"):
        np.testing.assert_allclose(fast.joints.numpy(name), oracle.joints.numpy(name), atol=1e-9, err_msg=name)
    for one, other in zip(dc.joint_reactions(fast), dc.joint_reactions(oracle), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_bits_do_not_depend_on_threads_snapshots_copies_or_the_schedule():
    plain = run(gallery(), 30, dtype="float32", config=None)
    shared = run(gallery(), 30, dtype="float32", config=None, threads=2)
    # in float64, whose colours solve/test_own_rows.py compiles too
    sweeps, colors = (run(gallery(), 30, config=None, schedule=schedule) for schedule in ("world", "color"))
    stopped = run(gallery(), 11, dtype="float32", config=None)
    file = io.BytesIO()
    stopped.save(file)
    file.seek(0)
    loaded = dc.Simulation.load(file)
    copied = stopped.clone()
    for sim in (stopped, loaded, copied):
        sim.run(19, DT)
    for sim, wanted_of in ((shared, plain), (colors, sweeps), (stopped, plain), (loaded, plain), (copied, plain)):
        for group, names in (
            ("state", ("position", "angle", "velocity")),
            ("joints", ("joint_impulse", "joint_broken")),
        ):
            for name in names:
                found, wanted = (np.abs(getattr(one, group).numpy(name)) for one in (sim, wanted_of))
                assert found.tobytes() == wanted.tobytes(), name
    stopped.reset()
    stopped.run(30, DT)
    assert stopped.state.numpy("position").tobytes() == plain.state.numpy("position").tobytes()


def arithmetic_geometric_mean(a, b):
    while abs(a - b) > 1e-15 * a:
        a, b = (a + b) / 2, math.sqrt(a * b)
    return a


@pytest.mark.parametrize("amplitude", [0.5, 2.0])
def test_period_and_force_of_a_pendulum(amplitude):
    """A point mass on an arm: T = 2 pi sqrt(l / g) / agm(1, cos(a / 2)), and m g (3 - 2 cos a) at the bottom."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    bob = builder.add_body((math.sin(amplitude), -math.cos(amplitude)), angle=amplitude, mass=2.0, inertia=1e-9)
    hinge = builder.add_revolute_joint(wall, bob, (0, 0), (0, 1))
    sim = dc.Simulation(*builder.finalize("float64"), config=EXACT)
    period = 2 * math.pi / math.sqrt(G) / arithmetic_geometric_mean(1.0, math.cos(amplitude / 2))
    quarter = 500
    sim.run(quarter, period / 4 / quarter)
    assert sim.state.numpy("position")[bob][0] == pytest.approx(0.0, abs=5e-3)
    force = dc.joint_reactions(sim).force[hinge]
    assert force == pytest.approx([0.0, 2.0 * G * (3 - 2 * math.cos(amplitude))], rel=5e-3, abs=0.3)
    sim.run(quarter, period / 4 / quarter)
    assert sim.state.numpy("position")[bob] == pytest.approx([-math.sin(amplitude), -math.cos(amplitude)], abs=6e-3)


@pytest.mark.parametrize("config", [EXACT, SOFT])
def test_a_motor_turns_at_its_speed_until_the_load_balances_it(config):
    """It turns a wheel at its speed; it holds a rod where its torque is that of the weight, and reports that."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    wheel = builder.add_discs([(0, 0)], 0.5)[0]
    builder.add_revolute_joint(wall, wheel, motor_speed=3.0, max_motor_torque=0.1)
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    rod = wall_and_rod(builder, angle=0.5, motor_speed=0.0, max_motor_torque=5.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    inertia, mass = sim.model.numpy("inertia")[wheel], sim.model.numpy("mass")[rod]
    sim.run(10, 0.01)
    assert sim.state.numpy("angular_velocity")[wheel] == pytest.approx(0.1 / inertia * 0.1)
    sim.run(300, 0.01)
    assert sim.state.numpy("angular_velocity")[wheel] == pytest.approx(3.0)
    assert sim.state.numpy("angle")[rod] == pytest.approx(0.5, abs=1e-9)
    reactions = dc.joint_reactions(sim)
    assert reactions.torque[1] == pytest.approx(mass * G * 0.5 * math.sin(0.5))
    assert reactions.force[1] == pytest.approx([0.0, mass * G], abs=1e-9)
    sim.joints.assign("joint_speed", [-2.0, 0.0])
    sim.run(600, 0.01)
    assert sim.state.numpy("angular_velocity")[wheel] == pytest.approx(-2.0)


@pytest.mark.parametrize(("config", "beyond"), [(EXACT, 2e-3), (SOFT, 4e-3)])
def test_limits_hold_what_moves_into_them(config, beyond):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    rod = wall_and_rod(builder, angle=1.2, lower=0.7, upper=2.0)
    slide = builder.add_body((3, 0))
    builder.add_box(slide, 0.1, 0.1)
    builder.add_prismatic_joint(0, slide, (0, 1), (3, 0), lower=-0.3)
    rope = builder.add_body((5, -0.5))
    builder.add_box(rope, 0.1, 0.1)
    builder.add_rope_joint(0, rope, (5, 0), max_length=0.8)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    lowest = 0.0
    for _ in range(120):
        sim.step(DT)
        lowest = min(lowest, sim.state.numpy("angle")[rod] - 0.7)
    assert lowest > -beyond
    assert sim.state.numpy("angle")[rod] == pytest.approx(0.7, abs=1e-3)
    assert sim.state.numpy("position")[slide] == pytest.approx([3, -0.3], abs=1e-3)
    assert sim.state.numpy("position")[rope] == pytest.approx([5, -0.8], abs=1e-3)
    assert dc.joint_reactions(sim).force[2] == pytest.approx([0, 0.04 * G], rel=1e-6)


def test_a_limit_has_a_row_only_near_its_ends():
    """A rod that turns by 0.3 rad a step has none in the middle of its range, and stops at its end nevertheless."""
    for backend in ("warp", "numpy"):
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
        rod = wall_and_rod(builder, lower=-3.0, upper=2.0)
        sim = dc.Simulation(*builder.finalize(backend=backend))
        sim.step(DT)
        assert sim.rows.numpy("row_slot").tolist()[2] == -1 < min(sim.rows.numpy("row_slot").tolist()[:2])
        spin, center = sim.state.numpy("angular_velocity").copy(), sim.state.numpy("velocity").copy()
        spin[rod], center[rod] = 18.0, (9.0, 0.0)
        sim.state.assign("angular_velocity", spin)
        sim.state.assign("velocity", center)
        angles, near = [], []
        for _ in range(12):
            sim.step(DT)
            angles.append(float(sim.state.numpy("angle")[rod]))
            near.append(sim.rows.numpy("row_slot")[2] >= 0)
        assert not near[0] and near[-1]
        assert max(angles) < 2.02
        assert angles[-1] == pytest.approx(2.0, abs=0.02)


def test_a_spring_swings_with_its_frequency_and_damping():
    """X = exp(-z w t) cos(w sqrt(1 - z^2) t) + ..., to the first order of implicit Euler."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    body = builder.add_body((1.5, 0), mass=3.0, inertia=1.0)
    builder.add_distance_joint(wall, body, length=1.0, frequency=1.0, damping_ratio=0.1)
    sim = dc.Simulation(*builder.finalize("float64"), config=EXACT)
    w, z, dt = 2 * math.pi, 0.1, 1e-4
    sim.run(3000, dt)
    turn = w * math.sqrt(1 - z * z) * 0.3
    wanted = 0.5 * math.exp(-z * w * 0.3) * (math.cos(turn) + z / math.sqrt(1 - z * z) * math.sin(turn))
    assert sim.state.numpy("position")[body][0] - 1.0 == pytest.approx(wanted, abs=1e-3)


@pytest.mark.parametrize("config", [EXACT, SOFT])
def test_a_target_draws_with_no_more_than_its_force(config):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    body = builder.add_body((0, 0), mass=2.0, inertia=1.0)
    builder.add_target_joint(wall, body, (5.0, 0.0), max_force=4.0, damping_ratio=1.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.run(10, 0.01)
    assert sim.state.numpy("velocity")[body] == pytest.approx([0.2, 0.0])
    sim.joints.assign("joint_anchor_a", [(0.1, 0.5)])
    sim.run(600, 0.01)
    assert sim.state.numpy("position")[body] == pytest.approx([0.1, 0.5], abs=1e-3)


@pytest.mark.parametrize("config", [EXACT, SOFT])
def test_gears_and_general_rows_share_momentum(config):
    """Wheels on hinges that roll on each other; two masses on a rope over a pulley, as a row of one's own."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    wheels = builder.add_discs([(0, 0), (3, 0)], [1.0, 0.5], angular_velocity=[3.0, 0.0])
    for wheel in wheels:
        builder.add_revolute_joint(wall, wheel, (3.0 * (wheel == wheels[1]), 0))
    builder.add_gear_joint(*wheels, ratio=-2.0)
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    heavy, light = (builder.add_body((x, 0), mass=m, inertia=1.0) for x, m in ((0, 5.0), (1, 3.0)))
    builder.add_general_joint(heavy, light, (0, 1, 0), (0, 1, 0), lower=0.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    i, j = sim.model.numpy("inertia")[wheels]
    sim.run(60, 0.01)
    spin = sim.state.numpy("angular_velocity")[wheels]
    assert spin == pytest.approx([3.0 * i / (i + 4 * j), -6.0 * i / (i + 4 * j)])
    assert sim.state.numpy("velocity")[[heavy, light], 1] == pytest.approx(np.array([-1, 1]) * 0.6 * G / 4)


@pytest.mark.parametrize("config", [EXACT, SOFT])
def test_a_joint_breaks_above_its_force_and_only_then(config):
    builder = dc.ModelBuilder()
    for strength in (1.05, 0.95):
        builder.add_world(gravity=(0, -G), length_scale=1.0)
        wall_and_rod(builder, break_force=strength * G * 0.01)
    sim = run(builder, 20, config=config)
    assert sim.joints.numpy("joint_broken").tolist() == [0, 1]
    assert sim.state.numpy("velocity")[:, 1] == pytest.approx([0, 0, 0, -G * 19 * DT], abs=1e-9)
    sim.reset()
    assert not sim.joints.numpy("joint_broken").any()


def test_a_rod_of_length_0_is_a_hinge_and_a_spring_of_length_0_draws_together():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    bodies = [builder.add_body((0, 0), velocity=(1, 1), mass=1.0, inertia=1.0) for _ in range(2)]
    builder.add_distance_joint(wall, bodies[0], length=0.0)
    builder.add_distance_joint(wall, bodies[1], length=0.0, frequency=1.0, damping_ratio=1.0)
    sim = run(builder, 300, 0.01)
    assert sim.joints.numpy("joint_kind")[0] == dc.JointKind.REVOLUTE
    assert sim.state.numpy("velocity")[bodies] == pytest.approx(np.zeros((2, 2)), abs=1e-4)


def hinged_rope(builder, links, load):
    """A world of light links on hinges, let go from horizontal, with a load at the end; its index."""
    builder.add_world(gravity=(0, -G))
    body, anchor = builder.add_body(type=dc.BodyType.STATIC), (0, 0)
    for i in range(links):
        link = builder.add_body((0.25 * i + 0.125, 0))
        builder.add_box(link, 0.125, 0.05)
        builder.add_revolute_joint(body, link, anchor, (-0.125, 0))
        body, anchor = link, (0.125, 0)
    end = builder.add_body((0.25 * links, 0), mass=load * 0.025)
    builder.add_box(end, 0.2, 0.2, mask=0)
    builder.add_revolute_joint(body, end, anchor)
    return end


@pytest.mark.parametrize(("load", "stretch"), [(100.0, 0.03), (1e4, 0.05)])
def test_a_rope_of_hinged_links_carries_a_heavy_load(load, stretch):
    """20 links let go from horizontal, with the default settings at 1/60 s in float32."""
    builder = dc.ModelBuilder()
    end = hinged_rope(builder, 20, load)
    sim = dc.Simulation(*builder.finalize())
    lowest = 0.0
    for _ in range(300):
        sim.step(DT)
        assert np.hypot(*sim.state.numpy("position")[end]) < 5 * (1 + stretch)
        lowest = min(lowest, sim.state.numpy("position")[end, 1])
    assert lowest < -4.9 and not sim.state.numpy("flags").any()


def test_a_rope_of_rods_carries_a_heavy_load():
    """Discs on 2 to 20 rods with 100 times their weight, and 50 alike, with the default settings at 1/60 s."""
    builder = dc.ModelBuilder()
    links = [2, 5, 20, 20, 50]
    ends = [rope_of_rods(builder, n, 1.0 if n == 50 else 100.0, angle) for n, angle in zip(links, (0, 0, 0, 0.5, 0))]
    sim = dc.Simulation(*builder.finalize())
    lowest = 0.0
    for _ in range(300):
        sim.step(DT)
        places = sim.state.numpy("position")[ends]
        assert (np.hypot(*places.T) < 1.05 * 0.25 * np.array(links)).all()
        lowest = np.minimum(lowest, places[:, 1])
    assert (lowest[:4] < -0.24 * np.array(links[:4])).all() and not sim.state.numpy("flags").any()


def test_a_heavy_rope_of_rods_swings_as_high_as_it_was_let_go():
    """What keeps its links from swinging within a step is not felt by the swing of the whole."""
    builder = dc.ModelBuilder()
    end = rope_of_rods(builder, 20, 100.0, angle=-1.0)
    sim = dc.Simulation(*builder.finalize())
    height = []
    for _ in range(300):
        sim.step(DT)
        height.append(float(sim.state.numpy("position")[end, 1]))
    assert max(height[150:]) == pytest.approx(-5 * math.sin(1.0), abs=0.02)


@pytest.mark.parametrize("correction", ["baumgarte", "none"])
def test_heavy_ropes_do_not_run_off_without_the_position_phase(correction):
    """Links that whirl would gain energy from an inertia that comes and goes with the pull: 5 links, 15 s."""
    builder = dc.ModelBuilder()
    rods = rope_of_rods(builder, 5, 100.0)
    hinged = hinged_rope(builder, 5, 100.0)
    sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(position_correction=correction))
    for _ in range(900):
        sim.step(DT)
        assert (np.hypot(*sim.state.numpy("position")[[rods, hinged]].T) < 1.25 * 2).all()


def test_rods_have_a_row_across_where_much_hangs_on_little():
    """One rod alone, springs, nets, and what is told to, have none."""
    builder = dc.ModelBuilder()
    rope_of_rods(builder, 3, 30.0)
    rope_of_rods(builder, 3, 9.0)
    rope_of_rods(builder, 1, 1e3)
    builder.add_world(gravity=(0, -G))
    corners = [builder.add_body((x, y), mass=1.0 + 99.0 * x) for x in (0, 1) for y in (0, 1)]
    for a, b in ((0, 1), (1, 3), (3, 2), (2, 0), (0, 3)):
        builder.add_distance_joint(corners[a], corners[b], across=None)
    builder.add_world(gravity=(0, -G))
    far, near, last = (builder.add_body((x, 0), mass=m) for x, m in ((0, 1.0), (1, 1.0), (2, 50.0)))
    builder.add_distance_joint(far, near)
    builder.add_distance_joint(near, last, across=None)
    builder.add_distance_joint(far, last, frequency=1.0)
    joints = builder.finalize(backend="numpy")[2]
    across = joints.numpy("joint_parts") & int(dc.JointPart.ACROSS) != 0
    assert across.tolist() == [True] * 3 + [False] * 3 + [False] + [False] * 5 + [False, True, False]
    assert np.diff(joints.numpy("joint_row_start")).tolist() == (1 + across).tolist()


def test_joined_bodies_collide_only_where_they_should():
    builder = dc.ModelBuilder()
    for collides in (False, True):
        builder.add_world(gravity=(0, 0), length_scale=1.0)
        one, two = (builder.add_body((x, 0)) for x in (0, 0.9))
        for body in (one, two):
            builder.add_box(body, 0.5, 0.5)
        builder.add_revolute_joint(one, two, (0.45, 0), collide_connected=collides, break_force=1e6)
    for backend in ("warp", "numpy"):
        sim = run(builder, 1, backend=backend)
        assert sim.contacts.numpy("contact_count").tolist() == [0, 2]
        sim.change_model(joint_broken=1)
        sim.step(DT)
        assert sim.contacts.numpy("contact_count").tolist() == [2, 2]


def test_a_chain_between_two_points_hangs_as_a_catenary():
    """Its links of equal mass hang so that tan of their angles rises alike from one to the next (Varignon 1725)."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    wall = body = builder.add_body(type=dc.BodyType.STATIC)
    anchor, links = (0, 0), []
    for i in range(12):
        links.append(builder.add_body(((i + 0.5) * 0.2, -0.5), linear_damping=3.0, angular_damping=3.0))
        builder.add_box(links[-1], 0.15, 0.02, mask=0)
        builder.add_revolute_joint(body, links[-1], anchor, (-0.15, 0))
        body, anchor = links[-1], (0.15, 0)
    builder.add_revolute_joint(wall, body, (2.4, 0), anchor)
    sim = run(builder, 1500, config=None, dtype="float32")
    slope = np.diff(np.tan(sim.state.numpy("angle")[links].astype(float)))
    assert slope == pytest.approx(np.full(11, slope.mean()), rel=0.02)


def test_a_double_pendulum_follows_its_equations():
    """Two rods of 1 m and 1 kg, against DOP853 of Lagrange's equations."""
    integrate = pytest.importorskip("scipy.integrate")
    angles = (1.0, 0.3)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    body, end, anchor, rods = builder.add_body(type=dc.BodyType.STATIC), np.zeros(2), (0, 0), []
    for angle in angles:
        along = np.array([math.sin(angle), -math.cos(angle)])
        rods.append(builder.add_body(end + along / 2, angle=angle, mass=1.0, inertia=1 / 12))
        builder.add_revolute_joint(body, rods[-1], anchor, (0, 0.5))
        body, end, anchor = rods[-1], end + along, (0, -0.5)

    def motion(_, y):
        a, b, u, v = y
        mass = np.array([[4 / 3, math.cos(a - b) / 2], [math.cos(a - b) / 2, 1 / 3]])
        pull = -G * np.array([1.5 * math.sin(a), 0.5 * math.sin(b)])
        turn = math.sin(a - b) / 2 * np.array([-v * v, u * u])
        return [u, v, *np.linalg.solve(mass, pull + turn)]

    wanted = integrate.solve_ivp(motion, (0, 1), [*angles, 0, 0], method="DOP853", rtol=1e-10, atol=1e-10).y[:2, -1]
    off = [np.abs(run(builder, n, 1 / n).state.numpy("angle")[rods] - wanted).max() for n in (250, 1000)]
    assert off[1] < 0.01 and off[1] < 0.4 * off[0]  # of first order


def test_a_step_starts_from_the_impulses_of_the_one_before():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -G), length_scale=1.0)
    wall_and_rod(builder, angle=0.3, motor_speed=0.0, max_motor_torque=5.0)
    model, state, joints = builder.finalize("float64")
    warm, cold = (
        dc.Simulation(model.copy(), state.copy(), joints.copy(), config=dc.SolverConfig(start=start, min_sweeps=1))
        for start in ("cache", "zero")
    )
    for sim in (warm, cold):
        sim.run(50, DT)
    assert warm.stats.numpy("sweeps")[0] < cold.stats.numpy("sweeps")[0]
    impulse = joints.numpy("joint_impulse").copy()
    with pytest.raises(ValueError, match="joint_impulse is a result between two steps"):
        warm.joints.assign("joint_impulse", impulse)
    warm.collide(DT)
    warm.joints.assign("joint_impulse", impulse)
    warm.solve(dc.SolverConfig(max_sweeps=0))
    assert np.array_equal(warm.joints.numpy("joint_impulse"), impulse) and not impulse.any()


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("joint_lower", [3.0], r"joints\.joint_lower\[0\] is 3\.0; it must be at most joint_upper"),
        ("joint_axis", [(2.0, 0.0)], r"joints\.joint_axis\[0\] .* a unit vector"),
        ("joint_strength", [-1.0], r"joints\.joint_strength\[0\] is -1\.0; it must be finite and >= 0"),
        ("joint_broken", [2], r"joints\.joint_broken\[0\] is 2; it must be in \[0, 1\]"),
    ],
)
def test_what_no_joint_may_be_is_refused_by_name(name, values, message):
    builder = dc.ModelBuilder()
    builder.add_world()
    wall_and_rod(builder, lower=-1.0, upper=2.0)
    sim = dc.Simulation(*builder.finalize(backend="numpy"))
    with pytest.raises(ValueError, match=message):
        sim.change_model(**{name: values})
    if sim.joints.writable(name) and name != "joint_lower":  # which may be written before joint_upper is
        with pytest.raises(ValueError, match=message.replace(r"joints\.", "")):
            sim.joints.assign(name, values)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.add_revolute_joint(0, 1, lower=1.0, upper=0.5), "lower of joint 0 is 1; .* at most upper, 0.5"),
        (lambda b: b.add_revolute_joint(0, 1, motor_speed=1.0), "max_motor_torque of joint 0 is missing"),
        (lambda b: b.add_prismatic_joint(0, 1, (0, 0)), r"axis of joint 0 is \(0, 0\)"),
        (lambda b: b.add_distance_joint(0, 1, length=1.0, upper=2.0), "frequency of joint 0 is 0, and it has limits"),
        (
            lambda b: b.add_distance_joint(0, 1, length=1.0, frequency=2.0, across=True),
            "across of joint 0 is True, and it is a spring; only rods",
        ),
        (lambda b: b.add_distance_joint(0, 1, length=1.0, frequency=2.0, across=None), "across of joint 0 is None"),
        (lambda b: b.add_distance_joint(0, 1, length=0.0, across="no"), "across of joint 0 is 'no'; .* True or False"),
        (lambda b: b.add_distance_joint(0, 1, length=-1.0), r"length of joint 0 is -1\.0; it must be finite and >= 0"),
        (lambda b: b.add_rope_joint(0, 1, max_length=1.0, min_length=2.0), "min_length of joint 0 is 2"),
        (lambda b: b.add_weld_joint(0, 1, break_force=0.0), r"break_force of joint 0 is 0\.0; .* > 0"),
        (lambda b: b.add_target_joint(0, 1, max_force=1.0, frequency=0.0), r"frequency of joint 0 is 0\.0; .* > 0"),
    ],
)
def test_wrong_arguments_are_named(call, message):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_body(type=dc.BodyType.STATIC)
    builder.add_body(mass=1.0)
    with pytest.raises(ValueError, match=message):
        call(builder)


def test_trees_are_solved_where_sweeps_leave_joints_apart():
    """A chain that carries a load needs them, a doll that floats does not, a net has none."""
    found = {}
    for name, scene in (
        ("chain", scenes.BallAndChain(bodies=10)),
        ("doll", scenes.Ragdolls(bodies=11, gravity=0.0)),
        ("net", scenes.JointGrid(bodies=100)),
    ):
        sim = dc.Simulation(*scene.build().finalize("float64"))
        sim.run(80, 0.01)
        found[name] = (sim.rows.numpy("tree_used") > 0).tolist(), len(sim.rows.numpy("tree_row"))
    assert found == {"chain": ([True], 11), "doll": ([False], 10), "net": ([], 0)}


@pytest.mark.parametrize("loops", [1, 2])
def test_a_ring_is_a_tree_but_for_one_joint_and_a_knot_is_none(loops):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    places = [(math.cos(t), math.sin(t)) for t in np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)]
    links = [builder.add_body(place) for place in places]
    for link in links:
        builder.add_disc(link, 0.1)
    for i in range(12):
        builder.add_revolute_joint(links[i], links[(i + 1) % 12])
    for i in range(loops - 1):
        builder.add_revolute_joint(links[i], links[i + 6])
    sim = dc.Simulation(*builder.finalize())
    assert len(sim.rows.numpy("tree_row")) == (11 if loops == 1 else 0)


def test_a_net_is_held_within_few_sweeps():
    """What a net of 400 lacks shows as stretch, which stays below 1e-4 of its mesh once it swings."""
    scene = scenes.JointGrid(bodies=400)
    sim = dc.Simulation(*scene.build().finalize())
    sweeps = []
    for _ in range(60):
        sim.step(0.01)
        sweeps.append(int(sim.stats.numpy("sweeps")[0]))
    gauge = Gauge(*scene.build().finalize("float64"))
    apart = gauge.separations(*(sim.state.numpy(name).astype(np.float64) for name in ("position", "angle")))
    assert max(apart) < 1e-4 and max(sweeps) < 400 and np.mean(sweeps[30:]) < 15.0
