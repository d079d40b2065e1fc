"""The scenes: placement, seeds, independence of the batch."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import dc_kernels as dc
from dc_kernels.model.enums import BodyType, ShapeType
from pipeline.scenes import SCENES, Mixed, Thesis, ThesisClustered, place_discs, scene

IN_A_BOX = ("thesis", "thesis-clustered", "settled", "mixed")
SMALL = {name: scene(name, **({"rows": 3} if name == "pyramid" else {})) for name in SCENES}


def arrays(
    name: str, worlds: int = 1, seed: int = 0, dtype: str = "float64", **parameters
) -> tuple[dc.Model, dc.State]:
    built = scene(name, **parameters).build(worlds, seed).finalize(dtype, backend="numpy")
    return built[0], built[1]


def dynamic(model: dc.Model, state: dc.State, world: int = 0) -> np.ndarray:
    """Positions of the dynamic bodies of a world."""
    bodies = slice(*model.body_start[world : world + 2])
    return state.position[bodies][model.body_type[bodies] == BodyType.DYNAMIC]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("bodies", [1, 2, 3, 7, 100, 1000])
@pytest.mark.parametrize("name", ["thesis", "thesis-clustered", "settled"])
def test_discs_begin_apart_and_inside_the_box(name, bodies, dtype):
    model, state = arrays(name, 3, dtype=dtype, bodies=bodies)
    walls = model.shape_type == ShapeType.SEGMENT
    for world in range(3):
        centres = dynamic(model, state, world).astype(np.float64)
        assert len(centres) == bodies
        if bodies > 1:
            assert cKDTree(centres).query(centres, 2)[0][:, 1].min() > 1.0
        first = model.shape_start[world]
        assert walls[first : first + 3].all()  # left wall, floor, right wall
        corners = model.vertices[model.vertex_start[first] : model.vertex_start[first + 3]]
        corners = corners + state.position[model.shape_body[first]]
        low, high = corners.min(axis=0), corners.max(axis=0)
        assert (centres - 0.5 > low).all()
        assert (centres + 0.5 < high).all()


@given(st.integers(0, 2**32), st.integers(1, 60), st.integers(1, 3), st.integers(1, 4))
def test_placement_is_that_of_the_sequential_loop(seed, count, worlds, ahead):
    """One candidate after the other, kept if it is far enough from all kept before."""
    size = (0.9 * np.sqrt(count) + 1.0, 0.8 * np.sqrt(count) + 2.0)

    def sampler(world):
        stream = np.random.default_rng(seed + world)
        return lambda first, number: stream.random((number, 2)) * size

    placed = place_discs([sampler(world) for world in range(worlds)], count, 0.7, size, ahead=ahead)
    for world in range(worlds):
        kept: list[np.ndarray] = []
        candidates = sampler(world)
        while len(kept) < count:
            candidate = candidates(0, 1)[0]
            if all(np.hypot(*(candidate - other)) >= 0.7 for other in kept):
                kept.append(candidate)
        np.testing.assert_array_equal(placed[world], kept)


def test_a_jammed_placement_begins_anew():
    """The first disc of two often leaves no room for the second; every world still gets both."""
    blocked = 0
    for seed in range(20):
        stream = np.random.default_rng(seed)
        centres = place_discs([lambda first, n, stream=stream: stream.random((n, 2))], 2, 1.0, (1.0, 1.0))[0]
        assert np.hypot(*(centres[0] - centres[1])) >= 1.0
        first = np.random.default_rng(seed).random(2)
        blocked += bool(np.hypot(*np.maximum(first, 1.0 - first)) < 1.0)
    assert blocked


def test_too_many_discs_raise():
    with pytest.raises(ValueError, match=r"bodies is 3: so many do not fit .* <= 2"):
        place_discs([lambda first, n: np.zeros((n, 2))], 3, 1.0, (0.5, 0.5))


@pytest.mark.parametrize("name", SCENES)
def test_a_world_depends_on_its_seed_alone(name):
    model, state = (group for group in SMALL[name].build(3, 5).finalize("float64", backend="numpy")[:2])
    worlds = []
    for i in range(3):
        alone, alone_state = SMALL[name].build(1, 5 + i).finalize("float64", backend="numpy")[:2]
        bodies, shapes = slice(*model.body_start[i : i + 2]), slice(*model.shape_start[i : i + 2])
        np.testing.assert_array_equal(state.position[bodies], alone_state.position)
        np.testing.assert_array_equal(state.angle[bodies], alone_state.angle)
        np.testing.assert_array_equal(model.mass[bodies], alone.mass)
        np.testing.assert_array_equal(model.shape_type[shapes], alone.shape_type)
        vertices = slice(model.vertex_start[shapes.start], model.vertex_start[shapes.stop])
        np.testing.assert_array_equal(model.vertices[vertices], alone.vertices)
        worlds.append(alone_state.position)
    if name not in ("incline", "card-house", "arch", "dominoes"):  # nothing is random there
        assert not np.array_equal(worlds[0], worlds[1])


@pytest.mark.parametrize("name", IN_A_BOX)
def test_the_box_grows_with_the_bodies(name):
    density = [n / scene(name, bodies=n).side ** 2 for n in (1, 100, 12345)]
    np.testing.assert_allclose(density, 100.0 / 15.0**2)
    assert scene(name, bodies=100, radius=1.0).side == 30.0


def test_the_thesis_world_is_that_of_the_protocol():
    model, state = arrays("thesis")
    assert model.body_count == 101
    np.testing.assert_allclose(model.mass[1:], np.pi * 0.25)
    np.testing.assert_allclose(model.gravity, [[0.0, -9.8]])
    np.testing.assert_allclose(model.shape_friction, 0.5)
    np.testing.assert_allclose(model.shape_restitution, 0.0)
    corners = (model.vertices[:12] + state.position[0]).reshape(3, 4, 2)[:, :2]
    np.testing.assert_allclose(corners, [[[0, 15], [0, 0]], [[0, 0], [15, 0]], [[15, 0], [15, 15]]], atol=1e-12)
    np.testing.assert_allclose(state.velocity, 0.0)


def test_clustered_discs_are_clustered():
    """Counts in 5 x 5 squares vary more than those of the uniform placement."""

    def variation(kind: type[Thesis]) -> float:
        model, state = kind().build(8, 0).finalize("float64", backend="numpy")[:2]
        counts = [np.histogram2d(*dynamic(model, state, w).T, bins=5, range=[[0, 15]] * 2)[0].var() for w in range(8)]
        return float(np.mean(counts))

    assert variation(ThesisClustered) > 2.0 * variation(Thesis)


def test_settled_discs_touch_almost():
    model, state = arrays("settled", bodies=100)
    centres = dynamic(model, state)
    distances = cKDTree(centres).query(centres, 3)[0][:, 1:]  # each disc has two neighbours within the margin
    assert distances.min() > 1.0
    assert distances.max() < 1.0 + dc.SolverConfig().speculative
    assert (centres[:, 1] < 0.6).sum() == 15  # the floor of 15 m


def test_mixed_has_every_shape_within_its_radius():
    model, _ = arrays("mixed", bodies=60, radius=0.8, size_ratio=4.0)
    moving = model.body_type[model.shape_body] == BodyType.DYNAMIC
    counts = np.diff(model.vertex_start)[moving]
    assert (model.shape_type[moving] == ShapeType.DISC).sum() == 15
    assert {1, 2, 4} <= set(counts)
    assert counts.max() == 8
    owner = np.repeat(model.shape_body, np.diff(model.vertex_start))
    radius = np.repeat(model.shape_radius, np.diff(model.vertex_start))
    reach = radius + np.hypot(*(model.vertices + model.center_of_mass[owner]).T)  # from the frame it was placed with
    largest = np.maximum.reduceat(reach, model.vertex_start[:-1])[moving]
    assert largest.max() <= 0.8
    assert 0.2 < largest.min() < 0.4


def test_mixed_bodies_begin_apart():
    model, state = arrays("mixed", 2, bodies=50)
    for world in range(2):
        bodies = np.arange(*model.body_start[world : world + 2])[1:]
        cosine, sine = np.cos(state.angle), np.sin(state.angle)
        x, y = model.center_of_mass.T
        shift = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
        frames = (state.position - shift)[bodies]
        assert cKDTree(frames).query(frames, 2)[0][:, 1].min() >= 1.0


def test_stack_pyramid_incline_and_chain():
    model, state = arrays("stack", bodies=4)
    np.testing.assert_allclose(dynamic(model, state)[:, 1], [0.5, 1.5, 2.5, 3.5])
    model, state = arrays("pyramid", rows=4)
    assert len(dynamic(model, state)) == 10
    model, state = arrays("incline", shape="disc", angle=0.3, friction=0.2)
    wall = state.position[0] + model.vertices[:2]
    along = (wall[1] - wall[0]) / np.hypot(*(wall[1] - wall[0]))
    np.testing.assert_allclose(along, [np.cos(0.3), np.sin(0.3)])
    offset = dynamic(model, state)[0] - wall[0]
    assert along[0] * offset[1] - along[1] * offset[0] == pytest.approx(0.5)  # it touches
    np.testing.assert_allclose(model.shape_friction, 0.2)
    joints = scene("chain", bodies=5, jitter=0.0).build().finalize("float64", backend="numpy")[2]
    np.testing.assert_allclose(joints.joint_length, 1.0)
    assert len(joints.joint_length) == 5


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("thesis", {"bodies": 0}, "thesis.bodies is 0; it must be an integer in [1, "),
        ("thesis", {"radius": float("nan")}, "thesis.radius is nan"),
        ("thesis-clustered", {"spread": 0.0}, "thesis-clustered.spread is 0.0"),
        ("stack", {"restitution": 1.5}, "stack.restitution is 1.5; it must be in [0, 1]"),
        ("mixed", {"size_ratio": 0.5}, "mixed.size_ratio is 0.5; it must be finite and >= 1"),
        ("incline", {"angle": 1.6}, "incline.angle is 1.6"),
        ("chain", {"length": 0.4}, "chain.length is 0.4; it must be > 0.4"),
    ],
)
def test_wrong_parameters_raise(name, parameters, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        scene(name, **parameters).build()


def test_wrong_names_and_numbers_raise():
    with pytest.raises(ValueError, match="scene is 'these'; it must be one of"):
        scene("these")
    with pytest.raises(ValueError, match="thesis has no parameter 'rows'"):
        scene("thesis", rows=3)
    with pytest.raises(ValueError, match="worlds is 0"):
        Mixed().build(0)
    with pytest.raises(ValueError, match="seed is -1"):
        Mixed().build(1, -1)


@pytest.mark.parametrize(("name", "fallen"), [("card-house", {"friction": 0.05}), ("arch", {"thickness": 0.07})])
def test_a_structure_stands_until_its_limit(name, fallen):
    for parameters, stands in (({}, True), (fallen, False)):
        sim = dc.Simulation(*scene(name, **parameters).build().finalize())
        before = sim.state.numpy("position").copy()
        sim.run(100, 0.01)
        moved = np.abs(sim.state.numpy("position") - before).max()
        assert moved < 1e-3 if stands else moved > 0.1


@pytest.mark.parametrize(("thickness", "spacing"), [(0.02, 0.9), (0.15, 0.45), (0.3, 0.6)])
def test_dominoes_fall_one_after_the_other(thickness, spacing):
    sim = dc.Simulation(*scene("dominoes", bodies=5, thickness=thickness, spacing=spacing).build().finalize())
    turned = []
    for _ in range(80):
        sim.run(5, 0.01)
        turned.append(-sim.state.numpy("angle")[1:])
    first = (np.array(turned) > 0.2).argmax(axis=0)
    assert (np.diff(first) >= 0).all() and (turned[-1] > 0.2).all()
