"""Points spread over bodies, and the nodes that walls cover."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.grid.area import ARC_STEP, area_points, center_points, hull_distance, shape_points, wall_nodes
from dc_kernels.grid.grid import Grid
from dc_kernels.model.shapes import box_vertices, edge_normals, mass_properties
from pipeline import scenes

TRIANGLE = np.array([(0.0, 0.0), (1.3, 0.2), (0.4, 0.9)])
OCTAGON = np.stack([np.cos(np.arange(8) * math.pi / 4), np.sin(np.arange(8) * math.pi / 4)], axis=1)
SHAPES = {
    "disc": (np.array([(0.2, -0.1)]), 0.5),
    "capsule": (np.array([(-0.4, 0.1), (0.5, 0.3)]), 0.3),
    "triangle": (TRIANGLE, 0.0),
    "tilted box": (box_vertices(0.7, 0.2, (0.1, 0.4), 0.3), 0.0),
    "rounded box": (box_vertices(0.6, 0.3), 0.15),
    "rounded triangle": (TRIANGLE, 0.4),
    "octagon": (OCTAGON, 0.0),
    "sliver": (np.array([(0.0, 0.0), (2.0, 1.0), (1.999, 1.001)]), 0.0),
}


@pytest.mark.parametrize("spacing", [0.1, 0.25, 3.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_cells_have_the_moments_of_the_shape(shape, spacing):
    vertices, radius = SHAPES[shape]
    points, areas = shape_points(vertices, radius, spacing)
    exact = mass_properties(vertices, radius)
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(exact.area, rel=1e-13)
    assert areas @ points / exact.area == pytest.approx(exact.centroid, abs=1e-13)
    # the second moment lacks the cells' own, at most a^2 / 6 for each unit of area
    away = points - exact.centroid
    lost = (exact.inertia - areas @ (away * away).sum(axis=1)) / exact.area
    chords = 1e-3 * radius**2  # arcs are chords
    assert -chords <= lost <= spacing**2 / 6 + chords
    if spacing < 1:
        assert lost > 0
    # a cell's centroid is a point of the shape
    distance = hull_distance(points, vertices)
    assert (distance <= radius * (1 + 1e-3) + 1e-6).all()


def test_cells_of_a_polygon_are_those_of_clipping():
    """Against clipping by half-planes, cell by cell."""

    def clip(polygon, normal, offset):
        kept = []
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0)):
            da, db = a @ normal - offset, b @ normal - offset
            if da <= 0:
                kept.append(a)
            if da * db < 0:
                kept.append(a + (b - a) * da / (da - db))
        return np.array(kept).reshape(-1, 2)

    points, areas = shape_points(TRIANGLE, 0.0, 0.25)
    low, size = TRIANGLE.min(axis=0), np.ptp(TRIANGLE, axis=0)
    cells = np.ceil(size / 0.25).astype(int)
    width = size / cells
    expected = []
    for i in range(cells[0]):
        for j in range(cells[1]):
            piece = TRIANGLE
            for axis, k in ((0, i), (1, j)):
                normal = np.eye(2)[axis]
                piece = clip(piece, normal, low[axis] + (k + 1) * width[axis])
                piece = clip(piece, -normal, -(low[axis] + k * width[axis])) if len(piece) else piece
            if len(piece) > 2:
                properties = mass_properties(piece)
                if properties.area > 1e-9:
                    expected.append((*properties.centroid, properties.area))
    assert np.column_stack([points, areas]) == pytest.approx(np.array(expected), abs=1e-12)


def test_a_disc_has_cells_of_equal_area_and_an_isotropic_second_moment():
    points, areas = shape_points(np.zeros((1, 2)), 0.5, 0.25)
    assert len(points) == 16
    assert np.ptp(areas) == 0
    second = (areas[:, None, None] * points[:, :, None] * points[:, None, :]).sum(axis=0)
    assert second[0, 1] == pytest.approx(0.0, abs=1e-16)
    assert second[0, 0] == pytest.approx(second[1, 1], rel=1e-14)


def test_chords_keep_to_the_stated_distance():
    assert 1.0 - math.cos(ARC_STEP / 2) < 3.1e-4
    assert edge_normals(OCTAGON).shape == (8, 2)


def compound(dtype="float64"):
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 0), (1, 0)])
        dumbbell = builder.add_body((3.0, 4.0), angle=0.7)
        builder.add_disc(dumbbell, 0.4, (-1.0, 0.0))
        builder.add_box(dumbbell, 1.0, 0.1)
        builder.add_disc(dumbbell, 0.6, (1.0, 0.2))
        builder.add_body((9.0, 9.0), mass=2.0)  # a point mass
        builder.add_box(builder.add_body(type=dc.BodyType.KINEMATIC), 0.5, 0.5)
        builder.add_body((1.0, 1.0), type=dc.BodyType.KINEMATIC)
        builder.add_capsule(builder.add_body(type=dc.BodyType.STATIC), (0, 0), (1, 0), 0.2)
        builder.add_discs([(5.0, 5.0), (7.0, 5.0)], 0.5)
    return builder.finalize(dtype)


def test_a_body_of_several_shapes_weighs_one_about_its_centre_of_mass():
    model, _, _ = compound()
    cells = area_points(model, 0.1)
    assert (np.diff(cells.body) >= 0).all()
    total = np.bincount(cells.body, cells.weight, model.body_count)
    dynamic = model.numpy("body_type") == dc.BodyType.DYNAMIC
    np.testing.assert_allclose(total, dynamic, atol=1e-13)
    for b in np.flatnonzero(dynamic):
        mine = cells.body == b
        assert cells.weight[mine] @ cells.point[mine] == pytest.approx((0.0, 0.0), abs=1e-13)
        gyration = cells.weight[mine] @ (cells.point[mine] ** 2).sum(axis=1)
        exact = float(model.numpy("inertia")[b] / model.numpy("mass")[b])
        assert exact - 0.1**2 / 6 <= gyration <= exact
    np.testing.assert_array_equal(cells.body[cells.start[:-1]], [1, 9])
    assert cells.start[-1] == len(cells.body) == len(cells.weight)


@pytest.mark.parametrize(
    ("bodies", "found"), [("dynamic", [1, 2, 6, 7]), ("moving", [1, 2, 3, 4, 6, 7]), ("all", [1, 2, 3, 4, 5, 6, 7])]
)
def test_bodies_are_chosen_by_their_type(bodies, found):
    model, _, _ = compound("float32")
    cells = area_points(model, 0.3, bodies)
    assert cells.point.dtype == cells.weight.dtype == np.float32
    np.testing.assert_array_equal(np.unique(cells.body), [*found, *(8 + b for b in found)])
    assert (cells.weight[np.isin(cells.body, (2, 4))] == 1).all()  # without area: one point


def test_centres_are_the_dynamic_bodies():
    model, _, _ = compound()
    centres = center_points(model)
    np.testing.assert_array_equal(centres.body, [1, 2, 6, 7, 9, 10, 14, 15])
    np.testing.assert_array_equal(centres.start, [0, 4, 8])
    assert not centres.point.any()
    assert (centres.weight == 1).all()


def test_bad_values_are_named():
    model, _, _ = compound()
    with pytest.raises(ValueError, match="spacing is 0"):
        area_points(model, 0)
    with pytest.raises(ValueError, match="bodies is 'fixed'; it must be one of"):
        area_points(model, 0.1, "fixed")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_walls_of_the_theses_box_are_the_border_nodes(dtype):
    model, state, _ = scenes.Thesis().build(2).finalize(dtype)
    world, row, column = wall_nodes(model, state, Grid.thesis())
    image = np.zeros((2, 61, 61), int)
    np.add.at(image, (world, row, column), 1)
    expected = np.zeros((61, 61), int)
    expected[0] = expected[:, 0] = expected[:, -1] = 1
    np.testing.assert_array_equal(image, [expected, expected])


def test_walls_of_every_shape_cover_the_nodes_near_them():
    rng = np.random.default_rng(3)
    builder = dc.ModelBuilder()
    angle = 0.6
    for w in range(2):
        builder.add_world(origin=(100.0 * w, 0.0))
        body = builder.add_body((100.0 * w + 4.0, 3.0), angle=angle, type=dc.BodyType.STATIC)
        builder.add_disc(body, 0.8, (2.0, 1.0))
        builder.add_box(body, 0.9, 0.5, (-2.0, 0.0), radius=0.2)
        builder.add_capsule(body, (0.0, -1.5), (1.0, -1.0), 0.3)
        builder.add_chain(body, [(-3.0, 2.0), (0.0, 2.5), (1.0, 2.0)])
        builder.add_discs([(100.0 * w + 4.0, 3.0)], 0.5)  # no wall
        # outside the grid
        builder.add_disc(builder.add_body((100.0 * w - 50.0, 0.0), type=dc.BodyType.STATIC), 1.0)
    model, state, _ = builder.finalize()
    grid = Grid(rows=40, columns=50, spacing=0.2, origin=(-1.0, -1.0))
    finest = Grid(rows=40, columns=50, spacing=1e-300, origin=(-1.0, -1.0))
    assert len(wall_nodes(model, state, finest)[0]) == 0  # walls lie more cells off than integers count
    world, row, column = wall_nodes(model, state, grid)
    covered = np.zeros((2, *grid.shape), bool)
    covered[world, row, column] = True
    np.testing.assert_array_equal(covered[0], covered[1])

    # distances by dense points on the shapes' cores
    t = np.linspace(0.0, 1.0, 400)[:, None]
    box = box_vertices(0.9, 0.5, (-2.0, 0.0))
    core = [(np.array([(2.0, 1.0)]), 0.8)]
    core += [(a + t * (b - a), 0.2) for a, b in zip(box, np.roll(box, -1, axis=0))]
    core += [((-2.0, 0.0) + rng.uniform(-1, 1, (20000, 2)) * (0.9, 0.5), 0.2)]
    for ends, radius in (
        ([(0.0, -1.5), (1.0, -1.0)], 0.3),
        ([(-3.0, 2.0), (0.0, 2.5)], 0.0),
        ([(0, 2.5), (1, 2)], 0.0),
    ):
        a, b = np.array(ends)
        core.append((a + t * (b - a), radius))
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    distance = np.full(grid.shape, np.inf)
    for points, radius in core:
        away = grid.nodes()[..., None, :] - (points @ turn.T + (4.0, 3.0))
        distance = np.minimum(distance, np.hypot(away[..., 0], away[..., 1]).min(axis=-1) - radius)
    clear = np.abs(distance - 0.1) > 0.01  # the dense points are this coarse
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(covered[0][clear], (distance <= 0.1)[clear])
    assert covered[0].sum() > 100


def test_a_scene_without_walls_has_no_wall_nodes():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs([(0.0, 0.0)], 0.5)
    model, state, _ = builder.finalize()
    assert all(len(part) == 0 for part in wall_nodes(model, state, Grid.thesis()))
