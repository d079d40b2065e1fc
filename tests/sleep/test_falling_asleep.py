"""Bodies at rest fall asleep, and keep every bit while they sleep."""

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.stages import SLEEP
from tests.sleep.yard import (
    ALL,
    DT,
    EVERY,
    LINKED,
    ON_PLATFORM,
    ON_SHELF,
    SLEEP_CONFIG,
    SOFT,
    STACK,
    asleep_in,
    contacts_of,
    shot,
    simulation,
    state_bits,
)


def test_what_rests_falls_asleep_and_keeps_every_bit(at_rest):
    sim = at_rest.clone()
    before, contacts, time = state_bits(sim), contacts_of(sim), sim.state.numpy("time")[0]
    ages = sim.contacts.numpy("age").tobytes()
    sim.run(300, DT)
    sim.step(DT)
    assert state_bits(sim) == before
    assert contacts_of(sim) == contacts
    assert sim.contacts.numpy("age").tobytes() == ages
    assert not sim.state.numpy("velocity").any()
    assert sim.state.numpy("time")[0] == pytest.approx(time + 301 * DT)
    assert sim.stats.numpy("sweeps")[0] == 0
    assert not sim.state.numpy("flags").any() and not sim.running.any()
    weight = 9.81 * sim.model.numpy("mass")
    np.testing.assert_allclose(dc.net_contact_forces(sim).force[list(ALL), 1], weight[list(ALL)], rtol=2e-3)
    assert "sleep: 9 of 9 dynamic bodies asleep, in 1 world, of which 1 skipped whole" in sim.explain()


def test_nothing_is_reserved_or_launched_where_none_may_sleep():
    sim = simulation(config=dc.SolverConfig())
    sim.run(3, DT)
    assert sim.sleepers.nbytes() == 0
    assert not sim.asleep.any()
    assert not {stage.kernel for stage in SLEEP} & set(sim.kernels)
    assert "sleep: no body falls asleep" in sim.explain()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_while_all_are_awake_bits_are_those_without_sleep(dtype):
    one, two = (simulation(dtype=dtype, config=dc.SolverConfig(sleep=sleep)) for sleep in (True, False))
    for sim in (one, two):
        sim.state.numpy("velocity")[list(STACK)] = (1.0, 2.0)
        sim.run(40, DT)
    assert not one.asleep.any()
    assert state_bits(one) == state_bits(two)
    assert contacts_of(one) == contacts_of(two)


def test_impulses_follow_the_time_step(at_rest):
    """A world that is awake in part takes steps of another length: impulses of its sleepers are those of that step."""
    sim = at_rest.clone()
    others = [*ON_SHELF, *ON_PLATFORM]
    before = dc.net_contact_forces(sim).force[others]
    sim.state.numpy("velocity")[list(STACK)] = (0.0, 3.0)
    sim.run(4, 0.5 * DT)
    assert {*others} <= asleep_in(sim)
    np.testing.assert_allclose(dc.net_contact_forces(sim).force[others], before, rtol=1e-5, atol=1e-4)


def test_energy_does_not_rise(at_rest):
    sim = at_rest.clone()

    def energy():
        state, model = sim.state, sim.model
        kinetic = 0.5 * (model.numpy("mass") * (state.numpy("velocity") ** 2).sum(axis=1)).sum()
        return kinetic + 9.81 * (model.numpy("mass") * state.numpy("position")[:, 1])[list(ALL)].sum()

    before = energy()
    sim.wake()
    for _ in range(60):
        sim.step(DT)
        assert energy() < before + 1e-3
    assert asleep_in(sim) == EVERY


def test_a_user_lets_a_scene_begin_asleep():
    sim = simulation()
    sim.sleep()
    before = state_bits(sim)
    sim.run(10, DT)
    assert asleep_in(sim) == EVERY
    assert state_bits(sim) == before
    shot(sim, 60)
    assert asleep_in(sim) == {*ON_SHELF, *ON_PLATFORM}
    sim.wake([ON_SHELF[0]])
    sim.sleep(np.isin(np.arange(sim.model.body_count), STACK))
    assert not sim.state.numpy("velocity")[list(STACK)].any()
    sim.step(DT)
    assert not {*ON_SHELF} & asleep_in(sim)


def test_a_world_without_gravity_sleeps_only_if_told():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_discs([(0.0, 0.0), (3.0, 0.0)], 0.5)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(100, DT)
    assert not sim.asleep.any()
    sim.config = dataclasses.replace(sim.config, sleep_time=1e-30)  # whose square is 0 in float32
    sim.run(20, DT)
    assert not sim.asleep.any()
    sim.config = SLEEP_CONFIG
    sim.sleep([0])
    sim.state.numpy("velocity")[1] = (-1.0, 0.0)
    sim.run(100, DT)
    assert asleep_in(sim) == {0}
    sim.run(150, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity").sum(axis=0), (-1.0, 0.0), atol=1e-5)
    assert sim.state.numpy("velocity")[0, 0] < -0.1


def test_what_is_asked_for_in_vain_is_refused(at_rest):
    off = simulation(config=dc.SolverConfig())
    for call in (off.sleep, off.wake):
        with pytest.raises(ValueError, match=r"SolverConfig\.sleep is False"):
            call()
    sim = at_rest.clone()
    with pytest.raises(ValueError, match=r"bodies\[1\] is 12; it must lie in \[0, 11\]"):
        sim.wake([0, 12])
    with pytest.raises(ValueError, match="read-only"):
        sim.asleep[:] = False
    sim.collide(DT)
    with pytest.raises(ValueError, match="in the middle of a step"):
        sim.sleep()
    with pytest.raises(ValueError, match=r"SolverConfig\.sleep_time"):
        dc.SolverConfig(sleep_time=0.0)


def test_scenes_of_discs_pass_over_pairs_of_sleepers():
    """Their pairs are looked at side by side; a sleeping pile is in no row while another one is solved."""
    builder = dc.ModelBuilder()
    builder.add_world()
    pits = [(-9, 6), (-9, 0), (-6, 0), (-6, 6), (6, 6), (6, 0), (9, 0), (9, 6)]
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), pits)
    pile = [(0.52, 0.5), (1.5, 0.5), (2.48, 0.5), (1.0, 1.4), (2.0, 1.4)]
    discs = builder.add_discs([(first + x, y) for first in (-9.0, 6.0) for x, y in pile], 0.5)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(400, DT)
    assert asleep_in(sim) == set(discs)
    left = sorted(b for b in discs if sim.state.numpy("position")[b, 0] < 0)
    right = sorted(set(discs) - set(left))
    before, kept, every = state_bits(sim, left), contacts_of(sim, left), len(contacts_of(sim))
    sim.state.numpy("velocity")[right] = (0.0, 0.5)
    sim.collide(DT)
    assert not set(contacts_of(sim)) & set(kept) and len(contacts_of(sim)) < every
    sim.solve()
    sim.advance()
    sim.run(9, DT)
    assert set(left) == asleep_in(sim)
    assert state_bits(sim, left) == before
    assert contacts_of(sim, left) == kept


def test_what_soft_substeps_brought_to_rest_sleeps_and_wakes():
    """Every bit stays, impulses of rods too, in a world that sleeps in part; what wakes stays where it was."""
    sim = simulation(dtype="float64", config=SOFT)
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    link = sim.joints.numpy("joint_impulse").copy()
    before, contacts = state_bits(sim, [*ON_SHELF, *LINKED]), contacts_of(sim, [*ON_SHELF, *LINKED])
    sim.state.numpy("velocity")[STACK[2]] = (0.0, 1.0)
    sim.run(20, DT)
    assert not sim.asleep[list(STACK)].any() and sim.asleep[[*ON_SHELF, *LINKED]].all()
    assert state_bits(sim, [*ON_SHELF, *LINKED]) == before
    assert contacts_of(sim, [*ON_SHELF, *LINKED]) == contacts
    assert sim.joints.numpy("joint_impulse").tobytes() == link.tobytes()
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    sim.wake()
    at = sim.state.numpy("position").copy()
    sim.run(10, DT)
    assert asleep_in(sim) == set()
    assert np.abs(sim.state.numpy("position") - at).max() < 1e-3  # less than sleep_speed would


@pytest.mark.parametrize(("config", "close"), [(SLEEP_CONFIG, 1e-6), (SOFT, 1e-3)])
@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_joints_of_sleepers_keep_their_impulses(backend, config, close):
    """A chain that wakes beside a disc that never slept hangs on as if it had been awake."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    body = builder.add_body(type=dc.BodyType.STATIC)
    for i in range(3):
        link = builder.add_body((0.0, -0.5 - i))
        builder.add_box(link, 0.1, 0.5, mask=0)
        builder.add_revolute_joint(body, link, (0.0, -0.5 if i else 0.0), (0.0, 0.5))
        body = link
    builder.add_disc(builder.add_body((9.0, 0.0), velocity=(1.0, 0.0), gravity_scale=0.0), 0.5)
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config)
    sim.run(40, DT)
    assert asleep_in(sim) == {1, 2, 3}
    before = sim.joints.numpy("joint_impulse").copy()
    weight = float(sim.model.numpy("mass")[1]) * 9.8 * DT
    np.testing.assert_allclose(np.abs(before.reshape(3, 2)[:, 1]), weight * np.array([3.0, 2.0, 1.0]), rtol=close)
    sim.run(5, DT)
    np.testing.assert_allclose(sim.joints.numpy("joint_impulse"), before)
    sim.wake()
    sim.step(DT)
    assert asleep_in(sim) == set() and np.abs(sim.state.numpy("velocity")[1:4]).max() < close * 9.8 * DT
    if config is SLEEP_CONFIG:  # what substeps give by softness they take back
        assert sim.stats.numpy("change")[0] < 1e-9 * weight
