"""A narrowphase on anybody's arrays: the contacts of a simulation and of the oracle, and in a graph."""

import numpy as np
import pytest
import torch
import warp as wp

import dc_kernels as dc

FIELDS = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")
REACH = 0.01


def scene(dtype="float32", backend="warp", worlds=3, bodies=24):
    """Shapes of all kinds at random places, so dense that many overlap; no body in the last world but the ground."""
    rng = np.random.default_rng(0)
    builder = dc.ModelBuilder()
    for w in range(worlds):
        builder.add_world(length_scale=0.5)
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 4.0, 0.5, center=(0.0, -0.5), friction=0.9)
        builder.add_chain(ground, [(-3.0, 2.0), (-1.0, 0.3), (1.0, 0.2), (3.0, 2.0)])
        for i in range(bodies if w < worlds - 1 else 0):
            body = builder.add_body(position=rng.uniform((-3, 0), (3, 3)), angle=rng.uniform(-3, 3))
            if i % 4 == 0:
                builder.add_disc(body, 0.3, friction=0.2)
            elif i % 4 == 1:
                builder.add_box(body, 0.4, 0.2, friction=0.5, restitution=0.3)
            elif i % 4 == 2:
                builder.add_capsule(body, (-0.2, 0.0), (0.2, 0.1), 0.1)
            else:
                builder.add_polygon(body, [(-0.3, -0.2), (0.3, -0.2), (0.0, 0.4)], radius=0.05)
    model, state, _ = builder.finalize(dtype=dtype, backend=backend)
    return model, state.numpy("position").copy(), state.numpy("angle").copy()


def pairs_of(model, position, angle):
    """A broadphase on the boxes of the shapes, and those."""
    boxes = dc.ShapeBoxes(model, position, angle, margin=0.5 * REACH)
    broadphase = dc.Broadphase(
        boxes.lower,
        boxes.upper,
        model.numpy("shape_start"),
        shape_body=model.shape_body,
        body_type=model.body_type,
        backend=model.backend,
    )
    return boxes, broadphase


def simulated(model, position, angle):
    """The contacts of a simulation whose bodies rest, all worlds one after the other, by field."""
    state = dc.State(model.sizes, model.dtype, backend=model.backend)
    state.assign("position", position)
    state.assign("angle", angle)
    config = dc.SolverConfig(speculative=2 * REACH, speculative_max=2 * REACH)  # length_scale is 0.5
    sim = dc.Simulation(model, state, config=config)
    for w in range(model.world_count):
        model.numpy("gravity")[w] = 0.0
    sim.collide(1e-3)
    first, count = sim.contacts.numpy("contact_start"), sim.contacts.numpy("contact_count")
    return {
        name: np.concatenate([sim.contacts.numpy(name)[a : a + n] for a, n in zip(first, count)]) for name in FIELDS
    }


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_are_those_of_a_simulation(dtype, backend):
    model, position, angle = scene(dtype, backend, bodies=24 if backend == "warp" else 12)
    boxes, broadphase = pairs_of(model, position, angle)
    narrowphase = dc.Narrowphase(model, position, angle, broadphase, reach=REACH, threads=2)
    for shift in (0.0, 0.05):
        position[1::2, 1] += shift
        boxes(), broadphase()
        assert narrowphase() is narrowphase.count
        wanted = simulated(model, position, angle)
        assert len(wanted["key"]) > 10
        for name in FIELDS:
            np.testing.assert_array_equal(narrowphase.numpy(name), wanted[name], err_msg=name)
        at = position[wanted["body_a"]] + wanted["arm_a"]
        np.testing.assert_array_equal(narrowphase.numpy("point"), at)
        with pytest.raises(KeyError, match="name is 'count', of no array with room for contacts; there are key, "):
            narrowphase.numpy("count")
        for w, (first, last) in enumerate(zip(model.numpy("body_start"), model.numpy("body_start")[1:])):
            bodies = narrowphase.numpy("body_a")[np.repeat(np.arange(3), np.asarray(narrowphase.count)) == w]
            assert ((bodies >= first) & (bodies < last)).all()


def test_boxes_hold_the_shapes():
    model, position, angle = scene()
    boxes = dc.ShapeBoxes(model, position, angle, threads=2)
    boxes()
    kept = dc.ShapeBoxes(model, position, angle, margin=0.25, backend="numpy")
    kept()
    for name, sign in (("lower", -1), ("upper", 1)):
        own, oracle = np.asarray(getattr(boxes, name)), np.asarray(getattr(kept, name))
        np.testing.assert_allclose(own + np.float32(0.25 * sign), oracle, atol=1e-6)
    # the farthest points of a box, turned by hand
    shape = int(np.flatnonzero(model.numpy("shape_body") == 2)[0])
    c, s = np.cos(angle[2]), np.sin(angle[2])
    corners = np.array([(-0.4, -0.2), (0.4, -0.2), (0.4, 0.2), (-0.4, 0.2)]) @ np.array([(c, s), (-s, c)])
    np.testing.assert_allclose(np.asarray(boxes.upper)[shape], (position[2] + corners).max(axis=0), atol=1e-6)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_pairs_in_rows_count_whatever_their_order(backend):
    """The rows of a stranger's broadphase, with room for more; another number of them from call to call."""
    model, position, angle = scene(backend=backend, bodies=12)
    boxes, broadphase = pairs_of(model, position, angle)
    boxes(), broadphase()
    wanted = dc.Narrowphase(model, position, angle, broadphase, reach=REACH)
    wanted()
    count = np.asarray(broadphase.count).copy()
    start = np.concatenate([[0], np.cumsum(count + 5)])
    rows = np.full((start[-1], 2), -7, np.int32)
    for w, (a, b) in enumerate(np.split(broadphase.numpy(), np.cumsum(count)[:-1])[k].T for k in range(3)):
        rows[start[w] : start[w] + count[w]] = np.stack([b, a], axis=1)
    given = dc.Narrowphase(model, position, angle, rows, pair_start=start, pair_count=count, reach=REACH)
    given()
    for name in (*FIELDS, "point"):
        np.testing.assert_array_equal(given.numpy(name), wanted.numpy(name), err_msg=name)
    before = np.asarray(given.count).copy()
    count[1] = 0
    given()
    np.testing.assert_array_equal(np.asarray(given.count), before * [1, 0, 1])
    count[1], rows[start[1], 0] = 1, model.numpy("shape_start")[1] - 1
    with pytest.raises(ValueError, match=rf"pairs\[{start[1]}\] is .* as shapes of world 1 do"):
        given()
    count[1] = 10_000
    with pytest.raises(ValueError, match=r"pair_count\[1\] is 10000; it must lie in"):
        given()


def discs(count=60):
    """Two worlds of discs in arrays of their own."""
    rng = np.random.default_rng(1)
    position = rng.uniform(0.0, 3.0, (count, 2)).astype(np.float32)
    radius = rng.uniform(0.1, 0.4, count).astype(np.float32)
    shapes = {
        "shape_type": np.full(count, dc.ShapeType.DISC, np.int32),
        "shape_radius": radius,
        "vertex_start": np.arange(count + 1, dtype=np.int32),
        "vertices": np.zeros((count, 2), np.float32),
        "shape_start": np.array([0, 20, count], np.int32),
        "body_start": np.array([0, 20, count], np.int32),
    }
    return shapes, position, radius


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_shapes_in_arrays_of_anybody(backend):
    shapes, position, radius = discs()
    angle = np.zeros(60, np.float32)
    all_pairs = [np.argwhere(np.triu(np.ones((n, n)), 1)) + first for first, n in ((0, 20), (20, 40))]
    start = [0, len(all_pairs[0]), sum(map(len, all_pairs))]
    rows = np.ascontiguousarray(np.concatenate(all_pairs), np.int32)
    narrowphase = dc.Narrowphase(shapes, position, angle, rows, pair_start=start, reach=0.05, backend=backend)
    for _ in range(2):
        narrowphase()
        d = position[rows[:, 1]] - position[rows[:, 0]]
        distance = np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1])
        gap = distance - radius[rows[:, 0]] - radius[rows[:, 1]]
        near = gap <= np.float32(0.05)
        np.testing.assert_array_equal(narrowphase.numpy("body_a"), rows[near, 0])
        np.testing.assert_array_equal(narrowphase.numpy("body_b"), rows[near, 1])
        np.testing.assert_allclose(narrowphase.numpy("gap"), gap[near], atol=1e-6)
        np.testing.assert_allclose(narrowphase.numpy("normal"), (d / distance[:, None])[near], atol=1e-5)
        key = narrowphase.numpy("key")
        worlds = np.split(key, [int(np.asarray(narrowphase.count)[0])])
        assert all((world[1:] > world[:-1]).all() for world in worlds)
        radius *= np.float32(1.1)
        position += np.float32(0.01)


def test_polygons_in_arrays_have_the_normals_and_extents_of_a_builder():
    model, position, angle = scene(worlds=2)
    names = ("shape_type", "shape_radius", "vertex_start", "vertices", "shape_body", "body_type", "shape_start")
    shapes = {name: model.numpy(name) for name in (*names, "body_start", "shape_center", "length_scale")}
    boxes, broadphase = pairs_of(model, position, angle)
    boxes(), broadphase()
    wanted = dc.Narrowphase(model, position, angle, broadphase, reach=REACH)
    found = dc.Narrowphase(shapes, position, angle, broadphase, reach=REACH)
    wanted(), found()
    np.testing.assert_array_equal(found.numpy("key"), wanted.numpy("key"))
    np.testing.assert_allclose(found.numpy("gap"), wanted.numpy("gap"), atol=1e-6)
    np.testing.assert_allclose(found.numpy("normal"), wanted.numpy("normal"), atol=1e-6)
    np.testing.assert_array_equal(found.numpy("friction"), 0.0)


@pytest.mark.parametrize("kind", ["torch", "warp"])
def test_memory_of_others_is_read_where_it_lies(kind):
    model, position, angle = scene(worlds=2)
    given = {
        "torch": (torch.from_numpy(position), torch.from_numpy(angle)),
        "warp": (wp.array(position, dtype=wp.vec2, copy=False), wp.array(angle, copy=False)),
    }[kind]
    boxes, broadphase = pairs_of(model, *given)
    narrowphase = dc.Narrowphase(model, *given, broadphase, reach=REACH)
    position[3] += np.float32(0.2)
    angle[5] += np.float32(1.0)
    boxes(), broadphase(), narrowphase()
    np.testing.assert_array_equal(narrowphase.numpy("gap"), simulated(model, position, angle)["gap"])


def test_room_grows_or_the_lack_of_it_is_an_error():
    shapes, position, _ = discs()
    shapes["shape_radius"] *= np.float32(10.0)
    angle = np.zeros(60, np.float32)
    boxes = dc.ShapeBoxes(shapes, position, angle)
    broadphase = dc.Broadphase(boxes.lower, boxes.upper, [0, 20, 60])
    narrowphase = dc.Narrowphase(shapes, position, angle, broadphase)
    left = {
        name: getattr(narrowphase, name) for name in ("body_a", "body_b", "normal", "gap", "arm_a", "arm_b", "count")
    }
    boxes(), broadphase(), narrowphase()
    assert narrowphase.layout_version > 0
    none = np.zeros((60, 2), np.float32)
    late = dc.ContactSolver(
        point=None,
        **left,
        inv_mass=np.ones(60, np.float32),
        inv_inertia=np.ones(60, np.float32),
        velocity=none,
        angular_velocity=none[:, 0].copy(),
        body_start=[0, 20, 60],
        contact_start=[0, 50, 150],
    )
    with pytest.raises(ValueError, match=r"count\[0\] is -1; .* a stage whose room grew has left its arrays"):
        late.solve(0.01)
    count = np.asarray(narrowphase.count)
    np.testing.assert_array_equal(count, [20 * 19 // 2, 40 * 39 // 2])
    exact = dc.Narrowphase(shapes, position, angle, broadphase, max_contacts=count)
    exact()
    np.testing.assert_array_equal(exact.numpy("gap"), narrowphase.numpy("gap"))
    short = dc.Narrowphase(shapes, position, angle, broadphase, max_contacts=[190, 779])
    with pytest.raises(OverflowError, match=r"world 1 has 780 contacts; max_contacts is 779"):
        short()


def test_the_stages_become_one_graph():
    model, position, angle = scene(worlds=2)
    boxes = dc.ShapeBoxes(model, position, angle, margin=0.5 * REACH)
    start, filters = model.numpy("shape_start"), {"shape_body": model.shape_body, "body_type": model.body_type}
    broadphase = dc.Broadphase(boxes.lower, boxes.upper, start, max_pairs=2000, **filters)
    narrowphase = dc.Narrowphase(model, position, angle, broadphase, reach=REACH, max_contacts=300)
    with wp.ScopedCapture(device="cpu") as capture:
        boxes(), broadphase(), narrowphase()
    for _ in range(3):
        position[1:, 1] -= np.float32(0.1)
        wp.capture_launch(capture.graph)
        broadphase.check(), narrowphase.check()
        wanted = simulated(model, position, angle)
        for name in FIELDS:
            np.testing.assert_array_equal(narrowphase.numpy(name), wanted[name], err_msg=name)
    angle[4] = np.nan
    wp.capture_launch(capture.graph)
    with pytest.raises(ValueError, match=r"angle\[4\] is nan; it must be finite"):
        narrowphase.check()


def test_bad_input_is_named():
    model, position, angle = scene(worlds=2)
    rows = np.zeros((3, 2), np.int32)
    rows[:, 1] = 2
    nan = position.copy()
    nan[3, 1] = np.nan
    shapes, place, _ = discs()
    turn = np.zeros(60, np.float32)
    none = np.zeros((0, 2), np.int32)

    def changed(**arrays):
        return {**shapes, **arrays}, place, turn, none

    def polygon(corners):
        one = {"shape_type": np.ones(1, np.int32), "shape_radius": np.zeros(1, np.float32)}
        one |= {"vertex_start": np.array([0, len(corners)], np.int32), "vertices": np.array(corners, np.float32)}
        return one, place[:1], turn[:1], none

    kinds, corners = shapes["shape_type"].copy(), shapes["vertex_start"]
    kinds[4] = 7
    segment = shapes["shape_type"].copy()
    segment[5] = dc.ShapeType.SEGMENT
    for arguments, options, message in (
        ((model, position[:-1], angle, rows), {}, r"position has shape \(25, 2\); it must be \(26, 2\)"),
        ((model, nan, angle, rows), {}, r"position\[3, 1\] is nan; it must be finite"),
        ((model, position.astype(float), angle, rows), {}, r"position has dtype float64; it must be float32"),
        ((model, position, angle, rows.astype(np.int64)), {}, r"pairs has dtype int64; it must be int32"),
        ((model, position, angle, rows), {}, r"pair_start has 1 worlds; the shapes have 2"),
        ((model, position, angle, rows), {"pair_start": [0, 2, 3]}, r"pairs\[2\] is \[0, 2\]; pairs\[2, 0\] must lie"),
        ((model, position, angle, rows), {"reach": np.inf}, r"reach is inf; it must be finite"),
        ((model, position, angle, rows), {"reach": -1.0}, r"reach is -1.0; it must be finite and >= 0"),
        ((model, position, angle, rows), {"backend": "jax"}, r"backend is 'jax'"),
        (changed(shape_type=kinds), {}, r"shape_type\[4\] is 7; it must lie in \[0, 2\]"),
        (changed(shape_type=segment), {}, r"shape 5, a SEGMENT, has 1 vertices; it must have 4 to 4"),
        (changed(vertex_start=corners[::-1].copy()), {}, r"vertex_start\[0\] is 60; it must be 0"),
        (changed(shape_radius=-shapes["shape_radius"]), {}, r"shape_radius\[0\] is -0.*; it must be finite and >= 0"),
        (changed(shape_body=np.full(60, -1, np.int32)), {}, r"shape_body\[0\] is -1"),
        (changed(body_start=np.array([0, 60], np.int32)), {}, r"shape_start has 2 worlds, body_start has 1"),
        (changed(colour=turn), {}, r"shapes has 'colour', which is no field"),
        (changed(shape_extent=turn), {}, r"shapes.shape_extent\[0\] is 0.0; it must be the distance of its farthest"),
        (polygon([(0, 0), (0, 1), (1, 0)]), {}, r"shapes.vertices\[0\] is .*; it must be a convex corner of a counter"),
        (polygon([(0, 0), (1, 0), (0.1, 0.1), (0, 1)]), {}, r"shapes.vertices\[2\] is .*; it must be a convex corner"),
        (polygon([(0, 0), (0, 0), (1, 1)]), {}, r"vertices\[0\] of shape 0 repeats the one behind it"),
        (polygon([(0, 0), (1, 0)]), {}, r"shapes.shape_radius\[0\] is 0.0; it must be > 0, for its shape is a disc or"),
        (({"shape_type": kinds}, place, turn, none), {}, r"shapes has no shape_radius; it needs"),
    ):
        with pytest.raises(ValueError, match=message):
            dc.Narrowphase(*arguments, **options)
    with pytest.raises(TypeError, match=r"shapes is a list; it must be a Model or arrays by name"):
        dc.Narrowphase([], place, turn, none)
    other = dc.Broadphase(place, place.copy())
    with pytest.raises(ValueError, match=r"pairs.start is .*; that of the shapes, shape_start, differs"):
        dc.Narrowphase(shapes, place, turn, other)


def test_a_graph_of_before_the_room_grew_is_told_of():
    shapes, position, _ = discs()
    angle = np.zeros(60, np.float32)
    boxes = dc.ShapeBoxes(shapes, position, angle, margin=30.0)
    broadphase = dc.Broadphase(boxes.lower, boxes.upper, [0, 20, 60])
    narrowphase = dc.Narrowphase(shapes, position, angle, broadphase)
    boxes(), broadphase(), narrowphase()
    with wp.ScopedCapture(device="cpu") as capture:
        narrowphase()
    position *= np.float32(0.01)
    narrowphase()
    found = narrowphase.numpy("gap")
    wp.capture_launch(capture.graph)
    with pytest.raises(RuntimeError, match=r"recorded before layout_version changed to \d+: .*; record it anew"):
        narrowphase.check()
    np.testing.assert_array_equal(narrowphase.numpy("gap"), found)
    narrowphase.check()
