"""Rays, shapes on their way, overlaps and closest points: closed forms, and every shape tested by the oracle."""

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.scenes import scene

BACKENDS = ("warp", "numpy")
SHAPES = (  # corners and radius of what is asked with
    (None, 0.3),
    ([(-0.3, 0.0), (0.4, 0.1)], 0.1),
    ([(-0.3, -0.3), (0.4, -0.2), (0.1, 0.5)], 0.0),
    ([(-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)], 0.05),
)


def yard():
    """World 0: a disc of radius 1 at (0, 0), a box turned by 45 degrees at (5, 0), a capsule at (10, 0), a floor."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body(), radius=1.0, category=2)
    builder.add_box(builder.add_body(position=(5.0, 0.0), angle=np.pi / 4), half_width=1.0, half_height=1.0)
    builder.add_capsule(builder.add_body(position=(10.0, 0.0)), (-1.0, 0.0), (1.0, 0.0), radius=0.5)
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(-20.0, -3.0), (20.0, -3.0)])
    builder.add_world()
    builder.add_disc(builder.add_body(position=(0.0, 0.5)), radius=1.0)
    return builder


def queries(backend="warp", dtype="float64"):
    model, state, _ = yard().finalize(dtype=dtype)
    return dc.Queries(model, state.position, state.angle, backend=backend)


def crowd(dtype, backend="warp", threads=1):
    """Two worlds of discs, capsules, polygons and walls, turned at random."""
    model, state, _ = scene("mixed", bodies=16).build(2, 3).finalize(dtype=dtype)
    angle = np.random.default_rng(1).uniform(-3.0, 3.0, model.sizes["body"])
    angle[model.numpy("body_type") == dc.BodyType.STATIC] = 0.0
    state.assign("angle", angle)
    return dc.Queries(model, state.position, state.angle, backend=backend, threads=threads), state.numpy("position")


def asked(position, count=50):
    rng = np.random.default_rng(0)
    low, high = position.min(axis=0) - 1.0, position.max(axis=0) + 1.0
    return rng.uniform(low, high, (count, 2)), rng.normal(0.0, 4.0, (count, 2)), rng.integers(0, 2, count)


@pytest.mark.parametrize("backend", BACKENDS)
def test_rays_meet_shapes_where_closed_forms_say(backend):
    hits = queries(backend).cast_rays(
        [(0.0, 5.0), (0.6, 5.0), (5.3, 5.0), (10.5, 5.0), (11.3, 5.0), (3.0, 5.0), (15.0, 9.0), (0.5, 0.0)],
        (0.0, -10.0),
        world=0,
    )
    corner = np.sqrt(2.0)
    y = [1.0, 0.8, corner - 0.3, 0.5, 0.4, -3.0, -1.0, 0.0]
    assert hits.shape.tolist() == [0, 0, 1, 2, 2, 3, -1, 0]
    assert np.allclose(hits.point[:, 1], y, atol=1e-14)
    assert np.allclose(hits.fraction, [0.4, 0.42, (5.3 - corner) / 10, 0.45, 0.46, 0.8, 1.0, 0.0], atol=1e-14)
    half = np.sqrt(0.5)
    normals = [(0, 1), (0.6, 0.8), (half, half), (0, 1), (0.6, 0.8), (0, 1), (0, 0), (0, 0)]
    assert np.allclose(hits.normal, normals, atol=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_shapes_on_their_way_touch_where_closed_forms_say(backend):
    asking = queries(backend)
    disc = asking.cast_shape([(1.2, 5.0), (0.0, 1.9)], (0.0, -10.0), radius=1.0, world=0)
    assert disc.shape.tolist() == [0, 0]
    assert np.allclose(disc.fraction, [0.34, 0.0])
    assert np.allclose(disc.point[0], (0.6, 0.8)) and np.allclose(disc.normal[0], (0.6, 0.8))
    square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
    box = asking.cast_shape([(9.0, 5.0), (8.5, 5.0), (5.0, 5.0)], (0.0, -10.0), vertices=square, world=0)
    assert np.allclose(box.fraction, [0.35, 0.35, (4.0 - np.sqrt(2.0)) / 10])
    # side on side: the middle of what both have in common; a corner that is met by a side
    assert np.allclose(box.point, [(9.5, 0.5), (9.25, 0.5), (5.0, np.sqrt(2.0))])
    turned = asking.cast_shape([(10.0, 5.0)], (0.0, -10.0), vertices=square, angle=np.pi / 4, world=0)
    assert np.allclose(turned.point, [(10.0, 0.5)])
    assert np.allclose(turned.fraction, (4.5 - np.sqrt(2.0)) / 10)


@pytest.mark.parametrize("backend", BACKENDS)
def test_points_boxes_and_closest_points(backend):
    asking = queries(backend)
    points = [(0.0, 0.9), (0.0, 1.1), (5.0, 1.4), (11.4, 0.2), (0.0, -3.0)]
    inside = asking.overlap_points(points, world=0)
    assert inside.start.tolist() == [0, 1, 1, 2, 3, 4] and inside.index.tolist() == [0, 1, 2, 3]
    boxes = asking.overlap_boxes(
        [(-1.0, -4.0), (0.8, 0.8), (0.0, -4.0)], [(12.0, 0.0), (1.0, 1.0), (20.0, 20.0)], world=0
    )
    assert np.array_equal(boxes.index, [0, 1, 2, 3, 0, 1, 2, 3]) and boxes.start.tolist() == [0, 4, 4, 8]
    closest = asking.closest_points([(0.0, 0.9), (0.0, 3.0), (5.0, -2.9), (5.0, 0.1)], world=0)
    assert closest.shape.tolist() == [0, 0, 3, 1]
    assert np.allclose(closest.distance, [-0.1, 2.0, 0.1, 0.1 / np.sqrt(2.0) - 1.0])
    assert np.allclose(closest.point[:3], [(0.0, 1.0), (0.0, 1.0), (5.0, -3.0)])
    near = asking.closest_points([(0.0, 3.0), (0.0, 2.0)], max_distance=[1.5, 1.0], world=0)
    assert near.shape.tolist() == [-1, 0]
    assert np.allclose(near.distance, [1.5, 1.0]) and not near.normal[0].any()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_answers_are_those_of_all_shapes_tested(dtype):
    (found, position), (wanted, _) = crowd(dtype), crowd(dtype, "numpy")
    bound = 1e-4 if dtype == "float32" else 1e-12
    origin, translation, world = asked(position)
    angle = np.random.default_rng(2).uniform(-3.0, 3.0, len(origin))

    def compare(name, *args, **options):
        a, b = (getattr(asking, name)(*args, world=world, **options) for asking in (found, wanted))
        for field in vars(a):
            one, other = getattr(a, field), getattr(b, field)
            if one.dtype.kind == "i":
                assert np.array_equal(one, other), (name, field)
            else:
                assert np.allclose(one, other, rtol=0.0, atol=bound), (name, field)
        return a

    hits = compare("cast_rays", origin, translation)
    assert 0.5 < (hits.shape >= 0).mean() < 1.0 and (hits.fraction == 0).any()
    for vertices, radius in SHAPES:
        shape = {"vertices": vertices, "radius": radius, "angle": angle}
        assert (compare("cast_shape", origin, translation, **shape).shape < 0).any()
        assert len(compare("overlap_shape", origin, **shape).index) > 10
    compare("overlap_points", origin)
    compare("overlap_boxes", origin, origin + np.abs(translation))
    compare("closest_points", origin)
    assert (compare("closest_points", origin, max_distance=0.2).shape < 0).any()
    compare("cast_rays", origin, 0 * translation)


def test_a_hit_lies_on_a_surface_with_nothing_before_it():
    asking, position = crowd("float64")
    origin, translation, world = asked(position, 2000)
    hits = asking.cast_rays(origin, translation, world=world)
    met = (hits.shape >= 0) & (hits.fraction > 0)
    surface = asking.closest_points(hits.point[met], world=world[met])
    assert np.abs(surface.distance).max() < 1e-12
    for part in (0.1, 0.5, 0.9, 1 - 1e-9):
        before = origin + part * hits.fraction[:, None] * translation
        assert not len(asking.overlap_points(before[hits.fraction > 0], world=world[hits.fraction > 0]).index)


def test_threads_and_the_order_of_queries_change_nothing():
    (one, position), (four, _) = crowd("float32"), crowd("float32", threads=4)
    origin, translation, world = asked(position, 3000)
    a, b = (asking.cast_rays(origin, translation, world=world) for asking in (one, four))
    c = one.cast_rays(origin[::-1], translation[::-1], world=world[::-1])
    for field in vars(a):
        assert np.array_equal(getattr(a, field), getattr(b, field))
        assert np.array_equal(getattr(a, field), getattr(c, field)[::-1])


def test_worlds_masks_and_bodies_left_out():
    asking = queries()
    down = (0.0, -10.0)
    assert np.allclose(asking.cast_rays([(0.0, 5.0)] * 2, down, world=[0, 1]).fraction, [0.4, 0.35])
    assert asking.cast_rays([(0.0, 5.0)] * 2, down, world=0, mask=[1, 2]).shape.tolist() == [3, 0]
    assert asking.cast_rays([(0.0, 5.0)] * 2, down, world=0, skip_body=[0, -1]).shape.tolist() == [3, 0]
    assert asking.cast_rays(np.zeros((0, 2)), down, world=0).shape.shape == (0,)


def test_of_equals_the_first_shape_is_met():
    builder = dc.ModelBuilder()
    builder.add_world()
    for _ in range(40):
        builder.add_disc(builder.add_body(), radius=1.0)
    model, state, _ = builder.finalize()
    asking = dc.Queries(model, state.position, state.angle)
    assert asking.cast_rays([(0.0, 3.0)], (0.0, -5.0)).shape.tolist() == [0]
    assert asking.closest_points([(0.0, 3.0)]).shape.tolist() == [0]
    assert asking.overlap_points([(0.0, 0.0)]).index.tolist() == list(range(40))


def test_a_capsule_without_length_is_a_disc_and_far_rays_have_unit_normals():
    asking = queries(dtype="float32")
    disc = asking.cast_shape([(1.2, 5.0), (0.0, 5.0)], (0.0, -10.0), radius=1.0, world=0)
    for ends in ([(0.0, 0.0), (0.0, 0.0)], [(0.0, 0.0), (1e-9, 0.0)]):
        capsule = asking.cast_shape([(1.2, 5.0), (0.0, 5.0)], (0.0, -10.0), vertices=ends, radius=1.0, world=0)
        assert np.allclose(capsule.fraction, disc.fraction)
    far = asking.cast_rays([(0.6, 1e3), (0.0, 1e7)], [(0.0, -1e4), (0.0, -1e8)], world=0)
    assert np.allclose(np.hypot(*far.normal.T), 1.0, atol=1e-6)


def test_a_simulation_is_asked_where_it_was_updated():
    sim = dc.Simulation(*yard().finalize())
    asking = dc.Queries(sim)
    first = asking.cast_rays([(0.0, 5.0)], (0.0, -10.0), world=0)
    sim.run(20, 0.01)
    assert np.array_equal(asking.cast_rays([(0.0, 5.0)], (0.0, -10.0), world=0).fraction, first.fraction)
    asking.update()
    fallen = 1.0 + sim.state.numpy("position")[0, 1]
    assert np.allclose(asking.cast_rays([(0.0, 5.0)], (0.0, -10.0), world=0).point[0, 1], fallen)


def test_sizes_of_all_kinds_and_bodies_that_are_nowhere():
    builder = dc.ModelBuilder()
    builder.add_world()
    rng = np.random.default_rng(0)
    for radius in 10.0 ** rng.uniform(-4, 3, 600):
        builder.add_disc(builder.add_body(position=rng.uniform(-1e4, 1e4, 2)), radius=radius)
    model, state, _ = builder.finalize(dtype="float64")
    position = state.numpy("position").copy()
    position[5] = np.nan
    origin, translation = rng.uniform(-1e4, 1e4, (12, 2)), rng.normal(0, 1e4, (12, 2))
    answers = []
    for backend in BACKENDS:
        asking = dc.Queries(model, state.position, state.angle, backend=backend)
        dc.to_numpy(state.position)[5] = np.nan
        asking.update()
        dc.to_numpy(state.position)[5] = 0.0
        answers.append(asking.cast_rays(origin, translation))
    assert np.array_equal(answers[0].shape, answers[1].shape)
    assert np.allclose(answers[0].fraction, answers[1].fraction, atol=1e-9)
    assert 5 not in answers[0].shape


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda q: q.cast_rays([0.0, 1.0], (0, 1), world=0),
            ValueError,
            r"origin has shape \(2,\); it must be \(n, 2\)",
        ),
        (
            lambda q: q.cast_rays([(0.0, np.nan)], (0, 1), world=0),
            ValueError,
            r"origin\[0, 1\] is nan; it must be finite",
        ),
        (
            lambda q: q.cast_rays([(0, 0)], (0, np.inf), world=0),
            ValueError,
            r"translation\[1\] is inf; it must be finite",
        ),
        (lambda q: q.cast_rays([(0, 0)], [(0, 1)] * 2, world=0), ValueError, r"translation has shape \(2, 2\)"),
        (lambda q: q.cast_rays([(0, 0)], (0, 1)), ValueError, "world is missing; there are 2"),
        (lambda q: q.cast_rays([(0, 0)], (0, 1), world=2), ValueError, r"world\[0\] is 2; it must lie in \[0, 1\]"),
        (lambda q: q.cast_rays([(0, 0)], (0, 1), world=0, skip_body=9), ValueError, "skip_body"),
        (lambda q: q.cast_rays("here", (0, 1), world=0), TypeError, "origin is 'here'"),
        (
            lambda q: q.cast_rays([(1e200, 0)], (0, 1), world=0),
            ValueError,
            r"origin\[0, 0\] is 1e\+200; it must be within",
        ),
        (lambda q: q.cast_shape([(0, 0)], (0, 1), radius=-1.0, world=0), ValueError, "radius is -1.0"),
        (lambda q: q.cast_shape([(0, 0)], (0, 1), vertices=[(0, 0)] * 9, world=0), ValueError, "vertices: 9 points"),
        (
            lambda q: q.overlap_boxes([(0, 0)], [(1, -1)], world=0),
            ValueError,
            r"upper\[0, 1\] is -1\.0; it must be >= ",
        ),
        (
            lambda q: q.overlap_boxes([(0, 0)], [(1, 1e200)], world=0),
            ValueError,
            r"upper\[0, 1\] is 1e\+200; it must be",
        ),
        (lambda q: q.closest_points([(0, 0)], max_distance=-1, world=0), ValueError, r"max_distance\[0\] is -1\.0"),
    ],
)
def test_bad_input_is_refused_by_name(call, error, message):
    with pytest.raises(error, match=message):
        call(queries("numpy"))


def test_taichi_says_who_has_queries():
    model, state, _ = yard().finalize()
    with pytest.raises(
        ValueError, match=r"'taichi', which has no kernels of queries.queries; it must be one of \('warp', 'numpy'\)"
    ):
        dc.Queries(model, state.position, state.angle, backend="taichi")
