"""What disturbs bodies that sleep wakes them, with all that they touch, and nobody else."""

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from tests.sleep.yard import (
    DT,
    EVERY,
    LINK,
    LINKED,
    ON_PLATFORM,
    ON_SHELF,
    PLATFORM,
    SHELF,
    SLEEP_CONFIG,
    STACK,
    asleep_in,
    contacts_of,
    shot,
    simulation,
    state_bits,
    through_file,
)


def write(name, body, value):
    def act(sim):
        sim.state.numpy(name)[body] = value

    return act


def write_gravity(sim):
    sim.model.numpy("gravity")[0] = (0.0, -5.0)


def write_joint(sim):
    sim.joints.assign("joint_length", [1.29])


CAUSES = {
    "velocity": (write("velocity", STACK[0], (0.0, 0.5)), set(STACK)),
    "spin": (write("angular_velocity", STACK[2], 0.5), set(STACK)),
    "position": (write("position", STACK[2], (2.5, 1.6)), set(STACK)),
    "angle": (write("angle", ON_SHELF[1], 0.01), set(ON_SHELF)),
    "force": (write("force", LINKED[1], (0.1, 0.0)), LINK),
    "torque": (write("torque", LINKED[0], 0.1), LINK),
    "gravity": (write_gravity, EVERY),
    "joint": (write_joint, LINK),
    "static support": (write("position", SHELF, (-6.0, 1.0)), set(ON_SHELF)),
    "kinematic support": (write("velocity", PLATFORM, (0.0, -1.0)), set(ON_PLATFORM)),
    "moved kinematic support": (write("position", PLATFORM, (9.0, 4.0)), set(ON_PLATFORM)),
    "what comes to touch": (write("position", SHELF, (-2.0, 1.24)), {*ON_SHELF, *LINK}),
    "call": (lambda sim: sim.wake([STACK[1]]), set(STACK)),
    "call for all": (lambda sim: sim.wake(), EVERY),
    "model": (lambda sim: sim.change_model(shape_friction=0.3), EVERY),
    "settings": (lambda sim: setattr(sim, "config", dataclasses.replace(sim.config, sleep=False)), EVERY),
    "reset": (lambda sim: sim.reset(), EVERY),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_who_wakes(at_rest, cause):
    sim = at_rest.clone()
    disturb, wakes = CAUSES[cause]
    before = state_bits(sim, sorted(EVERY - wakes))
    disturb(sim)
    sim.step(DT)
    assert asleep_in(sim) == EVERY - wakes
    sim.run(5, DT)
    assert asleep_in(sim) == EVERY - wakes
    assert state_bits(sim, sorted(EVERY - wakes)) == before
    keys = sim.contacts.numpy("key")[: sim.contacts.numpy("contact_count")[0]]
    assert (np.diff(keys) > 0).all()


def test_an_equal_force_written_again_wakes_nobody():
    sim = simulation()
    sim.state.numpy("force")[STACK[2]] = (0.0, -1.0)
    sim.run(100, DT)
    assert asleep_in(sim) == EVERY
    sim.state.assign("force", sim.state.numpy("force").copy())
    sim.step(DT)
    assert asleep_in(sim) == EVERY


def test_a_tower_whose_support_is_removed_falls(at_rest):
    sim = at_rest.clone()
    sim.state.numpy("position")[SHELF] = (-6.0, -5.0)
    sim.run(40, DT)
    assert (sim.state.numpy("position")[list(ON_SHELF), 1] < (2.4, 3.4)).all()
    sim.run(200, DT)
    assert asleep_in(sim) == EVERY
    np.testing.assert_allclose(sim.state.numpy("position")[list(ON_SHELF), 1], (0.5, 1.5), atol=0.01)


def test_what_lay_on_a_body_that_is_put_elsewhere_falls(at_rest):
    sim = at_rest.clone()
    sim.state.numpy("position")[ON_SHELF[0]] = (0.0, 9.0)
    sim.run(30, DT)
    assert sim.state.numpy("position")[ON_SHELF[1], 1] < 3.4


def test_what_hangs_from_a_body_that_is_put_elsewhere_wakes():
    builder = dc.ModelBuilder()
    builder.add_world()
    hook = builder.add_body((0.0, 5.0), type=dc.BodyType.STATIC)
    bob = builder.add_body((0.0, 3.0))
    builder.add_disc(bob, 0.5)
    builder.add_distance_joint(hook, bob)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(100, DT)
    assert asleep_in(sim) == {bob}
    sim.state.numpy("position")[hook] = (1.0, 5.0)
    sim.run(30, DT)
    assert sim.state.numpy("position")[bob, 0] > 0.01


def test_a_moving_platform_keeps_what_it_carries_awake():
    sim = simulation()
    sim.state.numpy("velocity")[PLATFORM] = (0.0, 0.005)
    sim.run(120, DT)
    assert asleep_in(sim) == EVERY - set(ON_PLATFORM)
    sim.state.numpy("velocity")[PLATFORM] = 0.0
    sim.run(60, DT)
    assert asleep_in(sim) == EVERY
    assert sim.sleepers.numpy("dormant")[0] == 1


def test_what_is_hit_wakes_and_the_rest_sleeps_on(at_rest):
    sim = at_rest.clone()
    others = sorted({*ON_SHELF, *ON_PLATFORM})
    before, kept = state_bits(sim, others), contacts_of(sim, others)
    shot(sim, 15)
    assert asleep_in(sim) == EVERY - LINK
    sim.run(60, DT)
    assert asleep_in(sim) == set(others)
    assert np.abs(sim.state.numpy("velocity")[list(STACK)]).max() > 0.1
    assert state_bits(sim, others) == before
    assert contacts_of(sim, others) == kept


def columns(backend, heights):
    """Discs that sleep on the ground, and one above each, at these heights over it."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 2.0 * len(heights), 0.5, center=(0.0, -0.5))
    x = 2.0 * np.arange(len(heights))
    lower = builder.add_discs(np.stack([x, np.full_like(x, 0.5)], axis=1), 0.5)
    builder.add_discs(np.stack([x, 1.5 + np.asarray(heights)], axis=1), 0.5)
    sim = dc.Simulation(*builder.finalize(backend=backend), config=SLEEP_CONFIG)
    sim.step(0.1 * DT)  # finds the contacts of the lower discs
    sim.sleep(lower)
    return sim


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_meets_a_sleeper_wakes_it_in_that_step(backend):
    """A sleeper never has a new contact beside those that it fell asleep with: the colour of one may be the other's."""
    sim = columns(backend, np.linspace(0.001, 0.2, 30))
    woken = set()
    for _ in range(22):
        sim.step(DT)
        slots, _ = dc.contact_slots(sim.contacts)
        bodies = np.stack([sim.contacts.numpy(name)[slots] for name in ("body_a", "body_b")])
        dynamic = sim.model.numpy("body_type")[bodies] == dc.BodyType.DYNAMIC
        both = bodies[:, dynamic.all(axis=0)]
        assert np.array_equal(*sim.asleep[both])
        assert asleep_in(through_file(sim)) == asleep_in(sim)  # which looks at the colours
        woken |= {*both.flat} - asleep_in(sim)
    assert len(woken) == 60


def test_a_woken_pile_goes_on_as_if_it_had_not_slept():
    """The difference is what it crept by meanwhile."""
    sims = simulation(), simulation(config=dataclasses.replace(SLEEP_CONFIG, sleep=False))
    for sim in sims:
        sim.run(150, DT)
        shot(sim, 60)
    one, two = (sim.state.numpy("position") for sim in sims)
    assert sims[0].asleep.sum() == 4
    assert np.abs(one - two).max() < 2e-3


def test_contacts_of_the_woken_keep_impulse_colour_and_age(at_rest):
    sim = at_rest.clone()
    before = {name: sim.contacts.numpy(name).copy() for name in ("key", "impulse", "color", "age")}
    count = sim.contacts.numpy("contact_count")[0]
    sim.wake()
    sim.collide(DT)
    assert sim.contacts.numpy("contact_count")[0] == count
    for name, values in before.items():
        now = sim.contacts.numpy(name)[:count]
        assert np.array_equal(now, values[:count] + (name == "age")), name
    sim.solve()
    assert sim.stats.numpy("sweeps")[0] == sim.config.min_sweeps  # the start is the solution
    sim.advance()
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-3


def rain(worlds, **options):
    """Boxes and discs that fall on each other in each world, one row of worlds as the other."""
    builder = dc.ModelBuilder()
    rng = np.random.default_rng(0)
    for _ in range(worlds):
        builder.add_world()
        builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
        for k in range(7):
            body = builder.add_body((float(rng.uniform(-1.0, 1.0)), 1.0 + 1.05 * k))
            if k % 2:
                builder.add_box(body, 0.4, 0.4)
            else:
                builder.add_disc(body, 0.5)
    return dc.Simulation(*builder.finalize(), config=dc.SolverConfig(sleep=True), **options)


def test_who_wakes_is_a_function_of_the_state_of_the_world_alone():
    """Pairs are found anew whenever the room of any world grows, and who wakes must not depend on that."""
    alone, among = (rain(worlds, contacts_per_body=0.2) for worlds in (1, 6))
    bodies = np.arange(alone.model.body_count)
    for _ in range(8):
        for sim in (alone, among):
            sim.run(40, DT)
        assert state_bits(alone) == state_bits(among, bodies)
        assert asleep_in(alone) == asleep_in(among) & {*bodies.tolist()}
        assert np.array_equal(alone.sleepers.numpy("rest_time"), among.sleepers.numpy("rest_time")[bodies])


@pytest.mark.parametrize("step", [0, 3])
def test_what_was_let_sleep_on_a_body_falls_when_that_is_put_elsewhere(step):
    """Whether a step has found their contacts yet or not."""
    sim = simulation()
    sim.run(step, DT)
    sim.sleep()
    sim.state.numpy("position")[SHELF] = (-6.0, -5.0)
    sim.run(40, DT)
    assert (sim.state.numpy("position")[list(ON_SHELF), 1] < (2.4, 3.4)).all()


def test_what_was_let_sleep_on_an_awake_body_falls_when_that_is_put_elsewhere(at_rest):
    sim = at_rest.clone()
    sim.wake()
    sim.step(DT)
    sim.sleep([ON_SHELF[1], STACK[2]])
    assert asleep_in(sim) == {ON_SHELF[1], STACK[2]}
    sim.state.numpy("position")[ON_SHELF[0]] = (0.0, 9.0)
    sim.step(DT)
    assert not asleep_in(sim)
    sim.run(29, DT)
    assert sim.state.numpy("position")[ON_SHELF[1], 1] < 3.4


def test_half_of_what_is_linked_does_not_sleep(at_rest):
    sim = at_rest.clone()
    sim.wake()
    sim.step(DT)
    sim.sleep([LINKED[0], STACK[2]])
    assert asleep_in(sim) == {LINKED[0], STACK[2]}
    sim.step(DT)
    assert not asleep_in(sim)
