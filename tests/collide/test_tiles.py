"""Flush neighbours hide their edges, steps do not, and what passes by is left alone."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from bench.faults.tiles import SHAPES, SLOP, cases, measure, slide

STATIC = dc.BodyType.STATIC
DT = 1 / 60


def test_nothing_catches_on_flush_tiles():
    found = measure(quick=True)
    assert found["cases"] == 150
    assert found["caught"] == []
    assert found["tiles_worst_speed"] >= 0.999
    assert found["tiles_worst_jump_m"] <= SLOP


def landing(shape, velocities, tiling, worlds=40, dt=DT, backend="warp", steps=30):
    """Bodies that fall onto tiles of half a metre from many heights while they cross them.

    Yields the share of their speed that they keep, and their heights, for each velocity that they start with.
    """
    builder, bodies = dc.ModelBuilder(), []
    draw = np.random.default_rng(0)
    edges = np.arange(-2.0, 20.0, 0.5).tolist()
    for _ in range(worlds):
        builder.add_world(length_scale=1.0)
        ground = builder.add_body(type=STATIC)
        for x in edges:
            if tiling == "chains":
                builder.add_chain(ground, [(x, 0.0), (x + 0.5, 0.0)], friction=0.0)
            elif tiling == "body":
                builder.add_box(ground, 0.25, 0.5, center=(x + 0.25, -0.5), friction=0.0)
            else:
                builder.add_box(builder.add_body((x + 0.25, -0.5), type=STATIC), 0.25, 0.5, friction=0.0)
        place = (draw.uniform(0.0, 0.5), 0.4 + draw.uniform(0.05, 0.3))
        bodies.append(builder.add_body(place))
        SHAPES[shape](builder, bodies[-1])
    sim = dc.Simulation(*builder.finalize(backend=backend))
    for velocity in velocities:
        sim.reset()
        sim.state.numpy("velocity")[bodies] = velocity
        sim.run(steps, dt)
        height = sim.state.numpy("position")[bodies, 1] - sim.model.numpy("center_of_mass")[bodies, 1]
        yield sim.state.numpy("velocity")[bodies, 0] / velocity[0], height


@pytest.mark.parametrize("tiling", ["body", "bodies", "chains"])
@pytest.mark.parametrize("shape", SHAPES)
def test_what_lands_on_seams_catches_on_none(shape, tiling):
    """The side of a tile that it comes to is hidden by the tile that stops it."""
    velocities = (2.0, -1.0), (7.0, -1.0), (7.0, -5.0), (31.0, -2.0)
    for velocity, (kept, height) in zip(velocities, landing(shape, velocities, tiling), strict=True):
        assert kept.min() > 0.999, velocity
        np.testing.assert_allclose(height, 0.4, atol=2 * SLOP)


@pytest.mark.parametrize("shape", ["box", "rounded", "disc"])
def test_the_oracle_lands_on_seams_alike(shape):
    options = {"worlds": 2, "steps": 4}
    one, two = (next(landing(shape, [(7.0, -5.0)], "body", backend=name, **options)) for name in ("warp", "numpy"))
    np.testing.assert_allclose(one, two, rtol=1e-5)


@pytest.mark.parametrize("shape", ["rounded", "capsule", "disc"])
def test_no_corner_is_climbed_that_is_reached_just_after_the_step(shape):
    """At a short time step arcs come to within the slop of a corner at the end of how far a step looks ahead."""
    speeds = (7.0, 31.0)
    chosen = [case for case in cases(quick=True) if case.shape == shape and case.speed in speeds and case.off == 0.0]
    for row in slide(chosen, 1 / 240, seconds=1.0):
        assert row["speed_kept"] > 0.9999, row
        assert row["rise"] < 0.1 * SLOP, row


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_oracle_catches_on_nothing_either(dtype):
    chosen = [case for case in cases(quick=True) if (case.speed, case.tiling, case.off) == (7.0, "body", 1.0)]
    for row in slide(chosen, DT, dtype, backend="numpy", seconds=0.15):
        assert row["speed_kept"] > 0.999, row
        assert row["rise"] < SLOP, row


def over_tiles(shape, speed, tops, *, movable=False, inertia=None, steps=40):
    """A body that slides over tiles of 1 m with these tops, the first from x = -1 on; its velocity after each step."""
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=1.0)
    for i, top in enumerate(tops):
        tile = builder.add_body((i - 0.5, top - 0.5), type=dc.BodyType.DYNAMIC if movable else STATIC, mass=1e5)
        builder.add_box(tile, 0.5, 0.5, friction=0.0)
    if movable:
        builder.add_box(builder.add_body((0.0, -1.5), type=STATIC), 50.0, 0.5)
    body = builder.add_body((0.0, 0.4), velocity=(speed, 0.0), inertia=inertia)
    SHAPES[shape](builder, body)
    sim = dc.Simulation(*builder.finalize())
    velocity, height = [], []
    for _ in range(steps):
        sim.step(DT)
        velocity.append(sim.state.numpy("velocity")[body].copy())
        height.append(float(sim.state.numpy("position")[body, 1]))
    return np.array(velocity), np.array(height)


@pytest.mark.parametrize("shape", SHAPES)
def test_nothing_catches_on_tiles_that_could_move(shape):
    velocity, height = over_tiles(shape, 7.0, [0.0] * 7, movable=True)
    assert velocity[:, 0].min() > 0.999 * 7.0
    assert height.max() - height[0] < 2 * SLOP


@pytest.mark.parametrize("speed", [0.5, 2.0, 7.0, 31.0, 100.0])
@pytest.mark.parametrize("shape", ["box", "triangle"])
def test_a_step_stops_what_slides_against_it(shape, speed):
    """A step of three slops is an edge and no seam; one that may turn would tumble over it."""
    steps = int(1.2 / speed / DT) + 4
    velocity, _ = over_tiles(shape, speed, [0.0, 0.0, 3 * SLOP, 3 * SLOP, 0.0], inertia=0.0, steps=steps)
    assert abs(velocity[-1, 0]) < 1e-3 * speed


def passing(add_a, add_b, offset, speed):
    """Velocity that is left of a body that flies by a static one without gravity, over its speed."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    add_a(builder, builder.add_body(type=STATIC))
    body = builder.add_body((-3.03, offset), velocity=(speed, 0.0))
    add_b(builder, body)
    sim = dc.Simulation(*builder.finalize("float64"))
    for _ in range(math.ceil(6.0 / (speed * DT))):
        sim.step(DT)
    return sim.state.numpy("velocity")[body] / speed


POSTS = {
    "disc": lambda builder, body: builder.add_disc(body, 0.5, friction=0.0),
    "box": lambda builder, body: builder.add_box(body, 0.5, 0.5, friction=0.0),
    "diamond": lambda builder, body: builder.add_box(body, 0.35, 0.35, angle=math.pi / 4, friction=0.0),
    "capsule": lambda builder, body: builder.add_capsule(body, (0.0, -0.3), (0.0, 0.3), 0.2, friction=0.0),
    "chain": lambda builder, body: builder.add_chain(body, [(0.0, -0.5), (0.0, 0.5)], friction=0.0),
}
TOPS = {"disc": 0.5, "box": 0.5, "diamond": 0.35 * math.sqrt(2), "capsule": 0.5, "chain": 0.5}


@pytest.mark.parametrize("shape", ["box", "rounded", "disc", "capsule"])
@pytest.mark.parametrize("post", POSTS)
def test_what_passes_by_is_not_deflected(post, shape):
    for speed in (7.0, 31.0, 100.0):
        for miss in (1e-3, 0.02, 0.1, 0.3):
            left = passing(POSTS[post], SHAPES[shape], TOPS[post] + 0.4 + miss, speed)
            assert left == pytest.approx((1.0, 0.0), abs=1e-9), (speed, miss)


@pytest.mark.parametrize("shape", ["box", "disc"])
@pytest.mark.parametrize("post", POSTS)
def test_what_would_overlap_is_stopped(post, shape):
    for speed in (7.0, 31.0, 100.0):
        left = passing(POSTS[post], SHAPES[shape], 0.2, speed)
        assert left[0] < 0.9, speed
