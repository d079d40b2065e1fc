"""The start strategies of the thesis protocol."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.scenes import Chain, Settled, Thesis
from pipeline.starts.impulses import Random
from pipeline.starts.registry import maker

PGS = dc.SolverConfig.preset("accurate", acceleration="none", max_sweeps=5000, min_sweeps=1)


def settled(worlds: int = 2, bodies: int = 12, config: dc.SolverConfig = PGS) -> dc.Simulation:
    """Small piles, a few steps old, with the contacts of the next step found."""
    sim = dc.Simulation(*Settled(bodies=bodies).build(worlds).finalize("float64"), config=config)
    sim.run(5, 0.01)
    sim.collide(0.01)
    return sim


def impulses(sim: dc.Simulation) -> np.ndarray:
    """Of the present contacts, world after world."""
    return sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]].copy()


def test_none_is_zero():
    sim = settled()
    assert impulses(sim).any()
    maker("none")(sim).write()
    assert len(impulses(sim))
    assert not impulses(sim).any()


def test_none_forgets_joints_too():
    sim = dc.Simulation(*Chain(bodies=3).build().finalize("float64"))
    sim.step(0.01)
    sim.collide(0.01)
    assert sim.joints.numpy("joint_impulse").any()
    maker("none")(sim).write()
    assert not sim.joints.numpy("joint_impulse").any()


def test_none_forgets_rolling_resistance_too():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(1.0, -9.8))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5, center=(0.0, -0.5))
    builder.add_disc(builder.add_body((0.0, 0.5)), 0.5, rolling_resistance=0.3)
    sim = dc.Simulation(*builder.finalize("float64", backend="numpy"))
    sim.run(5, 0.01)
    start = maker("none")(sim)
    sim.collide(0.01)
    assert sim.contacts.numpy("rolling_impulse")[0] != 0
    start(sim)
    assert sim.contacts.numpy("rolling_impulse")[0] == 0


def test_builtin_is_the_impulse_of_the_step_before():
    sim = dc.Simulation(*Settled(bodies=12).build(2).finalize("float64"), config=PGS)
    sim.run(5, 0.01)
    before = dict(zip(keys(sim), impulses(sim)))
    sim.collide(0.01)
    maker("builtin")(sim).write()
    kept = [key in before for key in keys(sim)]
    assert any(kept)
    for key, impulse in zip(keys(sim), impulses(sim)):
        np.testing.assert_array_equal(impulse, before.get(key, np.zeros(2)))


def keys(sim: dc.Simulation) -> list[tuple[int, int]]:
    """World and key of the present contacts."""
    slots, world = contact_slots(sim.contacts)
    return list(zip(world.tolist(), sim.contacts.numpy("key")[slots].tolist()))


def test_builtin_needs_the_cache():
    sim = settled(config=dataclasses.replace(PGS, start="zero"))
    with pytest.raises(ValueError, match="needs 'cache'"):
        maker("builtin")(sim).write()


def test_bad_is_fifty():
    sim = settled()
    maker("bad")(sim).write()
    np.testing.assert_array_equal(impulses(sim), 50.0)


def test_random_is_uniform_seeded_and_independent_of_the_batch():
    sim = settled(worlds=3, bodies=30)
    maker("random", 7)(sim).write()
    drawn = impulses(sim)
    assert len(drawn) > 100
    assert ((drawn >= [0.0, -2.0]) & (drawn <= [5.0, 2.0])).all()
    np.testing.assert_allclose(drawn.mean(axis=0), [2.5, 0.0], atol=0.5)
    assert (drawn.max(axis=0) > [4.5, 1.8]).all()
    maker("random", 7)(sim).write()
    np.testing.assert_array_equal(impulses(sim), drawn)
    maker("random", 8)(sim).write()
    other = impulses(sim)
    assert (other != drawn).any()
    counts = sim.contacts.numpy("contact_count")  # world w of seed s draws as world 0 of seed s + w
    common = min(counts[:2])
    np.testing.assert_array_equal(other[:common], drawn[counts[0] : counts[0] + common])


def test_random_goes_on_from_step_to_step():
    sim = settled()
    strategy = Random(sim, 3)
    strategy.write()
    first = impulses(sim)
    strategy.write()
    assert (impulses(sim) != first).all()


def test_copy_starts_at_the_solution():
    sim = settled()
    maker("copy")(sim).write()
    assert (dc.to_numpy(sim.stats.sweeps) > 1).all()
    start = impulses(sim)
    sim.solve()
    np.testing.assert_array_equal(dc.to_numpy(sim.stats.sweeps), 1)
    np.testing.assert_allclose(impulses(sim), start, atol=2.0 * PGS.ends_at[1])
    sim.advance()


@pytest.mark.parametrize("decimals", [0, 2, 12])
def test_copy_is_rounded(decimals):
    sim = settled()
    state = sim.state.numpy("velocity").copy()
    sim.solve()
    solution = impulses(sim)
    np.testing.assert_array_equal(sim.state.numpy("velocity"), state)  # nothing has happened yet
    sim = settled()
    maker(f"Copy{decimals}")(sim).write()
    np.testing.assert_array_equal(impulses(sim), np.round(solution, decimals))


def test_every_strategy_reaches_the_same_velocities():
    """Frictionless discs: the velocities after a step are unique, so the start must not show in them."""
    config = dc.SolverConfig(tolerance=1e-10, max_sweeps=100_000)
    ends = []
    for name in ("none", "builtin", "random", "bad", "copy", "copy1"):
        builder = Thesis(bodies=10, friction=0.0).build(2)
        sim = dc.Simulation(*builder.finalize("float64"), config=config)
        sim.run(60, 0.01)
        sim.step(0.01, start=maker(name)(sim))
        ends.append(sim.state.numpy("velocity").copy())
        assert (dc.to_numpy(sim.stats.sweeps) < config.max_sweeps).all()
    assert len(impulses(sim)) > 5
    assert np.ptp(ends[0]) > 0.0
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-6)


@pytest.mark.parametrize("name", ["", "copy-1", "copy2.5", "grid2", "copyN", "nonee"])
def test_unknown_names_raise(name):
    with pytest.raises(ValueError, match=r"it must be one of .*, copyN with N decimals, or the file of a trained"):
        maker(name)


def test_negative_seed_raises():
    with pytest.raises(ValueError, match="seed is -1"):
        maker("random", -1)


def test_no_contacts_is_no_error():
    sim = dc.Simulation(*Thesis(bodies=1, gravity=0.0).build(2).finalize("float64"))
    for name in ("none", "random", "bad", "copy2"):
        sim.step(0.001, start=maker(name)(sim))
        assert len(impulses(sim)) == 0
