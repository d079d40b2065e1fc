"""What the builder makes of worlds, bodies, shapes and joints, and what it refuses."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels.model import assemble
from dc_kernels.model.shapes import mass_properties
from dc_kernels.model.validate import known

SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
KINDS = st.sampled_from(list(dc.BodyType))
small = st.floats(-3, 3)


def builder_with_world(**options):
    builder = dc.ModelBuilder()
    builder.add_world(**options)
    return builder


def finalize(builder, dtype="float64"):
    return builder.finalize(dtype, backend="numpy")


def world_vertices(model, state, shape):
    """Vertices of a shape in world coordinates, as the simulation sees them."""
    body = model.shape_body[shape]
    c, s = math.cos(state.angle[body]), math.sin(state.angle[body])
    local = model.vertices[model.vertex_start[shape] : model.vertex_start[shape + 1]]
    world = np.searchsorted(model.body_start, body, side="right") - 1
    return local @ np.array(((c, s), (-s, c))) + state.position[body] + model.origin[world]


def test_two_half_boxes_weigh_as_one():
    builder = builder_with_world()
    one, two = builder.add_body(position=(1, 2)), builder.add_body(position=(1, 2))
    builder.add_box(one, 2.0, 0.5, center=(2.0, 0.5), density=3.0)
    builder.add_box(two, 1.0, 0.5, center=(1.0, 0.5), density=3.0)
    builder.add_box(two, 1.0, 0.5, center=(3.0, 0.5), density=3.0)
    model, state, _ = finalize(builder)
    assert model.mass[one] == pytest.approx(12.0)
    assert model.inertia[one] == pytest.approx(12.0 * (16 + 1) / 12)
    assert state.position[one] == pytest.approx((3.0, 2.5))
    for name in ("mass", "inertia", "inv_mass", "inv_inertia", "center_of_mass"):
        assert model.numpy(name)[two] == pytest.approx(model.numpy(name)[one])
    assert model.inv_mass[one] * model.mass[one] == pytest.approx(1)
    assert model.inv_inertia[one] * model.inertia[one] == pytest.approx(1)


def test_densities_weigh_the_centre_of_mass():
    builder = builder_with_world()
    body = builder.add_body()
    builder.add_disc(body, 1.0, (-1, 0), density=1.0)
    builder.add_disc(body, 1.0, (1, 0), density=3.0)
    model, _, _ = finalize(builder)
    assert model.center_of_mass[body] == pytest.approx((0.5, 0))
    assert model.inertia[body] == pytest.approx(math.pi * (4 / 2 + 1.5**2 + 3 * 0.5**2))
    assert model.shape_center == pytest.approx(np.array(((-1.5, 0), (0.5, 0))))


@given(KINDS, small, small, small, small, small)
def test_shapes_stay_where_they_were_put(kind, x, y, angle, cx, cy):
    builder = builder_with_world(origin=(100, -50))
    body = builder.add_body(position=(x, y), angle=angle, type=kind)
    builder.add_box(body, 1, 2, center=(cx, cy), angle=0.3)
    builder.add_capsule(body, (cx, cy), (2, 5), 0.1)
    model, state, _ = finalize(builder)
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array(((c, s), (-s, c)))
    capsule = np.array(((cx, cy), (2, 5))) @ turn + np.array((x, y))
    assert world_vertices(model, state, 1) == pytest.approx(capsule)
    com = model.center_of_mass[body]
    assert state.position[body] + model.origin[0] == pytest.approx(com @ turn + np.array((x, y)))
    assert model.shape_center + com == pytest.approx(np.array(((cx, cy), (cx / 2 + 1, cy / 2 + 2.5))))


@given(small, small, small, small, small, small)
def test_velocity_is_that_of_the_frame(vx, vy, spin, angle, cx, cy):
    builder = builder_with_world()
    body = builder.add_body(angle=angle, velocity=(vx, vy), angular_velocity=spin)
    builder.add_disc(body, 1.0, (cx, cy))
    _, state, _ = finalize(builder)
    # back from the centre of mass to the origin of the frame, at (0, 0): v = v_com - w x r
    x, y = state.position[body]
    assert state.velocity[body] - spin * np.array((-y, x)) == pytest.approx((vx, vy), abs=1e-12)
    assert state.angular_velocity[body] == spin


def test_kinematic_bodies_turn_about_their_frame():
    builder = builder_with_world()
    body = builder.add_body(position=(3, 4), velocity=(1, 2), angular_velocity=5, type=dc.BodyType.KINEMATIC)
    builder.add_box(body, 1, 1, center=(7, 0))
    model, state, _ = finalize(builder)
    assert model.center_of_mass[body].tolist() == [0, 0]
    assert state.position[body].tolist() == [3, 4]
    assert state.velocity[body].tolist() == [1, 2]


@pytest.mark.parametrize("kind", [dc.BodyType.STATIC, dc.BodyType.KINEMATIC])
def test_other_bodies_have_infinite_mass(kind):
    builder = builder_with_world()
    body = builder.add_body(type=kind, mass=3.0, inertia=4.0)
    builder.add_box(body, 1, 1)
    model, _, _ = finalize(builder)
    assert [model.numpy(n)[body] for n in ("mass", "inertia", "inv_mass", "inv_inertia")] == [0, 0, 0, 0]
    assert model.body_type[body] == kind


def test_given_mass_and_inertia_count_more_than_density():
    builder = builder_with_world()
    both = builder.add_body(mass=5.0, inertia=7.0)
    mass = builder.add_body(mass=5.0)
    inertia = builder.add_body(inertia=7.0)
    stiff = builder.add_body(inertia=0.0)
    weightless = builder.add_body(mass=5.0)
    for body in (both, mass, inertia, stiff):
        builder.add_box(body, 0.5, 0.5, center=(1, 0), density=2.0)
    builder.add_disc(weightless, 1.0, density=0.0)
    builder.add_disc(weightless, 1.0, (2, 0), density=0.0)
    model, _, _ = finalize(builder)
    assert model.mass.tolist() == pytest.approx([5, 5, 2, 2, 5])
    assert model.inertia.tolist() == pytest.approx([7, 5 / 6, 7, 0, 5 * (0.5 + 1)])
    assert model.inv_inertia[stiff] == 0
    assert model.center_of_mass[weightless] == pytest.approx((1, 0))


def test_point_mass():
    builder = builder_with_world()
    point = builder.add_body((1, 2), mass=2.0)
    gyro = builder.add_body(mass=2.0, inertia=4.0)
    model, state, _ = finalize(builder)
    assert model.shape_count == 0
    assert model.inv_mass.tolist() == [0.5, 0.5]
    assert [model.inv_inertia[point], model.inv_inertia[gyro]] == [0, 0.25]
    assert state.position[point].tolist() == [1, 2]
    assert model.length_scale.tolist() == [1.0]


def test_a_single_disc_keeps_its_vertex_at_zero():
    builder = builder_with_world()
    for center in ((0, 0), (0.1, 0.7)):
        builder.add_disc(builder.add_body(angle=0.3), 0.1, center, density=0.7)
    model, _, _ = finalize(builder)
    assert not model.vertices.any()
    assert not model.vertex_normals.any()
    assert not model.shape_center.any()
    assert model.center_of_mass[1].tolist() == [0.1, 0.7]


def test_many_discs_equal_one_after_the_other():
    rng = np.random.default_rng(1)
    n = 20
    positions, velocity = rng.normal(size=(2, n, 2))
    radius, density, angle, spin = rng.uniform(0.1, 1, (4, n))
    bulk, single = builder_with_world(), builder_with_world()
    for builder in (bulk, single):  # something before, so that indices do not begin at zero
        builder.add_disc(builder.add_body(), 1.0)
    bodies = bulk.add_discs(
        positions,
        radius,
        velocity=velocity,
        angle=angle,
        angular_velocity=spin,
        density=density,
        friction=0.3,
        restitution=radius / 2,
        category=2,
        mask=np.arange(n),
    )
    assert bodies.tolist() == list(range(1, n + 1))
    for i in range(n):
        body = single.add_body(positions[i], angle[i], velocity[i], spin[i])
        single.add_disc(
            body, radius[i], density=density[i], friction=0.3, restitution=radius[i] / 2, category=2, mask=i
        )
    for one, other in zip(finalize(bulk), finalize(single), strict=True):
        for name in one.table:
            assert np.array_equal(one.numpy(name), other.numpy(name)), name
    assert finalize(bulk)[0].mass[1:] == pytest.approx(density * math.pi * radius**2)


def test_one_velocity_serves_all_discs():
    builder = builder_with_world()
    builder.add_discs(np.zeros((3, 2)), 1.0, velocity=(1, 2))
    assert finalize(builder)[1].velocity.tolist() == [[1, 2]] * 3
    assert len(builder.add_discs(np.zeros((0, 2)), 1.0)) == len(builder.add_discs([], 1.0, velocity=[])) == 0


def test_far_away_is_as_exact_as_at_the_origin():
    models = []
    for far in (0.0, 1e5):
        builder = builder_with_world(origin=(far, -far))
        ground = builder.add_body(type=dc.BodyType.STATIC)  # its vertices are in world coordinates
        builder.add_chain(ground, np.array(((-1.25, 3), (0, 0), (5, 0))) + np.array((far, -far)))
        builder.add_discs(np.array(((0.3, 0.5), (1.1, 0.5))) + np.array((far, -far)), 0.25)
        body = builder.add_body((2.7 + far, 1 - far), angle=1.0)
        builder.add_polygon(body, SQUARE)
        models.append(finalize(builder, "float32"))
    for near, away in zip(*models, strict=True):
        for name in set(near.table) - {"origin", "center_of_mass"}:
            assert near.numpy(name) == pytest.approx(away.numpy(name), abs=1e-6), name


def test_shapes_are_sorted_by_body_and_stay_in_order():
    builder = builder_with_world()
    a, b = builder.add_body(), builder.add_body()
    for body, radius, x in ((b, 1.0, 0), (a, 2.0, 0), (b, 3.0, 1), (a, 4.0, 1)):
        builder.add_capsule(body, (x, 0), (x, 1), radius)
    builder.add_polygon(a, SQUARE, radius=5.0)
    model, _, _ = finalize(builder)
    assert model.shape_body.tolist() == [0, 0, 0, 1, 1]
    assert model.shape_radius.tolist() == [2, 4, 5, 1, 3]
    assert model.vertex_start.tolist() == [0, 2, 4, 8, 10, 12]
    assert model.vertices[4:8] + model.center_of_mass[a] == pytest.approx(np.array(SQUARE))
    assert model.vertices[10:12] + model.center_of_mass[b] == pytest.approx(np.array(((1, 0), (1, 1))))


def test_worlds_lie_one_after_the_other():
    builder = dc.ModelBuilder()
    assert builder.add_world(gravity=(1, 2)) == 0
    builder.add_discs(np.zeros((3, 2)), 1.0)
    assert builder.add_world() == 1  # empty
    assert builder.add_world(origin=(5, 6)) == 2
    a, b = builder.add_body((5, 6)), builder.add_body((6, 6))
    assert (a, b) == (3, 4)
    assert builder.add_disc(a, 2.0) == 3
    builder.add_disc(b, 3.0)
    assert builder.add_distance_joint(a, b) == 0
    model, state, joints = finalize(builder)
    assert (model.world_count, model.body_count, model.shape_count, model.joint_count) == (3, 5, 5, 1)
    assert model.body_start.tolist() == [0, 3, 3, 5]
    assert model.shape_start.tolist() == [0, 3, 3, 5]
    assert model.joint_start.tolist() == [0, 0, 0, 1]
    assert model.gravity.tolist() == [[1, 2], [0, -9.8], [0, -9.8]]
    assert model.origin.tolist() == [[0, 0], [0, 0], [5, 6]]
    assert state.position[3:].tolist() == [[0, 0], [1, 0]]
    assert model.length_scale.tolist() == [2.0, 1.0, 5.0]
    assert joints.joint_length.tolist() == [1.0]


def test_scales_come_from_what_moves():
    builder = builder_with_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 50, 50)
    builder.add_discs(np.zeros((3, 2)), [0.1, 0.2, 0.6])
    builder.add_world(length_scale=3.0)
    builder.add_disc(builder.add_body(), 0.5)
    builder.add_world()
    builder.add_disc(builder.add_body(type=dc.BodyType.STATIC), 0.5)
    model, _, _ = finalize(builder)
    assert model.length_scale == pytest.approx((0.4, 3.0, 1.0))
    smallest, margin = np.array((0.2, 1.0, 1.0)), 2 * dc.SolverConfig().margin
    assert model.cell_size == pytest.approx(1.3 * (smallest + margin * model.length_scale))


def test_polygon_fields():
    builder = builder_with_world()
    body = builder.add_body()
    builder.add_polygon(body, SQUARE[::-1], radius=0.5, friction=0.1, restitution=0.9, category=6, mask=0)
    model, _, _ = finalize(builder, "float32")
    assert model.shape_type.tolist() == [dc.ShapeType.POLYGON]
    assert model.shape_extent == pytest.approx([0.5 + math.sqrt(0.5)])
    corners, normals = model.vertices, model.vertex_normals
    assert corners.tolist() == [[-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5], [0.5, 0.5]]
    assert normals.tolist() == [[-1, 0], [0, -1], [1, 0], [0, 1]]
    assert model.mass == pytest.approx(mass_properties(corners, 0.5).area)
    assert model.shape_friction == pytest.approx([0.1])
    assert model.shape_restitution == pytest.approx([0.9])
    assert (model.shape_category.tolist(), model.shape_mask.tolist()) == ([6], [0])
    assert model.vertices.dtype == np.float32
    assert model.shape_mask.dtype == np.uint32


def test_capsule_fields():
    builder = builder_with_world()
    builder.add_capsule(builder.add_body(), (-1, 0), (1, 0), 0.5)
    model, _, _ = finalize(builder)
    assert model.shape_type.tolist() == [dc.ShapeType.POLYGON]
    assert model.vertices.tolist() == [[-1, 0], [1, 0]]
    assert model.vertex_normals.tolist() == [[0, -1], [0, 1]]
    assert model.shape_extent.tolist() == [1.5]
    assert model.mass == pytest.approx(2 + math.pi / 4)


@pytest.mark.parametrize("closed", [False, True])
def test_chain_segments_know_their_neighbours(closed):
    corners = np.array(((0.0, 2.0), (0.0, 0.0), (4.0, 0.0), (4.0, 3.0)))
    builder = builder_with_world()
    ground = builder.add_body((1, 1), type=dc.BodyType.STATIC)
    shapes = builder.add_chain(ground, corners, closed=closed, friction=0.25)
    n = 4 if closed else 3
    assert shapes.tolist() == list(range(n))
    model, state, _ = finalize(builder)
    assert model.shape_type.tolist() == [dc.ShapeType.SEGMENT] * n
    assert model.shape_friction.tolist() == [0.25] * n
    for i in range(n):
        ends = [i, (i + 1) % 4, i - 1, (i + 2) % 4]
        if not closed:
            ends[2], ends[3] = max(ends[2], 0), min(i + 2, 3)
        assert world_vertices(model, state, i) == pytest.approx(corners[ends] + 1)
        edge = corners[ends[1]] - corners[ends[0]]
        outward = np.array((edge[1], -edge[0])) / np.hypot(*edge)
        normals = model.vertex_normals[4 * i : 4 * i + 4]
        assert normals == pytest.approx(np.array((outward, -outward, (0, 0), (0, 0))))
        middle = model.shape_center[i] + model.center_of_mass[ground]
        assert middle == pytest.approx((corners[ends[0]] + corners[ends[1]]) / 2)
        assert model.shape_extent[i] == pytest.approx(np.hypot(*edge) / 2)


def test_joint_anchors_are_relative_to_the_centre_of_mass():
    builder = builder_with_world()
    a = builder.add_body((0, 0), angle=math.pi / 2)
    b = builder.add_body((3, 0), type=dc.BodyType.STATIC)
    builder.add_box(a, 1, 1, center=(2, 0))
    builder.add_distance_joint(a, b, anchor_a=(4, 0), anchor_b=(0, 0.5))
    builder.add_distance_joint(a, b, length=7.0)
    joints = finalize(builder)[2]
    assert joints.joint_anchor_a == pytest.approx(np.array(((2, 0), (-2, 0))))
    assert joints.joint_anchor_b == pytest.approx(np.array(((0, 0.5), (0, 0))))
    assert joints.joint_length == pytest.approx((math.hypot(3, 3.5), 7.0))  # (0, 4) to (3, 0.5)
    assert joints.joint_body_a.tolist() == [a, a]
    assert joints.joint_body_b.tolist() == [b, b]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_both_backends_hold_the_same(dtype):
    builder = builder_with_world(origin=(1, 2))
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), SQUARE, closed=True)
    a, b = builder.add_discs(((3, 4), (5, 6)), 0.5)
    builder.add_distance_joint(a, b)
    for first, second in zip(builder.finalize(dtype), builder.finalize(dtype, backend="numpy"), strict=True):
        for name in first.table:
            one, other = first.numpy(name), second.numpy(name)
            assert np.array_equal(one, other), name
            assert (one.dtype, one.shape) == (other.dtype, other.shape), name


def test_a_builder_can_go_on_after_finalize():
    builder = builder_with_world()
    builder.add_discs(np.zeros((2, 2)), 1.0)
    first = finalize(builder)[0]
    builder.add_disc(builder.add_body((1, 1)), 2.0)
    second = finalize(builder)[0]
    assert (first.body_count, second.body_count) == (2, 3)
    assert second.shape_radius.tolist() == [1, 1, 2]


def builder_with_bodies():
    """World 0: body 0; world 1: bodies 1 dynamic, 2 static, 3 kinematic; shape 0 on body 0."""
    builder = builder_with_world()
    builder.add_disc(builder.add_body(), 1.0)
    builder.add_world()
    for kind in (dc.BodyType.DYNAMIC, dc.BodyType.STATIC, dc.BodyType.KINEMATIC):
        builder.add_body(type=kind)
    return builder


@pytest.mark.parametrize(
    ("method", "arguments", "options", "message"),
    [
        ("add_world", (), {"gravity": (0, math.nan)}, "gravity\\[1\\] of world 2 .* finite"),
        ("add_world", (), {"origin": (1, 2, 3)}, "origin of world 2 .* two numbers"),
        ("add_world", (), {"length_scale": 0.0}, "length_scale of world 2 is 0.0; .* > 0"),
        ("add_body", ((0, math.inf),), {}, "position\\[1\\] of body 4 .* finite"),
        ("add_body", (), {"angle": math.nan}, "angle of body 4 is nan; it must be finite"),
        ("add_body", (), {"angle": "up"}, "angle of body 4 is 'up'; it must be a number"),
        ("add_body", (), {"velocity": 3}, "velocity of body 4 is 3; it must be two numbers"),
        ("add_body", (), {"angular_velocity": -math.inf}, "angular_velocity of body 4 is -inf"),
        ("add_body", (), {"type": 7}, "type of body 4 is 7; .*STATIC"),
        ("add_body", (), {"mass": 0.0}, "mass of body 4 is 0.0; it must be finite and > 0"),
        ("add_body", (), {"mass": -1}, "mass of body 4 is -1.0"),
        ("add_body", (), {"mass": math.inf}, "mass of body 4 is inf"),
        ("add_body", (), {"inertia": -1e-9}, "inertia of body 4 is -1e-09; it must be finite and >= 0"),
        ("add_body", (), {"type": dc.BodyType.STATIC, "velocity": (1, 0)}, "velocity of body 4 .* static"),
        ("add_body", (), {"type": dc.BodyType.STATIC, "angular_velocity": 1}, "velocity of body 4 .* static"),
        ("add_disc", (1, 0.0), {}, "radius of shape 1 is 0.0; it must be finite and > 0"),
        ("add_disc", (1, math.nan), {}, "radius of shape 1 is nan"),
        ("add_disc", (1, 1), {"center": (math.nan, 0)}, "center\\[0\\] of shape 1 .* finite"),
        ("add_disc", (1, 1), {"density": -1}, "density of shape 1 is -1.0; it must be finite and >= 0"),
        ("add_disc", (1, 1), {"friction": -0.1}, "friction of shape 1 is -0.1"),
        ("add_disc", (1, 1), {"restitution": 1.0000001}, r"restitution of shape 1 is 1.0000001; .* \[0, 1\]"),
        ("add_disc", (1, 1), {"restitution": -0.5}, "restitution of shape 1 is -0.5"),
        ("add_disc", (1, 1), {"category": -1}, "category of shape 1 is -1; .* integer"),
        ("add_disc", (1, 1), {"mask": 2**32}, "mask of shape 1 is 4294967296; .* 4294967295"),
        ("add_disc", (1, 1), {"mask": 0.5}, "mask of shape 1 is 0.5; .* integer"),
        ("add_disc", (4, 1), {}, r"body of shape 1 is 4; it must lie in \[0, 4\)"),
        ("add_disc", (-1, 1), {}, "body of shape 1 is -1"),
        ("add_disc", (1.0, 1), {}, "body of shape 1 is 1.0; it must be an integer"),
        ("add_disc", (0, 1), {}, "body of shape 1 is 0, a body of an earlier world; .* world 1 begin at 1"),
        ("add_box", (1, 0, 1), {}, "half_width of shape 1 is 0.0"),
        ("add_box", (1, 1, -1), {}, "half_height of shape 1 is -1.0"),
        ("add_box", (1, 1, 1), {"radius": -0.1}, "radius of shape 1 is -0.1; it must be finite and >= 0"),
        ("add_box", (1, 1, 1e-9), {}, "corners of shape 1"),
        ("add_polygon", (1, SQUARE[:2]), {}, "vertices of shape 1: 2 points"),
        ("add_polygon", (1, ((0, 0), (1, 0), (1, math.nan))), {}, r"vertices of shape 1\[2, 1\] is nan"),
        ("add_polygon", (1, SQUARE), {"radius": -1}, "radius of shape 1 is -1.0"),
        ("add_capsule", (1, (0, 0), (1, 0), 0), {}, "radius of shape 1 is 0.0"),
        ("add_capsule", (1, (0, 0), (0, 0), 1), {}, "p1 and p2 of shape 1 are 0 m apart"),
        ("add_capsule", (1, (0, 0), (0, math.inf), 1), {}, "p2\\[1\\] of shape 1 .* finite"),
        ("add_chain", (2, SQUARE[:1]), {}, "vertices of shape 1: 1 points; there must be at least 2"),
        ("add_chain", (2, SQUARE[:2]), {"closed": True}, "2 points; there must be at least 3"),
        ("add_chain", (2, ((0, 0), (1, 0), (1, 0))), {}, "vertices of shape 1: 1 and 2 are 0 m apart"),
        ("add_chain", (2, ((0, 0), (1, 0), (0, 0))), {"closed": True}, "vertices of shape 1: 2 and 0 are 0 m"),
        ("add_chain", (2, ((0, 0), (1, math.nan))), {}, r"vertices of shape 1\[1, 1\] is nan"),
        ("add_chain", (2, SQUARE), {"friction": -1}, "friction of shape 1 is -1.0"),
        ("add_distance_joint", (1, 1), {}, "body_a and body_b of joint 0 are both 1"),
        ("add_distance_joint", (0, 1), {}, "body_a of joint 0 is 0, a body of an earlier world"),
        ("add_distance_joint", (1, 9), {}, r"body_b of joint 0 is 9; it must lie in \[0, 4\)"),
        ("add_distance_joint", (2, 3), {}, "body_a and body_b of joint 0 are 2 and 3; .* DYNAMIC"),
        ("add_distance_joint", (1, 2), {}, "length of joint 0 is 0.0; it must be finite and > 0"),
        ("add_distance_joint", (1, 2), {"length": -1}, "length of joint 0 is -1.0"),
        ("add_distance_joint", (1, 2), {"anchor_a": (math.nan, 0)}, "anchor_a\\[0\\] of joint 0 .* finite"),
        ("add_discs", (((0, 0), (0, math.nan)), 1), {}, r"positions\[1, 1\] is nan"),
        ("add_discs", (np.zeros((2, 3)), 1), {}, r"positions: has shape \(2, 3\)"),
        ("add_discs", (np.zeros((3, 2)), (1, 1, 0)), {}, r"radius\[2\] is 0.0; it must be finite and > 0"),
        ("add_discs", (np.zeros((3, 2)), (1, 1)), {}, r"radius has shape \(2,\)"),
        ("add_discs", (np.zeros((3, 2)), -1), {}, "radius of the discs is -1.0"),
        ("add_discs", (np.zeros((3, 2)), 1), {"velocity": np.zeros((2, 2))}, r"velocity has shape \(2, 2\)"),
        ("add_discs", (np.zeros((1, 2)), 1), {"velocity": ((0, math.inf),)}, r"velocity\[0, 1\] is inf"),
        ("add_discs", (np.zeros((2, 2)), 1), {"friction": (0, -1)}, r"friction\[1\] is -1.0"),
        ("add_discs", (np.zeros((2, 2)), 1), {"restitution": (0, 2)}, r"restitution\[1\] is 2.0"),
        ("add_discs", (np.zeros((2, 2)), 1), {"mask": (0, 1.5)}, r"mask\[1\] is 1.5; .* integer"),
        ("add_discs", (np.zeros((2, 2)), 1), {"angle": (0, math.nan)}, r"angle\[1\] is nan; it must be finite"),
    ],
)
def test_wrong_arguments_are_named_and_leave_nothing_behind(method, arguments, options, message):
    builder, untouched = builder_with_bodies(), builder_with_bodies()
    with pytest.raises(ValueError, match=message):
        getattr(builder, method)(*arguments, **options)
    for b in (builder, untouched):
        b.add_disc(1, 1.0)
    for one, other in zip(finalize(builder), finalize(untouched), strict=True):
        for name in one.table:
            assert np.array_equal(one.numpy(name), other.numpy(name)), name


@pytest.mark.parametrize(
    ("method", "arguments", "wrong", "message"),
    [
        ("add_box", (1, 0.5, 0.5), "centre", r"shape 1 \(did you mean center\?\); beside its own .* density, friction"),
        ("add_disc", (1, 0.5), "fricton", r"shape 1 \(did you mean friction\?\)"),
        ("add_chain", (1, SQUARE), "loop", "shape 1; beside"),
        ("add_chain", (1, SQUARE), "radius", "shape 1; beside"),
        ("add_revolute_joint", (1, 2), "anchor", r"joint 0 \(did you mean anchor_a or anchor_b\?\); .* break_force"),
    ],
)
def test_misspelt_keywords_are_named(method, arguments, wrong, message):
    with pytest.raises(TypeError, match=f"'{wrong}' is no keyword of {message}"):
        getattr(builder_with_bodies(), method)(*arguments, **{wrong: 0.0})


@pytest.mark.parametrize(
    "add", [lambda b: b.add_body(), lambda b: b.add_discs(((0, 0),), 1), lambda b: b.add_disc(0, 1), finalize]
)
def test_no_world_yet(add):
    with pytest.raises(ValueError, match="add_world"):
        add(dc.ModelBuilder())


def test_dynamic_bodies_need_a_mass():
    builder = builder_with_world()
    builder.add_disc(builder.add_body(), 1.0)
    builder.add_body()
    with pytest.raises(ValueError, match="mass of body 1 is not given and it has no shape"):
        finalize(builder)
    builder.add_disc(1, 1.0, density=0.0)
    with pytest.raises(ValueError, match="mass of body 1 is not given and the densities of its shapes are zero"):
        finalize(builder)


def test_too_many_shapes_for_the_contact_keys(monkeypatch):
    monkeypatch.setattr(assemble, "KEY_SHAPE_BITS", 2)
    builder = builder_with_world()
    builder.add_discs(np.zeros((4, 2)), 1.0)
    builder.add_world()
    builder.add_discs(np.zeros((4, 2)), 1.0)
    finalize(builder)
    builder.add_disc(builder.add_body(), 1.0)
    with pytest.raises(ValueError, match="world 1 has 5 shapes; at most 4"):
        finalize(builder)


def test_values_that_float32_cannot_hold():
    builder = builder_with_world()
    builder.add_body(mass=1.0)
    builder.add_body(mass=1e39)
    finalize(builder)
    with pytest.raises(ValueError, match=r"mass\[1\] is inf; it must be finite"):
        finalize(builder, "float32")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dtype": "float16"}, "dtype is 'float16'"),
        ({"backend": "jax"}, "backend is 'jax'"),
        ({"backend": "numpy", "device": "cuda:0"}, "device is 'cuda:0'"),
    ],
)
def test_unknown_dtype_backend_or_device(options, message):
    builder = builder_with_world()
    with pytest.raises(ValueError, match=message):
        builder.finalize(**options)


def test_what_underflows_the_dtype_is_named():
    """A radius that float64 holds is 0 in float32."""
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    builder.add_disc(builder.add_body(mass=1.0, inertia=1.0), 1e-60)
    builder.finalize("float64", backend="numpy")
    with pytest.raises(ValueError, match=r"model\.shape_radius\[0\] is 0\.0; it must be > 0"):
        builder.finalize("float32", backend="numpy")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_masses_whose_inverses_add_up_beyond_float32_are_refused(dtype):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body(mass=1.0), 0.5)
    builder.add_disc(builder.add_body(mass=1.2e-38, inertia=1.0), 0.5)
    with pytest.raises(ValueError, match=r"inv_mass\[1\] is 8\.3.*e\+37; it must be in \[0, 8e\+37\]"):
        dc.Simulation(*builder.finalize(dtype))


def similar_world(gravity=(0.0, -9.8), origin=(0.0, 0.0), at=0.0, friction=0.5, half_width=0.5, arm=0.2, **traits):
    """A chain, a box and a disc on a hinge; what is given is all that differs."""
    builder = builder_with_world(gravity=gravity, origin=origin)
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(4.0, 0.0), (-4.0, 0.0)])
    box = builder.add_body((at, 1.0), angle=0.3 + at, velocity=(at, 1.0), angular_velocity=2.0)
    builder.add_box(box, half_width, 0.5, center=(0.1, 0.0), friction=friction)
    disc = builder.add_discs([(at + 1.0, 2.0)], 0.5, **traits)
    builder.add_revolute_joint(box, int(disc[0]), (at + arm, 1.5))
    return builder


SIMILAR = [
    {"at": 1.5},
    {"gravity": (1.0, -9.8)},
    {"origin": (3.0, 4.0)},
    {"friction": 0.25},
    {"half_width": 0.75},
    {"arm": 0.4},
    {"linear_damping": 0.5},
    {"linear_damping": 0.25},
    {"sensor": True},
    {"at": -1.0, "surface_speed": 0.5},
]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_is_like_a_scene_before_is_made_as_if_it_was_the_first(dtype):
    """Models of equal tables are copied from what is remembered; that holds what it would if nothing was."""
    for given_now in (*SIMILAR, *SIMILAR):  # twice, as the first time something else is remembered
        groups = similar_world(**given_now).finalize(dtype, backend="numpy")
        remembered = dict(known._made)
        known._made.clear()
        anew = similar_world(**given_now).finalize(dtype, backend="numpy")
        known._made.update(remembered)
        for group, other in zip(groups, anew, strict=True):
            assert group.sizes == other.sizes
            for name, values in group.views().items():
                assert values.tobytes() == other.numpy(name).tobytes(), (given_now, name)


def test_what_is_written_to_a_model_is_not_in_the_next_one():
    one = similar_world().finalize(backend="numpy")[0]
    one.assign("shape_friction", np.full(one.shape_count, 0.75))
    one.sizes["body"] = 7
    two = similar_world().finalize(backend="numpy")[0]
    assert (two.numpy("shape_friction") == 0.5).all()
    assert two.body_count == 3


def test_a_model_that_differs_from_one_before_is_looked_at_and_weighed_anew():
    """Simulations share what was worked out of models that hold the same, and of no others."""
    model, state, joints = similar_world().finalize(backend="numpy")
    first = dc.Simulation(model.copy(), state.copy(), joints.copy())
    model.assign("gravity", [(0.0, -4.9)])
    second = dc.Simulation(model.copy(), state.copy(), joints.copy())
    assert second.motion.numpy("weight")[0] == pytest.approx(first.motion.numpy("weight")[0] / 2)
    model.memory("shape_radius")[-1] = -1.0
    with pytest.raises(ValueError, match=r"model\.shape_radius\[2\] is -1\.0"):
        dc.Simulation(model, state, joints)


def test_what_is_remembered_has_a_bound():
    for i in range(50):
        builder = builder_with_world()
        builder.add_discs(np.stack([2.0 * np.arange(1000.0), np.zeros(1000)], axis=1), 0.5, friction=i / 64)
        finalize(builder)
    for memory in (known._made, known._right):
        assert 0 < memory.bytes <= known.MOST
        assert sum(len(part) for key in memory for part in key if isinstance(part, bytes)) <= known.MOST
        assert len(memory) < 50
