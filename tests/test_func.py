"""The functions of contact in a stranger's own kernels: the numbers of the narrowphase, and of the formulas."""

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc

shapes = dc.func.shapes("float32")
double = dc.func.shapes("float64")
hull_of, frame_of, hull_hull, hull_disc = shapes.hull_of, shapes.frame_of, shapes.hull_hull, shapes.hull_disc
disc_disc = double.disc_disc
POLYGON = wp.constant(int(dc.ShapeType.POLYGON))


@wp.kernel(enable_backward=False)
def meet_discs(
    center: wp.array(dtype=wp.vec2d),
    radius: wp.array(dtype=wp.float64),
    normal: wp.array(dtype=wp.vec2d),
    gap: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    m = disc_disc(center[i], radius[i], center[i + 1], radius[i + 1])
    normal[i] = m.normal
    gap[i] = m.gap0


@wp.kernel(enable_backward=False)
def meet_boxes(
    position: wp.array(dtype=wp.vec2),
    angle: wp.array(dtype=float),
    radius: wp.array(dtype=float),
    vertex_start: wp.array(dtype=int),
    vertices: wp.array(dtype=wp.vec2),
    vertex_normals: wp.array(dtype=wp.vec2),
    count: wp.array(dtype=int),
    normal: wp.array(dtype=wp.vec2),
    gap: wp.array2d(dtype=float),
):
    """The first shape against each other one, in the frame of the first."""
    i = wp.tid() + 1
    c = wp.cos(angle[0])
    s = wp.sin(angle[0])
    a = hull_of(0, POLYGON, radius[0], vertex_start)
    b = hull_of(i, POLYGON, radius[i], vertex_start)
    x = dc.func.rotate_back(c, s, position[i] - position[0])
    frame = frame_of(wp.cos(angle[i] - angle[0]), wp.sin(angle[i] - angle[0]), x)
    m = hull_hull(a, b, frame, 0.1, 1e-5, 1e-3, vertices, vertex_normals)
    count[i] = m.count
    normal[i] = dc.func.rotate(c, s, m.normal)
    gap[i, 0] = m.gap0
    gap[i, 1] = m.gap1


@wp.kernel(enable_backward=False)
def land(
    vertices: wp.array(dtype=wp.vec2),
    vertex_normals: wp.array(dtype=wp.vec2),
    place: wp.array(dtype=wp.vec2),
    gap: wp.array(dtype=float),
):
    """Discs of radius 0.25 against a hull that the kernel puts together itself."""
    i = wp.tid()
    hull = shapes.Hull()
    hull.first = 0
    hull.count = 4
    hull.segment = False
    hull.radius = 0.0
    m = hull_disc(hull, place[i], 0.25, vertices, vertex_normals)
    gap[i] = m.gap0


@wp.kernel(enable_backward=False)
def project(z: wp.array(dtype=wp.vec2), mu: float, nearest: wp.array(dtype=wp.vec2)):
    i = wp.tid()
    nearest[i] = dc.func.project_cone(z[i], mu)


def test_discs_in_double_precision():
    rng = np.random.default_rng(0)
    center, radius = rng.uniform(-1.0, 1.0, (40, 2)), rng.uniform(0.1, 1.0, 40)
    normal, gap = wp.zeros(39, dtype=wp.vec2d), wp.zeros(39, dtype=wp.float64)
    wp.launch(meet_discs, 39, [wp.array(center, dtype=wp.vec2d), wp.array(radius, dtype=wp.float64), normal, gap])
    d = np.diff(center, axis=0)
    distance = np.linalg.norm(d, axis=1)
    np.testing.assert_allclose(gap.numpy(), distance - radius[:-1] - radius[1:], atol=1e-14)
    np.testing.assert_allclose(normal.numpy(), d / distance[:, None], atol=1e-14)


def test_boxes_meet_as_in_the_narrowphase():
    rng = np.random.default_rng(1)
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    for i in range(60):
        at = rng.uniform(-1.5, 1.5, 2) if i else np.zeros(2)
        builder.add_box(builder.add_body(position=at, angle=rng.uniform(-3, 3)), 0.6, 0.4, radius=0.05)
    model, state, _ = builder.finalize()
    rows = np.stack([np.zeros(59), np.arange(1, 60)], axis=1).astype(np.int32)
    narrowphase = dc.Narrowphase(model, state.position, state.angle, rows, reach=0.1)
    narrowphase()
    count, normal, gap = wp.zeros(60, dtype=int), wp.zeros(60, dtype=wp.vec2), wp.zeros((60, 2), dtype=float)
    arrays = [model.shape_radius, model.vertex_start, model.vertices, model.vertex_normals]
    wp.launch(meet_boxes, 59, [state.position, state.angle, *arrays, count, normal, gap])
    gaps = gap.numpy()
    found = [(i, gaps[i, k]) for i in range(60) for k in range(count.numpy()[i]) if gaps[i, k] <= 0.1]
    assert len(found) > 40
    other, own = narrowphase.numpy("body_b"), narrowphase.numpy("gap")
    order = np.lexsort((own, other))
    found.sort()
    np.testing.assert_array_equal(other[order], [i for i, _ in found])
    np.testing.assert_allclose(own[order], [g for _, g in found], atol=2e-6)
    np.testing.assert_allclose(narrowphase.numpy("normal"), normal.numpy()[other], atol=2e-6)


def test_a_disc_on_a_hull_of_the_callers_own():
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)], np.float32)
    normals = np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)], np.float32)
    place = np.array([(0.0, 1.5), (2.0, 2.0), (0.5, 0.9), (-3.0, 0.2)], np.float32)
    gap = wp.zeros(4, dtype=float)
    wp.launch(land, 4, [*(wp.array(array, dtype=wp.vec2) for array in (corners, normals, place)), gap])
    np.testing.assert_allclose(gap.numpy(), [0.25, np.sqrt(2.0) - 0.25, -0.35, 1.75], atol=1e-6)


def test_the_projection_is_the_nearest_point_of_the_cone():
    rng = np.random.default_rng(2)
    z = rng.normal(size=(50, 2)).astype(np.float32)
    nearest = wp.zeros(50, dtype=wp.vec2)
    wp.launch(project, 50, [wp.array(z, dtype=wp.vec2), 0.5, nearest])
    normal = np.linspace(0.0, 3.0, 3001)
    border = np.concatenate([np.stack([normal, sign * 0.5 * normal], axis=1) for sign in (-1.0, 1.0)])
    for point, found in zip(z, nearest.numpy()):
        assert found[0] >= 0.0 and abs(found[1]) <= 0.5 * found[0] + 1e-6
        inside = point[0] >= 0.0 and abs(point[1]) <= 0.5 * point[0]
        least = 0.0 if inside else np.linalg.norm(border - point, axis=1).min()
        assert np.linalg.norm(found - point) == pytest.approx(least, abs=1e-3)


def test_another_scalar_type_is_refused():
    with pytest.raises(ValueError, match=r"dtype is 'float16'; it must be one of \('float32', 'float64'\)"):
        dc.func.shapes("float16")


def test_hulls_meet_alike_wherever_their_corners_lie():
    rng = np.random.default_rng(3)
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    for i in range(40):
        at = rng.uniform(-1.2, 1.2, 2) if i else np.zeros(2)
        count = 4 if i % 2 else 3 + i % 6
        angle = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * (2.0 * np.pi / count)
        builder.add_polygon(builder.add_body(position=at), np.stack([np.cos(angle), np.sin(angle)], axis=1) * 0.5)
    model, state, _ = builder.finalize()
    results = []
    for step in (1, 3):  # neighbours in memory, and every third of an array
        arrays = []
        for name in ("vertices", "vertex_normals"):
            values = np.repeat(model.numpy(name), step, axis=0)
            arrays.append(wp.array(values, dtype=wp.vec2, device="cpu")[::step])
        found = wp.zeros(40, dtype=int), wp.zeros(40, dtype=wp.vec2), wp.zeros((40, 2), dtype=float)
        shapes_of = [model.shape_radius, model.vertex_start, *arrays]
        wp.launch(meet_boxes, 39, [state.position, state.angle, *shapes_of, *found], device="cpu")
        results.append([array.numpy() for array in found])
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)
    assert results[0][0].sum() > 20
