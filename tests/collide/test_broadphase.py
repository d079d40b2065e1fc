"""Candidate pairs against all pairs, a k-d tree, and the motion of a step."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import dc_kernels as dc
from tests.geometry import contacts_of, core, hull_distance, kept_pairs_of, pairs_of, simulate, tight_boxes

KINDS = (dc.BodyType.DYNAMIC, dc.BodyType.DYNAMIC, dc.BodyType.KINEMATIC, dc.BodyType.STATIC)


def random_world(builder, rng, bodies, size, spread, speed=0.0, far=(0.0, 0.0), **world):
    """Bodies of all types with one or two shapes; sizes from ``size`` = (low, high), evenly in their logarithm."""
    builder.add_world(gravity=(0, 0), **world)
    for _ in range(bodies):
        kind = rng.choice(KINDS)
        velocity, spin = (0.0, 0.0), 0.0
        if kind != dc.BodyType.STATIC:
            velocity, spin = rng.uniform(-speed, speed, 2), rng.uniform(-speed, speed)
        position = rng.uniform(-spread, spread, 2) + far
        body = builder.add_body(position, rng.uniform(-4, 4), velocity, spin, type=kind)
        for _ in range(rng.integers(1, 3)):
            r = math.exp(rng.uniform(*np.log(size)))
            center = r * rng.uniform(-2, 2, 2)
            # bits 1 and 2; few refuse the other
            bits = {"category": int(rng.integers(1, 4)), "mask": int(rng.choice([1, 2, 3, 0xFFFFFFFF]))}
            form = rng.integers(0, 4)
            if form == 0:
                builder.add_disc(body, r, center, **bits)
            elif form == 1:
                builder.add_box(body, r, r * rng.uniform(0.1, 1), center, **bits)
            elif form == 2:
                builder.add_capsule(body, center, center + r, 0.3 * r, **bits)
            elif kind == dc.BodyType.STATIC:
                builder.add_chain(body, center + r * np.array([(0, 0), (1, 0), (2, 1)]), **bits)
            else:
                builder.add_polygon(body, center + r * np.array([(0, 0), (1, 0), (0, 1)]), 0.1 * r, **bits)


def allowed(sim, a, b):
    """Whether shapes (n,) and (n,) may meet at all: bodies, types, filters."""
    model = sim.model
    i, j = model.numpy("shape_body")[[a, b]]
    moves = model.numpy("body_type") == dc.BodyType.DYNAMIC
    category, mask = model.numpy("shape_category"), model.numpy("shape_mask")
    return (i != j) & (moves[i] | moves[j]) & (category[a] & mask[b] != 0) & (category[b] & mask[a] != 0)


def box_pairs(sim, boxes, world, grow):
    """All allowed pairs of shapes of a world whose boxes are closer than ``grow``, as sets of (low, high) index."""
    first, last = sim.model.numpy("shape_start")[world : world + 2]
    box = boxes[first:last]
    # only what is near along x, in the order of the lower ends, is looked at
    order = np.argsort(box[:, 0], kind="stable")
    reach = box[order, 2] + grow + 1e-3 + 1e-5 * np.abs(box[order, 2])
    after = np.arange(1, len(order) + 1)
    count = np.maximum(np.searchsorted(box[order, 0], reach, side="right") - after, 0)
    one = np.repeat(after - 1, count)
    other = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count) + one + 1
    a, b = np.sort(order[np.stack((one, other))], axis=0)
    apart = np.maximum(box[a, :2] - box[b, 2:], box[b, :2] - box[a, 2:]).max(axis=1)
    close = np.stack((a, b), axis=1)[apart <= grow] + first
    return {(a, b) for a, b in close[allowed(sim, *close.T)].tolist()}


def sets_of(rows, static):
    """Pairs as a set of (low, high) index: sorted, each once, A static or the lower index."""
    pairs = [(int(a), int(b)) for a, b in rows]
    assert pairs == sorted(set(pairs))
    for a, b in pairs:
        assert not static[b]
        assert static[a] or a < b
    found = {(min(pair), max(pair)) for pair in pairs}
    assert len(found) == len(pairs)
    return found


def check_pairs(sim):
    """Everything the pair list promises, in every world; returns the number of pairs."""
    model = sim.model
    boxes = tight_boxes(sim)
    owner = model.numpy("shape_body")
    static = model.numpy("body_type")[owner] == dc.BodyType.STATIC
    total = 0
    for w in range(model.world_count):
        found, kept = (sets_of(pairs(sim, w), static) for pairs in (pairs_of, kept_pairs_of))
        scale = float(model.numpy("length_scale")[w])
        assert found >= box_pairs(sim, boxes, w, sim.config.speculative * scale * (1 - 1e-5))
        # and exactly the overlaps of what the shapes cover in the step, and of the boxes with margin that are kept
        assert found == box_pairs(sim, sim.pairs.numpy("swept"), w, 0.0)
        assert kept == box_pairs(sim, sim.pairs.numpy("box"), w, 0.0)
        total += len(found)
    return total


@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.sampled_from([1.0, 100.0, 1e4]), st.floats(0.3, 30))
def test_all_pairs_that_can_meet_are_candidates(seed, bodies, ratio, spread):
    rng = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    random_world(builder, rng, bodies, (0.3 / math.sqrt(ratio), 0.31 * math.sqrt(ratio)), spread, far=(-7, 3))
    sim = simulate(builder)
    sim.collide(1e-3)
    check_pairs(sim)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_worlds_of_different_size_do_not_mix(dtype):
    rng = np.random.default_rng(1)
    builder = dc.ModelBuilder()
    for bodies in (0, 1, 60, 3, 0, 25, 200):
        random_world(builder, rng, bodies, (0.1, 1), 4.0, speed=2.0)
    sim = simulate(builder, dtype, pairs_per_shape=0.5)
    sim.collide(0.01)
    assert check_pairs(sim) > 500
    for w in range(sim.model.world_count):
        first, last = sim.model.numpy("shape_start")[w : w + 2]
        assert ((pairs_of(sim, w) >= first) & (pairs_of(sim, w) < last)).all()


def test_worlds_give_the_same_pairs_alone_and_together():
    def add(builder, seed):
        random_world(builder, np.random.default_rng(seed), 30, (0.1, 1), 3.0)

    together = dc.ModelBuilder()
    for seed in range(3):
        add(together, seed)
    sim = simulate(together)
    sim.collide(0.01)
    for seed in range(3):
        alone = dc.ModelBuilder()
        add(alone, seed)
        single = simulate(alone)
        single.collide(0.01)
        first = sim.model.numpy("shape_start")[seed]
        assert np.array_equal(pairs_of(sim, seed) - first, pairs_of(single))


def test_worlds_without_moving_bodies():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_world()
    for i in range(5):
        builder.add_box(builder.add_body((0.1 * i, 0), type=dc.BodyType.STATIC), 1, 1)
    builder.add_world()
    for i in range(5):
        builder.add_disc(builder.add_body((0.1 * i, 0), type=dc.BodyType.KINEMATIC, velocity=(i, 1)), 1)
    builder.add_world()
    builder.add_body((1, 1), mass=1.0)
    sim = simulate(builder)
    sim.run(3, 0.01)
    assert not sim.pairs.numpy("count").any()
    assert np.allclose(sim.state.numpy("time"), 0.03)


@pytest.mark.parametrize(("count", "spread"), [(300, 5.0), (300, 0.3), (2000, 30.0)])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_of_equal_discs_are_those_of_a_k_d_tree(count, spread, dtype):
    rng = np.random.default_rng(count)
    radius = 0.25
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    builder.add_discs(rng.uniform(-spread, spread, (count, 2)), radius)
    sim = simulate(builder, dtype)
    sim.collide(0.01)
    reach = 2 * radius * (1 + sim.config.speculative)
    centers = sim.state.numpy("position").astype(float)
    tree = cKDTree(centers)
    sure, perhaps = (tree.query_pairs(reach * f) for f in (1 - 1e-5, 1 + 1e-5))
    assert sure <= {(int(a), int(b)) for a, b in pairs_of(sim)}
    table = contacts_of(sim)
    found = {(int(a), int(b)) for a, b in zip(table["body_a"], table["body_b"], strict=True)}
    assert sure <= found <= perhaps


@pytest.mark.parametrize("ratio", [100.0, 1e4])
def test_sizes_far_apart_bring_few_needless_pairs(ratio):
    rng = np.random.default_rng(7)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    # a few large discs among many small ones, that fill the same area
    builder.add_discs(rng.uniform(-20, 20, (3000, 2)), 0.1)
    builder.add_discs(rng.uniform(-20, 20, (6, 2)) * math.sqrt(ratio), 0.1 * ratio)
    sim = simulate(builder)
    sim.collide(1e-3)
    candidates = check_pairs(sim)
    overlaps = len(box_pairs(sim, tight_boxes(sim), 0, 0.0))
    assert overlaps > 300
    # a margin of 8 % on each side of a box of 20 cm makes its area 1.35 times as large
    assert candidates < 1.5 * overlaps + 20


def still_world(**body):
    """Two discs that touch, one far away, one long thin box."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    for x in (0.0, 1.0, 9.0):
        builder.add_disc(builder.add_body((x, 0), **(body if x == 9.0 else {})), 0.5)
    builder.add_box(builder.add_body((0, 9)), 6.0, 0.01)
    return simulate(builder)


def test_pairs_are_kept_while_motion_is_small():
    sim = still_world(velocity=(0.1, -0.1))
    sim.run(5, 0.01)
    assert sim.pairs.numpy("rebuilds")[0] == 1
    before = pairs_of(sim).copy()
    sim.state.numpy("position")[2] += (0.02, -0.02)
    sim.run(1, 0.01)
    assert sim.pairs.numpy("rebuilds")[0] == 1
    assert np.array_equal(before, pairs_of(sim))


def test_pairs_are_made_anew_when_a_body_leaves_its_margin():
    sim = still_world(velocity=(-1.0, 0.0))
    seen = []
    for _ in range(800):
        sim.step(0.01)
        seen.append(int(sim.pairs.numpy("rebuilds")[0]))
        near = hull_distance(core(sim, 1)[0], core(sim, 2)[0]) - 1.0
        assert near > 0.02 or (1, 2) in {tuple(p) for p in pairs_of(sim).tolist()}
    # once in 8 cm + 4 steps of motion or more, not in every step
    assert 20 < seen[-1] < 110


def test_pairs_are_made_anew_when_the_user_moves_a_body():
    sim = still_world()
    sim.step(0.01)
    assert pairs_of(sim).tolist() == [[0, 1]]
    sim.state.numpy("position")[2] = (-1.0, 0.0)
    sim.step(0.01)
    assert sim.pairs.numpy("rebuilds")[0] == 2
    assert pairs_of(sim).tolist() == [[0, 1], [0, 2]]
    assert contacts_of(sim)["body_b"].tolist() == [1, 2]


def test_pairs_are_made_anew_when_a_long_box_turns():
    sim = still_world()
    sim.state.numpy("position")[3] = (0.0, 6.6)
    sim.step(0.01)
    assert pairs_of(sim).tolist() == [[0, 1]]
    sim.state.numpy("angle")[3] = math.pi / 2
    sim.step(0.01)
    assert [0, 3] in kept_pairs_of(sim).tolist()

    sim = still_world()
    sim.state.numpy("position")[3] = (0.0, 6.51)
    sim.state.numpy("angular_velocity")[3] = 2.0
    for _ in range(100):
        sim.step(0.01)
        if hull_distance(core(sim, 0)[0], core(sim, 3)[0]) < 0.52:
            assert [0, 3] in pairs_of(sim).tolist()
            break
    else:
        raise AssertionError("the box never reached the disc")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_all_in_one_cell(dtype):
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    builder.add_discs(np.full((20, 2), -3.7) + np.linspace(0, 0.01, 20)[:, None], 1.0)
    sim = simulate(builder, dtype)
    sim.collide(0.01)
    assert check_pairs(sim) == 190


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 60))
def test_the_list_holds_all_that_meets_within_the_step(seed, speed):
    rng = np.random.default_rng(seed)
    dt = 1 / 60
    builder = dc.ModelBuilder()
    random_world(builder, rng, 20, (0.1, 0.5), 3.0, speed=speed)
    sim = simulate(builder)
    sim.collide(dt)
    # a second step on the kept or new pairs, from where free flight leads
    for _ in range(2):
        start = {name: sim.state.numpy(name).copy() for name in ("position", "angle")}
        check_pairs(sim)
        listed = {(min(p), max(p)) for p in pairs_of(sim).tolist()}
        for t in np.linspace(0, dt, 9):
            sim.state.numpy("position")[:] = start["position"] + t * sim.state.numpy("velocity")
            sim.state.numpy("angle")[:] = start["angle"] + t * sim.state.numpy("angular_velocity")
            assert box_pairs(sim, tight_boxes(sim), 0, 0.0) <= listed
        sim.collide(dt)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 100.0, 1e4]), st.sampled_from([0.0, 1e5]))
def test_no_pair_is_lost_while_some_shapes_leave_their_boxes(seed, ratio, far):
    """Step after step some bodies are moved, few or most, near or far: their pairs are found anew, the others kept."""
    rng = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    for bodies in rng.integers(0, 35, 2):
        sizes = (0.3 / math.sqrt(ratio), 0.31 * math.sqrt(ratio))
        random_world(builder, rng, bodies, sizes, rng.uniform(0.5, 8), speed=rng.choice([0, 3, 300]), far=(far, -far))
    sim = simulate(builder, rng.choice(["float32", "float64"]), pairs_per_shape=rng.choice([0.0, 4.0]))
    bodies = sim.model.body_count
    for _ in range(5):
        sim.collide(0.01)
        check_pairs(sim)
        moved = rng.random(bodies) < rng.choice([0.03, 0.3, 0.9])
        sim.state.numpy("position")[moved] += rng.uniform(-1, 1, (int(moved.sum()), 2)) * rng.choice([0.1, 1, 5])
        sim.state.numpy("angle")[moved] += 0.5
        if rng.random() < 0.3:
            sim.solve()
            sim.advance()
            sim.change_model(shape_mask=rng.choice(np.array([1, 2, 3], np.uint32), sim.model.shape_count))
    assert not sim.state.numpy("flags").any()


def test_few_of_many_leave():
    """More shapes than are compared one by one, so that a mend looks at cells, which few of the shapes are near."""
    rng = np.random.default_rng(3)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    builder.add_discs(rng.uniform(-12, 12, (600, 2)), 0.25)
    builder.add_discs(rng.uniform(-12, 12, (6, 2)), 2.0)
    sim = simulate(builder)
    for moved in (0, 1, 15, 40, 200, 300):
        chosen = rng.choice(606, moved, replace=False)
        sim.state.numpy("position")[chosen] = rng.uniform(-12, 12, (moved, 2))
        before = sim.pairs.numpy("box").copy()
        sim.collide(0.01)
        assert check_pairs(sim) > 300
        if 0 < moved < 300:
            renewed = (sim.pairs.numpy("box") != before).any(axis=1)
            assert 0 < renewed.sum() <= moved and renewed[chosen].sum() == renewed.sum()


def test_a_body_that_is_not_finite_meets_nothing_until_it_is_again():
    sim = still_world()
    sim.collide(0.01)
    assert pairs_of(sim).tolist() == [[0, 1]]
    for bad in (np.nan, np.inf):
        sim.state.numpy("position")[1, 0] = bad
        sim.collide(0.01)
        assert not (pairs_of(sim) == 1).any()
    sim.state.numpy("position")[1] = (1.0, 0.0)
    sim.collide(0.01)
    assert pairs_of(sim).tolist() == [[0, 1]]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_do_not_depend_on_when_pairs_were_found(dtype):
    """A step that finds all pairs anew makes the contacts of one that has kept them: as after loading a snapshot."""

    def fast_world():
        rng = np.random.default_rng(5)
        builder = dc.ModelBuilder()
        random_world(builder, rng, 60, (0.1, 0.5), 4.0, speed=5.0)
        return simulate(builder, dtype)

    kept, fresh = fast_world(), fast_world()
    for _ in range(60):
        kept.step(0.01)
        fresh.pairs.numpy("valid")[:] = 0
        fresh.step(0.01)
        assert contacts_of(kept)["key"].tobytes() == contacts_of(fresh)["key"].tobytes()
        assert kept.state.numpy("position").tobytes() == fresh.state.numpy("position").tobytes()
    assert kept.pairs.numpy("rebuilds")[0] < 60
