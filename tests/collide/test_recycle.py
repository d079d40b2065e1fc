"""Contacts that are met by what is kept of a pair, and in lanes, have the bits of a full test."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.collide.broadphase import CandidatePairs
from tests.geometry import simulate

DT = 1e-2
FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")
LAUNCHES = ("predict", "update_pairs", "narrowphase")


def add_shape(builder, body, stream):
    """A disc, a capsule, a box, or a polygon of 3 to 8 corners, some of them rounded."""
    corners = int(stream.integers(1, 9))
    radius = float(stream.choice((0.0, 0.03)))
    if corners == 1:
        builder.add_disc(body, float(stream.uniform(0.3, 0.45)))
    elif corners == 2:
        builder.add_capsule(body, (-0.4, 0.0), (0.4, 0.1), 0.1)
    elif corners == 4:
        builder.add_box(body, *stream.uniform(0.4, 0.9, 2), radius=radius)
    else:
        angle = np.sort(np.linspace(0, 2 * math.pi, corners, endpoint=False) + stream.uniform(-0.2, 0.2, corners))
        builder.add_polygon(body, 0.45 * np.stack([np.cos(angle), np.sin(angle)], axis=1), radius=radius)


def cluster(seed, dtype="float32"):
    """Shapes on a lattice so close that neighbours are apart by a contact's distance, touch, or overlap."""
    stream = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    for i in range(8):
        for j in range(8):
            at = 0.8 * np.array((i, j)) + stream.uniform(-0.05, 0.05, 2)
            body = builder.add_body(tuple(at), float(stream.choice((0.0, 0.5 * math.pi, stream.uniform(0, 6)))))
            add_shape(builder, body, stream)
    return simulate(builder, dtype, contacts_per_body=8.0, pairs_per_shape=12.0), stream


def found(sim):
    for name in LAUNCHES:
        sim.bind(name, 0, 1)()
    assert not sim.state.numpy("flags").any()
    count = int(sim.contacts.numpy("contact_count")[0])
    return {name: sim.contacts.numpy(name)[:count].copy() for name in FOUND}


def forget(sim):
    sim.pairs.fill("kept_count", np.zeros(1, np.int32))
    sim.pairs.fill("kept_rebuilds", np.full(1, -1, np.int32))


def kept(sim):
    """Near pairs of which something is kept."""
    start = int(sim.pairs.numpy("kept_side")[0]) * int(sim.pairs.numpy("start")[1])
    return int((sim.pairs.numpy("kept_bound")[start : start + int(sim.pairs.numpy("kept_count")[0]), 1] >= 0).sum())


def without_keeping(monkeypatch, *arguments):
    """A cluster all of whose pairs are tested in full, one after the other."""

    def of_model(cls, model, pairs_per_shape):
        shapes = np.diff(model.numpy("shape_start"))
        return cls(shapes, np.ceil(pairs_per_shape * shapes), model.dtype, model.device, model.backend)

    with monkeypatch.context() as patch:
        patch.setattr(CandidatePairs, "of_model", classmethod(of_model))
        return cluster(*arguments)[0]


def poses(sim):
    return {name: sim.state.numpy(name).copy() for name in ("position", "angle", "velocity", "angular_velocity")}


def move(sim, values):
    for name, array in values.items():
        sim.state.fill(name, array)


def tangle(seed, joined):
    """Chains of hulls that touch those above and below and overlap their neighbours, with which joints part them."""
    stream = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    for row in range(8):
        before = None
        for i in range(8):
            at, velocity = (0.55 * i, 0.8 * row), stream.normal(0, 0.1, 2)
            body = builder.add_body(at, velocity=tuple(velocity), angular_velocity=float(stream.normal(0, 0.1)))
            add_shape(builder, body, stream)
            if before is not None and joined:
                builder.add_revolute_joint(before, body, (0.27, 0), (-0.28, 0))
            before = body
    return simulate(builder, "float32", contacts_per_body=12.0, pairs_per_shape=24.0)


@pytest.mark.parametrize("joined", (True, False))
def test_steps_have_the_bits_of_steps_that_keep_nothing(joined):
    reused = 0
    for seed in range(3):
        ours, theirs = tangle(seed, joined), tangle(seed, joined)
        for step in range(20):
            forget(theirs)
            reused += kept(ours)
            for sim in (ours, theirs):
                sim.run(1, DT)
            for name, array in poses(ours).items():
                assert np.array_equal(array, poses(theirs)[name]), (seed, step, name)
    assert reused > 2_000


@pytest.mark.parametrize("dtype", ("float32", "float64"))
def test_kept_edges_give_the_bits_of_a_full_test(dtype, monkeypatch):
    compared = reused = 0
    for seed in range(4):
        sim, stream = cluster(seed, dtype)
        fresh = without_keeping(monkeypatch, seed, dtype)
        base = poses(sim)
        for step in range(90):
            # from the pose where all was kept to one whose distance is anything from nothing to half a hull's size
            size = 1e-5 * 1.3 ** (step % 41) if step % 3 else 0.0
            values = {name: array.copy() for name, array in base.items()}
            values["position"] += stream.normal(0, size, values["position"].shape).astype(dtype)
            values["angle"] += stream.normal(0, size, values["angle"].shape).astype(dtype)
            for name in ("velocity", "angular_velocity"):
                # at rest, slow, and moving
                values[name][...] = (0.0, 0.0, 1e-3, 0.3)[step % 4] * stream.normal(0, 1, values[name].shape)
            move(sim, values)
            move(fresh, values)
            had = kept(sim)
            ours, theirs = found(sim), found(fresh)
            for name in FOUND:
                assert np.array_equal(ours[name], theirs[name]), (seed, step, name)
            compared += len(theirs["gap"])
            reused += had
    assert compared > 20_000
    assert reused > 10_000


def test_pairs_at_rest_are_met_by_what_is_kept():
    sim, _ = cluster(7)
    found(sim)
    bound = sim.pairs.numpy("kept_bound").copy()
    assert kept(sim) > 40
    found(sim)
    assert np.array_equal(sim.pairs.numpy("kept_bound"), bound)


def test_other_shapes_are_met_in_full():
    sim, _ = cluster(3)
    found(sim)
    had = kept(sim)
    vertices = sim.model.numpy("vertices") * np.float32(1.05)
    sim.change_model(vertices=vertices)
    ours = found(sim)
    forget(sim)
    theirs = found(sim)
    assert had and all(np.array_equal(ours[name], theirs[name]) for name in FOUND)


def test_a_shape_that_takes_anothers_place_is_met_in_full():
    sim, _ = cluster(5)
    sim.step(DT)
    at, angle = sim.state.numpy("position")[27].copy(), float(sim.state.numpy("angle")[27])
    sim.remove(bodies=27)
    more = sim.additions()
    more.add_box(more.add_body(tuple(at), angle), 0.5, 0.8)
    sim.add(more)
    ours = found(sim)
    forget(sim)
    theirs = found(sim)
    assert all(np.array_equal(ours[name], theirs[name]) for name in FOUND)


def test_hulls_that_come_to_a_scene_without_any_are_kept():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0), length_scale=1.0)
    builder.add_discs([(3.0 + i, 0.0) for i in range(12)], 0.4)
    sim = simulate(builder, "float32", contacts_per_body=8.0, pairs_per_shape=12.0)
    sim.reserve(bodies=6, shapes=6, vertices=24)
    sim.step(DT)
    assert sim.pairs.sizes["kept pair"] == 0
    more = sim.additions()
    for i in range(6):
        more.add_box(more.add_body((0.99 * (i % 3), 0.99 * (i // 3))), 0.5, 0.5)
    grown = sim.pairs.sizes["pair"]
    sim.add(more)
    assert sim.pairs.sizes["pair"] == grown  # there was room
    found(sim)
    assert kept(sim) >= 7
    ours = found(sim)
    forget(sim)
    theirs = found(sim)
    assert len(ours["gap"]) > 12 and all(np.array_equal(ours[name], theirs[name]) for name in FOUND)
    sim.run(3, DT)
    assert kept(sim) >= 7
