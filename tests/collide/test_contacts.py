"""What contacts carry from step to step: impulses, colours and ages by key."""

import dataclasses
import math

import numpy as np
import pytest

import dc_kernels as dc
from tests.geometry import contacts_of, simulate

STATIC = dc.BodyType.STATIC


def tumble(dtype="float64", worlds=2, joint=False, **options):
    """Worlds of discs and boxes that fall on a floor and on each other."""
    builder = dc.ModelBuilder()
    rng = np.random.default_rng(5)
    for _ in range(worlds):
        builder.add_world()
        builder.add_box(builder.add_body((0, -0.5), type=STATIC), 10, 0.5)
        bodies = []
        for i in range(24):
            bodies.append(
                builder.add_body((0.9 * (i % 6) + rng.uniform(-0.1, 0.1), 0.5 + 0.9 * (i // 6)), rng.uniform(-3, 3))
            )
            if i % 3:
                builder.add_disc(bodies[-1], rng.uniform(0.3, 0.45))
            else:
                builder.add_box(bodies[-1], 0.35, 0.25)
        if joint:
            builder.add_distance_joint(bodies[0], bodies[20])
    return simulate(builder, dtype, **options)


def by_key(sim, world, *names):
    table = contacts_of(sim, world)
    return {int(key): tuple(table[name][i] for name in names) for i, key in enumerate(table["key"])}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_contact_starts_from_its_last_impulse_and_a_new_one_from_zero(dtype):
    sim = tumble(dtype)
    dt = 0.01
    new = kept = lost = 0
    before = [{}, {}]
    for _ in range(60):
        sim.collide(dt)
        for w in range(2):
            start = by_key(sim, w, "impulse", "color", "age")
            for key, (impulse, color, age) in start.items():
                if key in before[w]:
                    last, last_color, last_age = before[w][key]
                    assert np.array_equal(impulse, last)
                    assert color == last_color
                    assert age == last_age + 1
                    kept += bool(last.any())
                else:
                    assert not impulse.any()
                    assert age == 0
                    new += 1
            lost += len(before[w].keys() - start.keys())
        sim.solve()
        sim.advance()
        before = [by_key(sim, w, "impulse", "color", "age") for w in range(2)]
    assert kept > 500
    assert new > 50
    assert lost > 10


def test_cached_impulses_grow_with_the_time_step():
    sim = tumble(joint=True)
    sim.run(40, 0.01)
    solved = [by_key(sim, w, "impulse") for w in range(2)]
    joints = sim.joints.numpy("joint_impulse").copy()
    assert joints.all()
    for dt in (0.01, 0.0025, 0.02):
        sim.collide(dt)
        compared = 0
        for w in range(2):
            for key, (impulse,) in by_key(sim, w, "impulse").items():
                if key in solved[w]:
                    assert np.allclose(impulse, solved[w][key][0] * (dt / 0.01), rtol=1e-12, atol=0)
                    compared += 1
        assert compared > 40
        assert np.allclose(sim.joints.numpy("joint_impulse"), joints * (dt / 0.01), rtol=1e-12, atol=0)


def test_a_changed_time_step_keeps_a_resting_stack_at_rest():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body((0, -0.5), type=STATIC), 10, 0.5)
    for i in range(4):
        builder.add_disc(builder.add_body((0, 0.5 + i)), 0.5)
    sim = simulate(builder, config=dc.SolverConfig(tolerance=1e-10, max_sweeps=10000, min_sweeps=1))
    mass = float(sim.model.numpy("mass")[1])
    for dt in (0.01, 0.01, 0.002, 0.03, 0.01):
        sim.step(dt)
        impulse = contacts_of(sim)["impulse"][:, 0]
        assert np.sort(impulse) == pytest.approx(mass * 9.8 * dt * np.arange(1, 5), rel=1e-6)
    # scaled impulses are already the solution
    sim.collide(0.005)
    assert np.sort(contacts_of(sim)["impulse"][:, 0]) == pytest.approx(mass * 9.8 * 0.005 * np.arange(1, 5), rel=1e-6)
    sim.solve()
    assert sim.stats.numpy("sweeps")[0] <= 2


def test_start_zero_forgets_impulses_but_not_colours_and_ages():
    sim = tumble(joint=True, config=dc.SolverConfig(start="zero"))
    sim.run(30, 0.01)
    solved = by_key(sim, 0, "impulse", "color", "age")
    sim.collide(0.01)
    start = by_key(sim, 0, "impulse", "color", "age")
    common = solved.keys() & start.keys()
    assert len(common) > 10
    assert any(solved[key][0].any() for key in common)
    for key in common:
        assert not start[key][0].any()
        assert start[key][1] == solved[key][1]
        assert start[key][2] == solved[key][2] + 1
    assert not sim.joints.numpy("joint_impulse").any()


def test_the_start_may_change_between_steps():
    sim = tumble()
    sim.run(30, 0.01)
    sim.config = dataclasses.replace(sim.config, start="zero")
    sim.collide(0.01)
    assert not contacts_of(sim)["impulse"].any()
    sim.config = dataclasses.replace(sim.config, start="cache")
    sim.collide(0.01)
    assert contacts_of(sim)["impulse"].any()


def test_colliding_twice_gives_the_same_contacts():
    sim = tumble()
    sim.run(40, 0.01)
    sim.collide(0.01)
    first = contacts_of(sim)
    sim.solve()
    sim.collide(0.01)
    again = contacts_of(sim)
    assert len(first["key"]) > 20
    for name in first:
        assert np.array_equal(first[name], again[name])


def test_a_contact_that_was_away_begins_anew():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    builder.add_discs([(0, 0), (0.99, 0)], 0.5)
    sim = simulate(builder)
    sim.state.numpy("force")[:] = [(1, 0), (-1, 0)]
    sim.run(3, 0.01)
    (key,) = contacts_of(sim)["key"]
    assert contacts_of(sim)["age"].tolist() == [2]
    assert contacts_of(sim)["impulse"][0, 0] > 0
    place = sim.state.numpy("position")[1].copy()
    sim.state.numpy("position")[1] = (5, 5)
    sim.step(0.01)
    assert not len(contacts_of(sim)["key"])
    sim.state.numpy("position")[1] = place
    sim.collide(0.01)
    table = contacts_of(sim)
    assert table["key"].tolist() == [key]
    assert table["age"].tolist() == [0]
    assert not table["impulse"].any()


def test_the_cache_survives_growth_of_capacity():
    small = tumble(contacts_per_body=0.05, pairs_per_shape=0.1)
    large = tumble(contacts_per_body=20.0, pairs_per_shape=50.0)
    for _ in range(40):
        for sim in (small, large):
            sim.step(0.01)
        for w in range(2):
            one, other = contacts_of(small, w), contacts_of(large, w)
            for name in one:
                assert np.array_equal(one[name], other[name]), name
    assert len(one["key"]) > 20


def test_friction_and_restitution_are_mixed_by_the_stated_rule():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    builder.add_disc(builder.add_body((0, 0)), 0.5, friction=0.2, restitution=0.1)
    builder.add_disc(builder.add_body((1, 0)), 0.5, friction=0.8, restitution=0.4)
    sim = simulate(builder)
    sim.collide(0.01)
    assert contacts_of(sim)["friction"] == pytest.approx([math.sqrt(0.2 * 0.8)])
    assert sim.contacts.numpy("restitution")[0] == pytest.approx(0.4)
