"""Colours of the constraint graph: valid, few, deterministic, kept; and what happens when they run out."""

import dataclasses
import math

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels.solve.rows import SERIAL_COLOR
from tests.geometry import contacts_of, simulate

STATIC = dc.BodyType.STATIC


def pile(builder, rng, bodies, joints=0, length=3.0):
    """A world of discs, boxes and a floor, overlapping here and there, with distance joints between some."""
    builder.add_world()
    floor = builder.add_body((0, -length), type=STATIC)
    builder.add_box(floor, 2 * length, 0.5)
    first = None
    for _ in range(bodies):
        kind = dc.BodyType.KINEMATIC if rng.random() < 0.1 else dc.BodyType.DYNAMIC
        body = builder.add_body(rng.uniform(-length, length, 2), rng.uniform(-3, 3), type=kind)
        first = body if first is None else first
        if rng.random() < 0.7:
            builder.add_disc(body, rng.uniform(0.2, 0.5))
        else:
            builder.add_box(body, rng.uniform(0.2, 0.5), 0.3)
    added = 0
    while added < joints:
        a, b = (int(i) for i in rng.integers(first, first + bodies, 2))
        try:
            builder.add_distance_joint(a, b)
        except ValueError:  # the same body twice, or two kinematic ones
            continue
        added += 1


def constraints_of(sim, world=0):
    """Bodies (n, 2) and colours (n,) of all constraints of a world, joints first."""
    table = contacts_of(sim, world)
    first, last = sim.model.numpy("joint_start")[world : world + 2]
    joints = [sim.joints.numpy(f"joint_body_{side}")[first:last] for side in "ab"]
    bodies = np.concatenate([np.stack(joints, axis=1), np.stack([table["body_a"], table["body_b"]], axis=1)])
    return bodies, np.concatenate([sim.joints.numpy("joint_color")[first:last], table["color"]])


def conflicts(sim, bodies):
    """Pairs of constraints that share a dynamic body, (m, 2) int32."""
    dynamic = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    at = {}
    for i, pair in enumerate(bodies):
        for body in pair:
            if dynamic[body]:
                at.setdefault(int(body), []).append(i)
    shared = {(i, j) for group in at.values() for n, i in enumerate(group) for j in group[n + 1 :]}
    return np.array(sorted(shared), np.int32).reshape(-1, 2)


def most_constraints(sim, bodies):
    dynamic = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    count = np.bincount(bodies.ravel(), minlength=sim.model.body_count)
    return int(count[dynamic].max(initial=0))


def check_colors(sim, world=0):
    """Validity; returns the number of colours used, the constraints' bodies and their conflicts."""
    bodies, colors = constraints_of(sim, world)
    assert ((colors >= 0) & (colors <= SERIAL_COLOR)).all()
    edges = conflicts(sim, bodies)
    clash = colors[edges[:, 0]] == colors[edges[:, 1]]
    assert (colors[edges[clash, 0]] == SERIAL_COLOR).all()
    return len(np.unique(colors)), bodies, edges


def warp_colors(count, edges):
    """Colours of the constraints by Warp's own graph colouring."""
    colors = wp.zeros(count, dtype=wp.int32, device="cpu")
    used = wp.utils.graph_coloring_assign(wp.array(edges, dtype=wp.int32, device="cpu"), colors)
    return colors.numpy(), used


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 80), st.integers(0, 10))
def test_no_two_constraints_of_a_colour_share_a_dynamic_body(seed, bodies, joints):
    rng = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    pile(builder, rng, bodies + 3, joints)
    sim = simulate(builder)
    sim.step(0.01)
    used, pairs, _ = check_colors(sim)
    # a greedy colouring needs fewer than twice the constraints of the busiest body
    assert used <= max(2 * most_constraints(sim, pairs) - 1, 1)
    for _ in range(3):
        sim.step(0.01)
        check_colors(sim)


def test_as_few_colours_as_warps_graph_colouring_or_nearly():
    rng = np.random.default_rng(2)
    builder = dc.ModelBuilder()
    for bodies in (30, 100, 300):
        pile(builder, rng, bodies, joints=5, length=0.35 * math.sqrt(bodies))
    sim = simulate(builder)
    sim.collide(0.01)
    for w in range(3):
        used, bodies, edges = check_colors(sim, w)
        assert len(bodies) > 30
        oracle, least = warp_colors(len(bodies), edges)
        # the oracle agrees about what a conflict is
        assert (oracle[edges[:, 0]] != oracle[edges[:, 1]]).all()
        degree = most_constraints(sim, bodies)
        assert degree <= used <= min(2 * degree - 1, least + 3)
        assert least >= degree


def test_colours_are_kept_while_contacts_last_and_stay_valid():
    builder = dc.ModelBuilder()
    pile(builder, np.random.default_rng(4), 80, joints=4)
    sim = simulate(builder)
    old, kept = {}, 0
    joint_colors = None
    for _ in range(40):
        sim.step(0.01)
        check_colors(sim)
        table = contacts_of(sim)
        new = dict(zip(table["key"].tolist(), table["color"].tolist(), strict=True))
        for key, color in old.items():
            assert new.get(key, color) == color
            kept += key in new
        old = new
        colors = sim.joints.numpy("joint_color").copy()
        assert joint_colors is None or np.array_equal(colors, joint_colors)
        joint_colors = colors
    assert kept > 1000


def test_colours_are_the_same_in_each_run_and_for_any_threads():
    def run(threads):
        builder = dc.ModelBuilder()
        for seed in range(4):
            pile(builder, np.random.default_rng(seed), 40, joints=3)
        sim = simulate(builder, threads=threads)
        sim.run(10, 0.01)
        return [constraints_of(sim, w)[1] for w in range(4)]

    first = run(1)
    assert all(len(colors) > 20 for colors in first)
    for threads in (1, 2):
        for a, b in zip(first, run(threads), strict=True):
            assert np.array_equal(a, b)


def test_static_and_kinematic_bodies_do_not_conflict():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body((0, -0.5), type=STATIC), 100, 0.5)
    builder.add_discs([(2.0 * i, 0.5) for i in range(40)], 0.5)
    builder.add_box(builder.add_body((40, 1.5), type=dc.BodyType.KINEMATIC), 100, 0.5)
    sim = simulate(builder)
    sim.collide(0.01)
    table = contacts_of(sim)
    assert len(table["color"]) == 80
    assert set(table["color"].tolist()) == {0, 1}


def crowd(count, dtype, **options):
    """A large disc that rests on many small ones in a ring, each of which rests on the floor of a round pit."""
    builder = dc.ModelBuilder()
    builder.add_world()
    radius = 0.05
    # the small discs touch the large one and their two neighbours but for a little
    big = (radius * 1.02) / math.sin(math.pi / (2 * count)) - radius
    angles = math.pi + (np.arange(count) + 0.5) * math.pi / count
    ring = (big + radius) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = np.linspace(math.pi, 2 * math.pi, 8 * count + 1)
    pit = builder.add_body(type=STATIC)
    outer = (big + 2 * radius) / math.cos(math.pi / (16 * count))
    builder.add_chain(pit, outer * np.stack([np.cos(corners), np.sin(corners)], axis=1))
    builder.add_disc(builder.add_body((0, 0)), big, friction=0.0)
    # as heavy as the large one: mass ratios are not what is tested here
    builder.add_discs(ring, radius, friction=0.0, density=(big / radius) ** 2)
    return simulate(builder, dtype, **options), big


@pytest.mark.parametrize("method", ["pgs", "jacobi"])
def test_more_contacts_at_a_body_than_colours(method):
    config = dc.SolverConfig(method=method, acceleration="nncg", tolerance=3e-4, max_sweeps=5000, stop="residual")
    sim, big = crowd(130, "float64", config=config)
    dt = 0.005
    sim.collide(dt)
    check_colors(sim)
    table = contacts_of(sim)
    at_big = (table["body_a"] == 1) | (table["body_b"] == 1)
    assert at_big.sum() == 130
    serial = table["color"] == SERIAL_COLOR
    assert serial.sum() > 130 - SERIAL_COLOR - 1
    # at the large disc no other colour is in use twice; a few are taken by the small discs' contacts with the pit
    others = table["color"][at_big & ~serial]
    assert len(np.unique(others)) == len(others) >= SERIAL_COLOR - 5
    sim.solve()
    assert sim.stats.numpy("residual")[0] < 3e-4
    sim.advance()
    table = contacts_of(sim)
    # what the rows solved is what the bodies got: momentum of every disc, from the contacts alone
    mass = sim.model.numpy("mass")
    gained = np.zeros((sim.model.body_count, 2))
    n, (pn, pt) = table["normal"], table["impulse"].T
    push = n * pn[:, None] + np.stack([n[:, 1], -n[:, 0]], axis=1) * pt[:, None]
    np.add.at(gained, table["body_b"], push)
    np.add.at(gained, table["body_a"], -push)
    expected = mass[:, None] * ((0.0, -9.8 * dt) - sim.state.numpy("velocity")) + gained
    assert np.allclose(expected[1:], 0, atol=1e-9 * mass.max())
    assert (pn >= 0).all()
    # nothing approaches by more than its gap, and what presses does not part
    velocity, spin = sim.state.numpy("velocity"), sim.state.numpy("angular_velocity")
    ends = []
    for side in "ab":
        body, arm = table[f"body_{side}"], table[f"arm_{side}"]
        ends.append(velocity[body] + spin[body, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
    normal_speed = ((ends[1] - ends[0]) * n).sum(axis=1)
    assert (normal_speed + np.maximum(table["gap"], 0) / dt > -0.02 * 9.8 * dt).all()
    assert (np.abs(normal_speed[(pn > 0.1 * pn.max()) & (table["gap"] < 1e-6)]) < 0.02 * 9.8 * dt).all()
    # the large disc goes on resting on the small ones
    sim.run(20, dt)
    assert -0.02 * big < sim.state.numpy("position")[1, 1] < 0.02 * big


@pytest.mark.parametrize("count", [60, 130])
def test_acceleration_does_not_stall_on_a_crowded_body(count):
    left = {}
    for acceleration in ("none", "sor", "aitken", "nncg"):
        config = dc.SolverConfig(acceleration=acceleration, tolerance=0.0, max_sweeps=2000)
        sim, _ = crowd(count, "float64", config=config)
        sim.collide(0.005)
        sim.solve()
        left[acceleration] = float(sim.stats.numpy("residual")[0])
    # the plain sweep leaves 2e-4; an extrapolation that undoes each period's progress leaves 5e-2 for ever
    assert max(left.values()) < 5 * left["none"]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_default_acceleration_converges_on_a_crowded_body(dtype):
    """Without plain sweeps in between, the extrapolation cycles here for ever."""
    sim, _ = crowd(60, dtype, config=dc.SolverConfig(tolerance=1e-6, max_sweeps=20_000))
    sim.collide(0.005)
    sim.solve()
    assert sim.stats.numpy("sweeps")[0] < 20_000
    assert sim.stats.numpy("change")[0] < 1e-6
    assert sim.stats.numpy("residual")[0] < 1e-6


def test_the_serial_colour_gives_the_same_bits_in_either_schedule():
    impulses = []
    for schedule in ("world", "color"):
        sim, _ = crowd(100, "float32", schedule=schedule, config=dc.SolverConfig(max_sweeps=50))
        for _ in range(5):
            sim.step(0.005)
        assert (contacts_of(sim)["color"] == SERIAL_COLOR).any()
        impulses.append(contacts_of(sim)["impulse"])
    assert impulses[0].any()
    assert np.array_equal(*impulses)


def test_contacts_leave_the_serial_colour_when_there_is_room():
    sim, _ = crowd(100, "float64", config=dc.SolverConfig(max_sweeps=50))
    sim.step(0.005)
    serial = contacts_of(sim)
    assert (serial["color"] == SERIAL_COLOR).sum() > 30
    # without half of the small discs
    small = np.arange(2, sim.model.body_count)
    sim.state.numpy("position")[small[::2], 1] += 100.0
    sim.config = dataclasses.replace(sim.config, max_sweeps=60)
    sim.step(0.005)
    check_colors(sim)
    table = contacts_of(sim)
    at_big = (table["body_a"] == 1) | (table["body_b"] == 1)
    assert 40 <= at_big.sum() <= 50
    assert (table["color"] != SERIAL_COLOR).all()


# ---------------------------------------------------------------------- graphs of other engines


def graph(rng, bodies=40, contacts=90, worlds=3):
    """Contacts at random in several worlds, with a third of the bodies fixed; arguments of ``dc.color`` by name."""
    first = bodies * np.arange(worlds + 1)
    ends = np.concatenate(
        [first[w] + np.stack([rng.permutation(bodies)[:2] for _ in range(contacts)]) for w in range(worlds)]
    )
    body_a, body_b = np.ascontiguousarray(ends.T, np.int32)
    return {
        "body_a": body_a,
        "body_b": body_b,
        "movable": rng.random(bodies * worlds) < 2 / 3,
        "body_start": first,
        "contact_start": contacts * np.arange(worlds + 1),
    }


def check_graph(found, colors):
    """No two contacts of a colour share a body that moves; returns the most contacts of one."""
    most = 0
    for body in np.flatnonzero(found["movable"]):
        at = colors[(found["body_a"] == body) | (found["body_b"] == body)]
        at = at[at != SERIAL_COLOR]
        assert len(set(at.tolist())) == len(at)
        most = max(most, len(at))
    return most


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_contacts_of_any_engine_are_coloured(backend):
    found = graph(np.random.default_rng(1))
    colors = dc.color(**found, backend=backend)
    assert colors.dtype == np.int32 and colors.min() == 0
    assert colors.max() < 2 * check_graph(found, colors) - 1
    np.testing.assert_array_equal(colors, dc.color(**found))
    alone = {k: v[:90] for k, v in found.items() if k in ("body_a", "body_b")}  # worlds know nothing of each other
    np.testing.assert_array_equal(colors[:90], dc.color(**alone, movable=found["movable"][:40]))


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_colours_are_kept_where_they_may_be(backend):
    found = graph(np.random.default_rng(2))
    first = dc.color(**found)
    np.testing.assert_array_equal(dc.color(**found, color=first.copy(), backend=backend), first)
    kept = first.copy()
    new = np.random.default_rng(3).random(len(kept)) < 0.3
    kept[new] = -1
    kept[5], kept[6] = 1000, -9  # none
    kept[7] = kept[8] = 3
    given = kept.copy()
    colors = dc.color(**found, color=kept, backend=backend)
    assert colors is kept
    check_graph(found, colors)
    others = ~new
    others[[5, 6, 7, 8]] = False
    changed = others & (colors != first)
    for c in np.flatnonzero(changed):  # only for another that came earlier, and has its colour
        ends = {body for body in (found["body_a"][c], found["body_b"][c]) if found["movable"][body]}
        rivals = np.flatnonzero((given == given[c]) & (np.arange(len(given)) < c))
        assert any({found["body_a"][r], found["body_b"][r]} & ends for r in rivals)


def test_more_contacts_of_a_body_than_colours_are_serial():
    hub = {"body_a": np.zeros(100, np.int32), "body_b": np.arange(1, 101, dtype=np.int32)}
    colors = dc.color(**hub, movable=np.ones(101))
    np.testing.assert_array_equal(colors, np.minimum(np.arange(100), SERIAL_COLOR))
    assert (dc.color(**hub, movable=np.r_[0.0, np.ones(100)]) == 0).all()
    np.testing.assert_array_equal(dc.color(**hub, movable=np.ones(101), color=colors.copy()), colors)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"body_a": np.array([0, 5], np.int32)}, r"body_a\[1\] is 5; it must be a body of its world, in \[0, 2\]"),
        ({"body_b": np.array([1, 1], np.int32)}, r"body_b\[1\] is 1; .* another than"),
        ({"body_a": np.zeros(2)}, "body_a has dtype float64; it must be int32"),
        ({"body_b": np.zeros(3, np.int32)}, r"body_b has shape \(3,\)"),
        ({"movable": "all"}, r"movable is .all.; it must be \(N,\) bool or numbers"),
        ({"movable": [0.0, np.nan, 1.0]}, r"movable\[1\] is nan; it must be finite"),
        ({"color": np.zeros(2)}, "color has dtype"),
        ({"contact_start": [0, 1, 2]}, "contact_start has 2 worlds, body_start 1"),
        ({"backend": "x"}, "backend is 'x'"),
    ],
)
def test_bad_graphs_are_named(changes, message):
    found = {"body_a": np.array([0, 1], np.int32), "body_b": np.array([1, 2], np.int32), "movable": np.ones(3)}
    with pytest.raises(ValueError, match=message):
        dc.color(**(found | changes))


def test_colouring_refuses_to_be_recorded():
    with wp.ScopedCapture(device="cpu"), pytest.raises(RuntimeError, match="color cannot be recorded"):
        dc.color(np.zeros(0, np.int32), np.zeros(0, np.int32), [])
