"""Contact points of random hulls, closing gaps and chains: plain geometry, and what bodies do that meet or slide."""

import math

import numpy as np
import pytest

import dc_kernels as dc
from tests.collide.hulls import (
    DT,
    STATIC,
    add_hull,
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
    core,
    hull_distance,
    pairs_of,
    rotation,
    separation,
    shapes_of_key,
    simulate,
)

LIMIT = 0.02  # speculative distance at length_scale = 1
SLACK = 2.6e-5  # features closer to each other than 0.05 of the slop count as one


def chained(points):
    return lambda builder, body: builder.add_chain(body, points)


# ---------------------------------------------------------------------- random hulls


def test_least_gap_is_the_distance_of_the_hulls():
    rng = np.random.default_rng(11)
    worlds = 600
    sim = colliding(random_meeting(rng, gap=rng.uniform(1e-3, 0.95 * LIMIT)) for _ in range(worlds))
    for w in range(worlds):
        (p, rp), (q, rq) = core(sim, 2 * w), core(sim, 2 * w + 1)
        gap = contacts_of(sim, w)["gap"]
        assert len(gap), f"world {w}: hulls {hull_distance(p, q) - rp - rq} apart without a contact"
        assert gap.min() == pytest.approx(hull_distance(p, q) - rp - rq, abs=SLACK), f"world {w}"


def test_rounded_hulls_that_overlap_by_less_than_their_radii():
    rng = np.random.default_rng(12)
    worlds = 300
    sim = colliding(random_meeting(rng, gap=rng.uniform(1e-3, 0.2), more=0.15) for _ in range(worlds))
    for w in range(worlds):
        (p, rp), (q, rq) = core(sim, 2 * w), core(sim, 2 * w + 1)
        table = contacts_of(sim, w)
        expected = hull_distance(p, q) - rp - rq
        assert expected < 0
        assert len(table["gap"]), f"world {w}"
        assert table["gap"].min() == pytest.approx(expected, abs=SLACK), f"world {w}"


def test_overlapping_polygons_are_pushed_along_the_axis_of_least_overlap():
    rng = np.random.default_rng(13)
    worlds = 300
    sim = colliding(random_meeting(rng, depth=rng.uniform(1e-3, 0.2)) for _ in range(worlds))
    for w in range(worlds):
        (p, rp), (q, rq) = core(sim, 2 * w), core(sim, 2 * w + 1)
        table = contacts_of(sim, w)
        least = separation(p, q)
        n = table["normal"][0]
        assert (q @ n).min() - (p @ n).max() == pytest.approx(least, abs=SLACK), f"world {w}"
        # both points lie in the overlap, so none is deeper than the axis says
        assert table["gap"].min() >= least - rp - rq - SLACK, f"world {w}"
        assert table["gap"].min() <= 1e-9, f"world {w}"


def moved(meeting, turn, shift, mirror):
    """A meeting of two hulls turned, shifted and, if asked, mirrored at the y axis first."""
    result = []
    for (points, radius), (position, angle) in meeting:
        points, position = np.array(points), np.array(position)
        if mirror:
            points, position, angle = points * (-1, 1), position * (-1, 1), -angle
        result.append(((points, radius), (rotation(turn) @ position + shift, angle + turn)))
    return result


def normalised(table):
    order = np.lexsort(np.round(table["point"], 6).T)
    return table["gap"][order], table["normal"][order], table["point"][order]


def test_turning_shifting_mirroring_and_swapping_change_nothing_else():
    rng = np.random.default_rng(14)
    cases, meetings = [], []
    for i in range(200):
        kind = {"gap": rng.uniform(0, 0.9 * LIMIT)} if i % 2 else {"depth": rng.uniform(0.01, 0.2)}
        meeting = random_meeting(rng, **kind)
        turn, shift = rng.uniform(-4, 4), rng.uniform(-5, 5, 2)
        turned, mirrored = moved(meeting, turn, shift, False), moved(meeting, 0.0, 0.0, True)
        meetings += [meeting, turned, mirrored, meeting[::-1]]
        cases.append((turn, shift))
    sim = colliding(meetings)
    for i, (turn, shift) in enumerate(cases):
        plain, turned, mirrored, swapped = (contacts_of(sim, 4 * i + k) for k in range(4))
        expected = normalised(plain)
        back = {"gap": turned["gap"], "normal": turned["normal"] @ rotation(turn)}
        back["point"] = (turned["point"] - shift) @ rotation(turn)
        mirrored = {**mirrored, "normal": mirrored["normal"] * (-1, 1), "point": mirrored["point"] * (-1, 1)}
        for found in (back, mirrored):
            for a, b in zip(expected, normalised(found), strict=True):
                assert np.allclose(a, b, atol=1e-8), f"case {i}"
        # which hull's edge is the reference may differ where both are parallel; the nearest point may not
        assert swapped["gap"].min() == pytest.approx(plain["gap"].min(), abs=SLACK), f"case {i}"
        assert np.allclose(swapped["normal"][0], -plain["normal"][0], atol=1e-8), f"case {i}"


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_keys_name_shapes_are_unique_sorted_and_stable(dtype):
    rng = np.random.default_rng(15)
    builder = dc.ModelBuilder()
    for _ in range(2):
        new_world(builder, length_scale=None)
        ground = builder.add_body(type=STATIC)
        builder.add_chain(ground, [(-4, 4), (-4, -4), (4, -4), (4, 4)])
        for _ in range(40):
            body = builder.add_body(rng.uniform(-3.5, 3.5, 2), rng.uniform(-4, 4))
            for _ in range(rng.integers(1, 3)):
                points, radius = random_hull(rng, low=2)
                add_hull(builder, body, 0.3 * points + rng.uniform(-0.3, 0.3, 2), 0.3 * radius)
    sim = collide(builder, dtype)
    owner = sim.model.numpy("shape_body")
    old = []
    for w in range(2):
        table = contacts_of(sim, w)
        assert len(table["key"]) > 30
        assert (np.diff(table["key"]) > 0).all()
        a, b, _ = shapes_of_key(table["key"])
        first = sim.model.numpy("shape_start")[w]
        assert np.array_equal(owner[a + first], table["body_a"])
        assert np.array_equal(owner[b + first], table["body_b"])
        listed = {tuple(pair) for pair in pairs_of(sim, w)}
        assert {(x + first, y + first) for x, y in zip(a, b, strict=True)} <= listed
        old.append(table["key"])
    sim.state.numpy("position")[:] += rng.normal(0, 1e-6, sim.state.numpy("position").shape)
    sim.state.numpy("angle")[:] += rng.normal(0, 1e-6, len(sim.state.numpy("angle")))
    sim.collide(DT)
    for w in range(2):
        new = contacts_of(sim, w)["key"]
        assert len(np.intersect1d(new, old[w])) >= 0.95 * max(len(new), len(old[w]))


# ---------------------------------------------------------------------- closing gaps


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("stride", [0.3, 1.0])
@pytest.mark.parametrize("target", ["chain", "wall", "capsule", "disc"])
def test_fast_bodies_do_not_pass_through(target, stride, dtype):
    dt = 1 / 60
    builder = dc.ModelBuilder()
    movers = {"disc": disc(0.5), "box": box(0.5, 0.3), "capsule": capsule(0.5, 0.2)}
    names = list(movers)
    worlds = [(name, phase) for name in names for phase in np.linspace(0, 1, 5)]
    for name, phase in worlds:
        builder.add_world(gravity=(0, 0))
        wall = builder.add_body((0, 0), type=dc.BodyType.DYNAMIC if target == "disc" else STATIC)
        if target == "chain":
            builder.add_chain(wall, [(0, -5), (0, -1), (0, 0.1), (0, 5)])
        elif target == "wall":
            builder.add_box(wall, 0.01, 5)
        elif target == "capsule":
            builder.add_capsule(wall, (0, -5), (0, 5), 0.01)
        else:
            builder.add_disc(wall, 0.5)
        # a stride of 1 is a radius of 0.5 m in one step
        speed = stride * 0.5 / dt
        body = builder.add_body((-4 - phase * 0.5, 0.02), 0.2, velocity=(speed, 0))
        movers[name](builder, body)
    sim = simulate(builder, dtype)
    for _ in range(40):
        sim.step(dt)
        position = sim.state.numpy("position")
        ahead = position[0::2, 0] - position[1::2, 0]
        assert (ahead > 0.1).all()
    assert not sim.state.numpy("flags").any()


def test_a_contact_begins_when_the_gap_closes_within_the_step():
    for speed, expected in ((9.0, 0), (11.0, 1)):
        builder = new_world()
        builder.add_disc(builder.add_body((0, 0)), 0.5)
        builder.add_disc(builder.add_body((1.12, 0), velocity=(-speed, 0)), 0.5)
        sim = simulate(builder, config=dc.SolverConfig(speculative_max=0.02))
        # gap 0.12 against 0.02 + speed * dt
        sim.collide(0.01)
        assert len(contacts_of(sim)["gap"]) == expected


# ---------------------------------------------------------------------- chains


def slide(add, x, vertices, steps=200, dt=0.01, dtype="float64", speed=3.0, height=0.5, angle=0.0, gravity=(0, -9.8)):
    """Slide a body without friction over a chain; yields the simulation after each step."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=gravity)
    builder.add_chain(builder.add_body(type=STATIC), vertices, friction=0.0)
    add(builder, builder.add_body((x, height), angle, (speed, 0)))
    sim = simulate(builder, dtype, config=dc.SolverConfig(tolerance=1e-9))
    for _ in range(steps):
        sim.step(dt)
        yield sim


MOVERS = {"disc": disc(0.5), "box": box(0.5, 0.5), "capsule": capsule(0.7, 0.5), "rounded": box(0.4, 0.4, 0.1)}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("length", [0.1, 1.0])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("name", MOVERS)
def test_nothing_catches_on_a_flat_chain(name, order, length, dtype):
    flat = [(x, 0.0) for x in np.arange(-3, 8 + length / 2, length)]
    for sim in slide(MOVERS[name], 0.013, flat[::order], dtype=dtype):
        table = contacts_of(sim)
        assert len(table["gap"])
        assert np.allclose(table["normal"], (0, 1), atol=1e-3)
    assert sim.state.numpy("velocity")[1, 0] == pytest.approx(3.0, abs=1e-3)
    assert sim.state.numpy("position")[1, 1] == pytest.approx(0.5, abs=2e-3)
    assert sim.state.numpy("angle")[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("turn", [0.0, 0.3, -1.1, math.pi])
@pytest.mark.parametrize("name", MOVERS)
def test_a_body_rests_exactly_above_a_joint_of_the_chain(name, turn):
    around = rotation(turn)
    flat = np.array([(x, 0.0) for x in range(-5, 6)]) @ around.T
    builder = dc.ModelBuilder()
    builder.add_world(gravity=around @ (0, -9.8))
    builder.add_chain(builder.add_body(type=STATIC), flat)
    bodies = []
    for x in (-3.0, 0.0, 3.0):
        bodies.append(builder.add_body(around @ (x, 0.5), turn))
        MOVERS[name](builder, bodies[-1])
    sim = simulate(builder)
    for _ in range(30):
        sim.step(0.01)
        assert np.isin(bodies, contacts_of(sim)["body_b"]).all()
    heights = sim.state.numpy("position")[bodies] @ around[:, 1]
    assert heights == pytest.approx([0.5] * 3, abs=2e-3)


@pytest.mark.parametrize("name", MOVERS)
@pytest.mark.parametrize("slope", [0.2, -0.2])
def test_bodies_slide_over_a_bend_without_falling_through(name, slope):
    """Over a concave corner uphill, or a convex one downhill, and joints that are flat up to round-off."""
    bend = [(-3, 0), (-1, 0), (1.0, 0.0), (2.0, slope), (5.0, 4 * slope), (12.0, 11 * slope)]
    for sim in slide(MOVERS[name], -0.5, bend, steps=150):
        body = core(sim, sim.model.shape_count - 1)
        points, radius = body
        ground = np.interp(points[:, 0], *np.array(bend).T)
        assert (points[:, 1] - radius * math.hypot(1, slope) > ground - 0.05).all()
    velocity = sim.state.numpy("velocity")[1]
    x, y = sim.state.numpy("position")[1]
    assert x > 2.5
    # neither stopped at the corner nor thrown off: energy never grows, and an inelastic corner takes little
    gyration = sim.model.numpy("inertia")[1] / sim.model.numpy("mass")[1]
    spin = sim.state.numpy("angular_velocity")[1]
    energy = velocity @ velocity / 2 + gyration * spin * spin / 2 + 9.8 * (y - 0.5)
    assert 0.75 * 4.5 < energy < 4.5 * 1.01


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("side", [1, -1])
def test_disc_exactly_at_a_joint_of_a_flat_chain_touches_it(side, order, dtype):
    """The two segments may not both leave the joint to the other; where round-off turns the chain, both may keep it."""
    for turn in (0.0, 0.3, -1.1, 2.0, math.pi):
        flat = np.array([(-2, 0), (-1, 0), (0, 0), (1, 0), (2, 0)])[::order] @ rotation(turn).T
        up = rotation(turn) @ (0, side)
        table = two(chained(flat), disc(0.5), b=(0.505 * up, 0.0), dtype=dtype, type=STATIC)
        assert len(table["gap"]) in ((1,) if turn == 0.0 else (1, 2))
        assert np.allclose(table["gap"], 0.005, atol=1e-6)
        assert np.allclose(table["normal"], up, atol=1e-6)


def test_box_near_a_convex_corner_overlaps_only_what_it_touches():
    """Clipped to the extension of the other segment, the box's corner seemed 38 mm deep where it is 3.6 mm off."""
    chain = [(-2, 0), (0, 0), (2, -1)]
    for x in np.linspace(-0.3, 0.3, 25):
        for turn in (math.pi / 4 - 0.05, math.pi / 4, 0.1, -0.1):
            # 1 mm above the chain, vertically: nearest there is a corner of the box or that of the chain, at x = 0
            corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) @ rotation(turn).T + (x, 0.0)
            edges = np.roll(corners, -1, axis=0) - corners
            t = -corners[:, 0] / edges[:, 0]
            above_corner = (corners[:, 1] + t * edges[:, 1])[(t > 0) & (t < 1)]
            y = 1e-3 - min(*(corners[:, 1] - np.interp(corners[:, 0], *np.array(chain).T)), *above_corner)
            table = two(chained(chain), box(0.5, 0.5), b=((x, y), turn), type=STATIC)
            assert len(table["gap"]), (x, turn)
            assert 0 < table["gap"].min() < 1e-3 + 1e-9, (x, turn)
    table = two(chained(chain), box(0.5, 0.5), b=((0.06534061, 0.69522308), math.pi / 4 - 0.05), type=STATIC)
    assert table["gap"].min() == pytest.approx(0.004 * math.cos(math.atan(0.5)), abs=1e-6)


def test_disc_in_a_concave_corner_touches_both_sides():
    table = two(
        lambda builder, body: builder.add_chain(body, [(-2, 2), (0, 0), (2, 2)]),
        disc(0.5),
        b=((0, 0.5 * math.sqrt(2)), 0.0),
        type=STATIC,
    )
    assert table["gap"] == pytest.approx([0, 0], abs=1e-12)
    assert np.allclose(np.sort(table["normal"][:, 0]), [-math.sqrt(0.5), math.sqrt(0.5)])


def test_disc_on_a_convex_corner_touches_it_once():
    for angle in (math.pi / 2, math.pi / 2 + 0.5, math.pi / 2 - 0.5):
        center = 0.505 * np.array((math.cos(angle), math.sin(angle)))
        table = two(
            lambda builder, body: builder.add_chain(body, [(-2, -2), (0, 0), (2, -2)]),
            disc(0.5),
            b=(center, 0.0),
            type=STATIC,
        )
        assert table["gap"] == pytest.approx([0.005])
        assert np.allclose(table["normal"], center / 0.505)
