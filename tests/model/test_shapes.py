"""Mass properties against independent sums, and what is not a convex polygon."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels.model.shapes import box_vertices, convex_polygon, edge_normals, mass_properties

real = st.floats(-10, 10)
positive = st.floats(0.1, 10)
angles = st.floats(-math.pi, math.pi)


@st.composite
def polygons(draw, least=3, most=8):
    """Convex polygons, counter-clockwise: corners on a turned ellipse away from the origin."""
    n = draw(st.integers(least, most))
    steps = np.array(draw(st.lists(st.floats(1, 3), min_size=n, max_size=n)))
    angle = np.cumsum(steps) / steps.sum() * 2 * math.pi
    a, b = draw(positive), draw(positive)
    ellipse = np.stack((a * np.cos(angle), b * np.sin(angle)), axis=1)
    return moved(ellipse, draw(angles), draw(real), draw(real))


def moved(vertices, angle, x=0.0, y=0.0):
    c, s = math.cos(angle), math.sin(angle)
    return vertices @ np.array(((c, s), (-s, c))) + np.array((x, y))


def combined(parts):
    """Area, centroid and inertia of shapes side by side (parallel axis theorem)."""
    area = sum(p.area for p in parts)
    centroid = sum(p.area * p.centroid for p in parts) / area
    return area, centroid, sum(p.inertia + p.area * ((p.centroid - centroid) ** 2).sum() for p in parts)


def assert_same(found, expected, rel=1e-9):
    area, centroid, inertia = expected
    assert found.area == pytest.approx(area, rel=rel)
    assert found.centroid == pytest.approx(centroid, rel=rel, abs=rel * math.sqrt(area))
    assert found.inertia == pytest.approx(inertia, rel=rel)


class Part:
    def __init__(self, area, centroid, inertia):
        self.area, self.centroid, self.inertia = area, np.array(centroid), inertia


@given(polygons())
def test_polygon_is_the_sum_of_its_triangles(vertices):
    parts = []
    for b, c in pairwise(vertices[1:]):
        sides = np.array((b - vertices[0], c - b, vertices[0] - c))
        area = (sides[0][0] * sides[1][1] - sides[0][1] * sides[1][0]) / 2
        parts.append(Part(area, (vertices[0] + b + c) / 3, area * (sides**2).sum() / 36))
    assert_same(mass_properties(vertices), combined(parts))


@given(polygons(), st.integers(0, 7))
def test_cut_polygon_is_the_sum_of_its_halves(vertices, i):
    n = len(vertices)
    vertices = np.roll(vertices, i, axis=0)
    middle = (vertices[n // 2] + vertices[(n // 2 + 1) % n]) / 2  # cut from vertex 0 to the middle of an edge
    left = mass_properties(np.vstack((vertices[: n // 2 + 1], middle)))
    right = mass_properties(np.vstack((vertices[:1], middle, vertices[n // 2 + 1 :])))
    assert_same(mass_properties(vertices), combined((left, right)))


@given(positive, positive, positive)
def test_rounded_box_is_rectangles_and_quarter_discs(a, b, r):
    quarter, reach = math.pi * r**2 / 4, 4 * r / (3 * math.pi)
    corner = math.pi * r**4 / 8 - quarter * 2 * reach**2
    tall = 4 * a * (b + r)
    parts = [Part(tall, (0, 0), tall * (4 * a**2 + 4 * (b + r) ** 2) / 12)]
    parts += [Part(2 * b * r, (x * (a + r / 2), 0), 2 * b * r * (4 * b**2 + r**2) / 12) for x in (-1, 1)]
    parts += [Part(quarter, (x * (a + reach), y * (b + reach)), corner) for x in (-1, 1) for y in (-1, 1)]
    assert_same(mass_properties(box_vertices(a, b), r), combined(parts))


@given(positive, positive, angles)
def test_capsule_is_a_rectangle_and_half_discs(half, r, angle):
    disc, reach = math.pi * r**2 / 2, 4 * r / (3 * math.pi)
    end = math.pi * r**4 / 4 - disc * reach**2
    box = 4 * half * r
    parts = [Part(box, (0, 0), box * (4 * half**2 + 4 * r**2) / 12)]
    parts += [Part(disc, (x * (half + reach), 0), end) for x in (-1, 1)]
    area, _, inertia = combined(parts)
    found = mass_properties(moved(np.array(((-half, 0.0), (half, 0.0))), angle, 3, -4), r)
    assert_same(found, (area, np.array((3, -4)), inertia))


@given(real, real, positive)
def test_disc(x, y, r):
    found = mass_properties(np.array(((x, y),)), r)
    assert found.centroid.tolist() == [x, y]  # to the last bit
    assert found.area == pytest.approx(math.pi * r**2)
    assert found.inertia == pytest.approx(math.pi * r**4 / 2)


@given(polygons(), positive)
def test_rounding_is_the_limit_of_many_corners(vertices, r):
    # each corner as an arc of m edges: area and inertia are short by O(1/m^2)
    m = 200
    normals = edge_normals(vertices)
    first = np.arctan2(*np.roll(normals, 1, axis=0).T[::-1])
    turn = (np.arctan2(*normals.T[::-1]) - first) % (2 * math.pi)
    angle = first[:, None] + turn[:, None] * np.linspace(0, 1, m + 1)
    arcs = vertices[:, None] + r * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    found, coarse = mass_properties(vertices, r), mass_properties(arcs.reshape(-1, 2))
    assert_same(found, coarse, rel=1e-4)
    perimeter = np.hypot(*(np.roll(vertices, -1, axis=0) - vertices).T).sum()  # Steiner's formula
    assert found.area == pytest.approx(mass_properties(vertices).area + perimeter * r + math.pi * r**2)


@given(polygons(), st.floats(0, 5), angles, real, real)
def test_turning_and_shifting_moves_the_centroid_only(vertices, r, angle, x, y):
    before = mass_properties(vertices, r)
    after = mass_properties(moved(vertices, angle, x, y), r)
    assert_same(after, (before.area, moved(before.centroid, angle, x, y), before.inertia))


@given(polygons(), st.floats(0, 5), st.floats(1e-3, 1e3))
def test_scaling(vertices, r, scale):
    before = mass_properties(vertices, r)
    after = mass_properties(vertices * scale, r * scale)
    assert_same(after, (before.area * scale**2, before.centroid * scale, before.inertia * scale**4))


def test_far_from_the_origin_nothing_is_lost():
    near, far = mass_properties(box_vertices(1, 2), 0.5), mass_properties(box_vertices(1, 2, (2.0**30, 0.0)), 0.5)
    assert_same(far, (near.area, (2.0**30, 0.0), near.inertia), rel=1e-14)


@given(st.lists(polygons(5, 5), min_size=1, max_size=3), positive)
def test_a_batch_equals_one_by_one(batch, r):
    together = mass_properties(np.array(batch), np.full(len(batch), r))
    for i, vertices in enumerate(batch):
        one = mass_properties(vertices, r)
        assert [part[i].tolist() for part in together] == [part.tolist() for part in one]


@given(polygons())
def test_normals_are_unit_and_point_outward(vertices):
    edges = np.roll(vertices, -1, axis=0) - vertices
    normals = edge_normals(vertices)
    assert np.hypot(*normals.T) == pytest.approx(1)
    assert (normals * edges).sum(1) == pytest.approx(0, abs=1e-12)
    others = vertices[None] - vertices[:, None]  # [edge, vertex]: all lie behind each edge
    assert ((others * normals[:, None]).sum(-1) <= 1e-12).all()


def test_normals_of_a_line_and_a_point():
    line = edge_normals(np.array(((0.0, 0.0), (2.0, 0.0))))
    assert line.tolist() == [[0, -1], [0, 1]]
    assert edge_normals(np.array(((3.0, 4.0),))).tolist() == [[0, 0]]


@given(polygons(), st.booleans())
def test_order_becomes_counter_clockwise_from_the_first_vertex(vertices, clockwise):
    vertices = convex_polygon(vertices)
    given = np.roll(vertices[::-1], 1, axis=0) if clockwise else vertices
    assert convex_polygon(given).tolist() == vertices.tolist()
    assert mass_properties(vertices).area > 0


@given(positive, positive, real, real, angles)
def test_box_corners(a, b, x, y, angle):
    corners = moved(np.array(((-a, -b), (a, -b), (a, b), (-a, b))), angle, x, y)
    assert box_vertices(a, b, (x, y), angle) == pytest.approx(corners)
    assert convex_polygon(corners).tolist() == corners.tolist()


STAR = [(math.cos(0.8 * math.pi * i), math.sin(0.8 * math.pi * i)) for i in range(5)]


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ([(0, 0), (1, 0), (2, 0), (0, 1)], [0, 2, 3]),
        ([(0, 0), (1, 1e-7), (2, 0), (0, 1)], [0, 2, 3]),
        ([(0, 0), (1, -1e-7), (2, 0), (0, 1)], [0, 2, 3]),
        ([(1, 0), (2, 0), (0, 1), (0, 0)], [1, 2, 3]),
        ([(0, 0), (0, 1), (2, 0), (1, 0)], [0, 1, 2]),
        ([(0, 0), (1, 1e-5), (2, 0), (0, -1)], [0, 1, 2, 3]),
    ],
)
def test_a_vertex_on_the_line_between_its_neighbours_is_left_out(given, kept):
    corners = convex_polygon(given)
    assert {tuple(p) for p in corners.tolist()} == {tuple(map(float, given[i])) for i in kept}
    assert np.allclose(corners[0], given[kept[0]], rtol=0, atol=0)


def test_a_polygon_may_have_more_points_than_corners():
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    sides = np.concatenate(
        [a + (b - a) * np.linspace(0, 1, 10)[:-1, None] for a, b in zip(square, np.roll(square, -1, 0))]
    )
    assert len(sides) == 36
    assert convex_polygon(sides).tolist() == square.tolist()
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_polygon(builder.add_body(), sides, density=2.0)
    model, _, _ = builder.finalize("float64")
    assert model.numpy("vertex_start").tolist() == [0, 4]
    assert model.numpy("mass") == pytest.approx([2.0])


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([], "0 points; there must be 3 to 8"),
        ([(0, 0), (1, 0)], "2 points; there must be 3 to 8"),
        ([(math.cos(i), math.sin(i)) for i in np.arange(9) * 0.69], "9 points; there must be 3 to 8"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], r"shape \(3, 3\)"),
        ([0, 1, 2], r"shape \(3,\)"),
        ("abc", "it must be numbers"),
        ([(0, 0), (1, math.nan), (0, 1)], r"vertices\[1, 1\] is nan; it must be finite"),
        ([(0, 0), (1, 0), (-math.inf, 1)], r"vertices\[2, 0\] is -inf; it must be finite"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], r"vertices\[2\] .* repeats vertices\[1\]"),
        ([(0, 0), (1, 0), (0, 1), (1e-7, 0)], r"vertices\[3\] .* repeats vertices\[0\]"),
        ([(5, 5)] * 3, r"vertices\[1\] .* repeats vertices\[0\]"),
        ([(0, 0), (2, 0), (1, 0), (1, 1)], r"vertices\[1\] is the tip of a side that runs back"),
        ([(0, 0), (1, 0), (2, 0), (2, 1), (1, 0.2), (0, 1)], r"vertices\[4\] is a concave corner"),
        ([(0, 0), (1, 1), (2, 2)], "zero area"),
        ([(0, 0), (1, 0), (2, 1e-7)], "zero area"),
        ([(0, 0), (2, 0), (2, 2), (1, 0.5)], r"vertices\[3\] is a concave corner"),
        ([(1, 0.5), (2, 2), (2, 0), (0, 0)], r"vertices\[0\] is a concave corner"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "intersects itself"),
        (STAR, "intersects itself"),
    ],
)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_not_a_convex_polygon(vertices, message, scale):
    if isinstance(vertices, list):
        vertices = (np.array(vertices) * scale).tolist()
    with pytest.raises(ValueError, match=message):
        convex_polygon(vertices)


def test_slightly_more_than_the_tolerance_is_a_polygon():
    assert len(convex_polygon([(0, 0), (1, -1e-5), (2, 0), (0, 1)])) == 4
    assert len(convex_polygon([(0, 0), (1, 0), (0, 1), (-1e-5, 1e-5)])) == 4
