"""Contact points against conventions and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc
from tests.collide.hulls import (
    DT,
    STATIC,
    box,
    capsule,
    collide,
    colliding,
    disc,
    new_world,
    random_hull,
    random_meeting,
    two,
)
from tests.geometry import (
    contacts_of,
    inside,
    rotation,
    simulate,
)

seeds = st.integers(0, 2**32 - 1)


# ---------------------------------------------------------------------- conventions


def test_normal_points_from_the_first_body_to_the_second():
    table = two(disc(0.5), disc(0.25), ((3, 1), 0), ((3, 1.75), 0))
    assert table["body_a"].tolist() == [0]
    assert table["body_b"].tolist() == [1]
    assert np.allclose(table["normal"], [(0, 1)])


@pytest.mark.parametrize("kind", [dc.BodyType.KINEMATIC, dc.BodyType.DYNAMIC])
def test_a_is_the_static_body_or_the_lower_index(kind):
    builder = new_world()
    builder.add_disc(builder.add_body((0, 0)), 0.5)
    builder.add_disc(builder.add_body((1, 0), type=kind), 0.5)
    builder.add_disc(builder.add_body((0, 1), type=STATIC), 0.5)
    table = contacts_of(collide(builder))
    met = {(int(a), int(b)): n for a, b, n in zip(table["body_a"], table["body_b"], table["normal"], strict=True)}
    assert met.keys() == {(0, 1), (2, 0)}
    assert np.allclose(met[0, 1], (1, 0))
    assert np.allclose(met[2, 0], (0, -1))


def test_a_positive_tangential_impulse_pushes_b_along_the_normal_turned_by_minus_90_degrees():
    builder = new_world()
    builder.add_box(builder.add_body((0, -1), type=STATIC), 5, 1)
    # slides to the left over the floor, so friction on B points to the right: n = (0, 1), t = (n_y, -n_x) = (1, 0)
    builder.add_box(builder.add_body((0, 0.5), velocity=(-1, -1)), 0.5, 0.5)
    sim = simulate(builder)
    sim.step(DT)
    table = contacts_of(sim)
    assert np.allclose(table["normal"], (0, 1))
    assert (table["impulse"][:, 0] > 0).all()
    assert (table["impulse"][:, 1] > 0).all()
    assert sim.state.numpy("velocity")[1, 0] > -1


def test_the_contact_point_is_the_same_from_both_bodies():
    rng = np.random.default_rng(3)
    sim = colliding(random_meeting(rng, gap=0.01) for _ in range(50))
    x = sim.state.numpy("position")
    for w in range(50):
        table = contacts_of(sim, w)
        assert len(table["gap"])
        assert np.allclose(x[table["body_a"]] + table["arm_a"], x[table["body_b"]] + table["arm_b"])


# ---------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_disc_on_disc(dtype):
    direction = np.array((0.6, 0.8))
    for gap in (0.015, 0.0, -0.3):
        table = two(disc(0.5), disc(0.25), ((1, 2), 1), ((1, 2) + (0.75 + gap) * direction, 2), dtype=dtype)
        assert table["gap"] == pytest.approx([gap], abs=1e-6)
        assert np.allclose(table["normal"], direction, atol=1e-6)
        assert np.allclose(table["point"], (1, 2) + (0.5 + gap / 2) * direction, atol=1e-6)


def test_disc_off_the_centre_of_its_body_turns_with_it():
    builder = new_world()
    body = builder.add_body((0, 0), math.pi / 2)
    builder.add_disc(body, 0.5, (1, 0))
    builder.add_disc(body, 0.5, (-1, 0))
    builder.add_disc(builder.add_body((0, 2)), 0.5)
    table = contacts_of(collide(builder))
    assert table["gap"] == pytest.approx([0.0], abs=1e-12)
    assert np.allclose(table["normal"], (0, 1))
    assert np.allclose(table["arm_a"], (0, 1.5))


@pytest.mark.parametrize("radius", [0.0, 0.1])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_disc_on_box(radius, dtype):
    turn = 0.7
    for at, normal, gap in (
        ((0.3, 0.5 + radius + 0.25 + 0.01), (0, 1), 0.01),
        ((-1.0 - radius - 0.25 + 0.05, 0.2), (-1, 0), -0.05),
        ((1 + 0.6 * (radius + 0.26), 0.5 + 0.8 * (radius + 0.26)), (0.6, 0.8), 0.01),  # beyond a corner
        ((0.1, 0.45), (0, 1), -0.05 - radius - 0.25),  # the centre inside, nearest to the top
        ((-0.9, 0.0), (-1, 0), -0.1 - radius - 0.25),  # nearest to the left
    ):
        center = rotation(turn) @ at
        table = two(box(1, 0.5, radius), disc(0.25), ((0, 0), turn), (center, 0.0), dtype=dtype)
        n = rotation(turn) @ normal
        assert table["gap"] == pytest.approx([gap], abs=2e-6)
        assert np.allclose(table["normal"], n, atol=2e-6)
        assert np.allclose(table["point"], center - n * (0.25 + gap / 2), atol=2e-6)


def test_disc_on_capsule():
    for at, normal, gap in (
        ((0.4, 0.36), (0, 1), 0.01),
        ((-0.4, -0.3), (0, -1), -0.05),
        ((1 + 0.6 * 0.3, 0.8 * 0.3), (0.6, 0.8), -0.05),
        ((-1.34, 0), (-1, 0), -0.01),  # on the line of the two ends
    ):
        table = two(capsule(1, 0.1), disc(0.25), b=(at, 0.0))
        assert table["gap"] == pytest.approx([gap], abs=1e-12)
        assert np.allclose(table["normal"], normal)
        assert np.allclose(table["point"], np.array(at) - np.array(normal) * (0.25 + gap / 2))


def test_disc_on_a_chain_segment_from_either_side():
    for side in (1, -1):
        table = two(
            lambda builder, body: builder.add_chain(body, [(-1, 0), (1, 0)]),
            disc(0.25),
            b=((0.3, 0.24 * side), 0.0),
            type=STATIC,
        )
        assert table["gap"] == pytest.approx([-0.01])
        assert np.allclose(table["normal"], (0, side))
        assert np.allclose(table["point"], (0.3, -0.005 * side))


@given(seeds)
def test_disc_deep_in_a_polygon_leaves_through_the_nearest_edge(seed):
    rng = np.random.default_rng(seed)
    points, radius = random_hull(rng, low=3)
    center = points.mean(axis=0) + rng.uniform(-0.3, 0.3, 2)
    if not inside(center, points):
        return
    builder = new_world()
    builder.add_polygon(builder.add_body(), points, radius)
    builder.add_disc(builder.add_body(center), 0.1)
    table = contacts_of(collide(builder))
    edges = np.roll(points, -1, axis=0) - points
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.hypot(*edges.T)[:, None]
    depth = ((center - points) * normals).sum(axis=1)
    assert table["gap"] == pytest.approx([depth.max() - radius - 0.1])
    best = normals[np.isclose(depth, depth.max(), atol=1e-9)]
    assert min(np.abs(best - table["normal"]).max(axis=1)) < 1e-9


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("radius", [0.0, 0.1])
@pytest.mark.parametrize("gap", [0.01, -0.01])
def test_box_on_box_touches_at_two_points(radius, gap, dtype):
    table = two(box(2, 0.5, radius), box(1, 0.5, radius), b=((0.3, 1 + 2 * radius + gap), 0.0), dtype=dtype)
    assert table["gap"] == pytest.approx([gap, gap], abs=1e-6)
    assert np.allclose(table["normal"], (0, 1), atol=1e-6)
    order = np.argsort(table["point"][:, 0])
    expected = np.array([(-0.7, 0.5 + radius + gap / 2), (1.3, 0.5 + radius + gap / 2)])
    assert np.allclose(table["point"][order], expected, atol=1e-6)


def test_tilted_box_has_a_gap_at_each_end_of_its_edge():
    tilt = 0.01
    center = np.array((0.0, 0.5)) + rotation(tilt) @ (0, 0.5)
    table = two(box(2, 0.5), box(1, 0.5), b=(center, tilt))
    order = np.argsort(table["point"][:, 0])
    assert table["gap"][order] == pytest.approx([-math.sin(tilt), math.sin(tilt)], abs=1e-9)


def test_parallel_capsules_touch_at_two_points():
    table = two(capsule(1, 0.2), capsule(1, 0.1), b=((0.5, 0.31), 0.0))
    assert table["gap"] == pytest.approx([0.01, 0.01])
    assert np.allclose(table["normal"], (0, 1))
    order = np.argsort(table["point"][:, 0])
    assert np.allclose(table["point"][order], [(-0.5, 0.205), (1, 0.205)])


@pytest.mark.parametrize("angle", [0.3, math.pi / 2, 2.0])
def test_crossing_capsules_are_pushed_apart_by_the_shorter_way(angle):
    ends = rotation(angle) @ np.array([(-1, 1), (0, 0)]) + np.array([(0.0,), (0.8 * math.sin(angle),)])
    table = two(capsule(1, 0.2), capsule(1, 0.1), b=((0, 0.8 * math.sin(angle)), angle))
    # lifting the lower end of B out of A: the end lies 0.2 sin(angle) below the axis of A
    assert table["gap"].min() == pytest.approx(ends[1].min() - 0.3)
    assert np.allclose(table["normal"], (0, 1))


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_capsules_end_to_end(offset):
    distance = math.hypot(0.3 + 0.01, offset)
    table = two(capsule(1, 0.2), capsule(0.5, 0.1), b=((1 + 0.31 + 0.5, offset), 0.0))
    assert table["gap"] == pytest.approx([distance - 0.3])
    assert np.allclose(table["normal"], np.array([(0.31, offset)]) / distance)


def test_capsule_standing_on_a_box():
    table = two(box(1, 0.5), capsule(0.5, 0.1), b=((0.3, 0.5 + 0.6 + 0.01), math.pi / 2))
    assert table["gap"].min() == pytest.approx(0.01)
    assert np.allclose(table["normal"], (0, 1))


# ---------------------------------------------------------------------- coincident


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("add", [disc(0.5), box(1, 1), box(1, 0.5, 0.1), capsule(1, 0.1)])
def test_coincident_bodies_get_a_finite_normal_and_move_apart(add, dtype):
    for pose in (((0, 0), 0.0), ((1, -2), 0.5)):
        first, again = (two(add, add, pose, pose, dtype=dtype) for _ in range(2))
        assert len(first["gap"])
        assert np.allclose(np.hypot(*first["normal"].T), 1, atol=1e-6)
        assert (first["gap"] < -0.1).all()
        assert all(np.array_equal(first[name], again[name]) for name in first)

    builder = new_world()
    for _ in range(3):
        add(builder, builder.add_body((2, 3)))
    sim = simulate(builder, dtype)
    before = contacts_of(sim)["gap"]
    sim.run(60, 1 / 60)
    assert np.isfinite(sim.state.numpy("position")).all()
    assert not len(before)
    assert not sim.state.numpy("flags").any()
    apart = sim.state.numpy("position")[1:] - sim.state.numpy("position")[:-1]
    assert (np.hypot(*apart.T) > 0.05).any()
