"""Forces at contacts and on bodies, and pairs that begin and cease to touch."""

import numpy as np
import pytest

import dc_kernels as dc
from tests.driving.scenes import DT, simulation, worlds_of_one_size

G = 9.81


def test_forces_hold_what_rests():
    sim = worlds_of_one_size(aside=0.0)
    sim.run(200, DT)
    force, torque = dc.net_contact_forces(sim)
    mass = sim.model.numpy("mass")
    moving = mass > 0
    ground = sim.model.numpy("body_start")[:-1]
    assert force[moving, 1] == pytest.approx(mass[moving] * G, rel=0.05)
    np.testing.assert_allclose(force[ground, 1], -mass.reshape(3, 3).sum(axis=1) * G, rtol=0.05)
    assert abs(torque[moving]).max() < 0.5


@pytest.mark.parametrize("threads", [1, 2])
def test_forces_change_momentum(threads):
    """What contacts and gravity do to the bodies in a step is what their momentum changes by; spins alike."""
    sim = simulation("float64", threads=threads)
    sim.run(30, DT)
    jointed = [*sim.joints.numpy("joint_body_a"), *sim.joints.numpy("joint_body_b")]
    free = np.setdiff1d(np.flatnonzero(sim.model.numpy("mass")), jointed)
    for _ in range(3):
        before = {name: sim.state.numpy(name).copy() for name in ("velocity", "angular_velocity")}
        sim.collide(DT)
        with pytest.raises(ValueError, match=r"forces after collide\(\)"):
            dc.contact_forces(sim)
        sim.solve()
        force, torque = dc.net_contact_forces(sim)
        sim.advance()
        after = dc.net_contact_forces(sim)
        np.testing.assert_array_equal(after.force, force)
        world = np.repeat([0, 1], np.diff(sim.model.numpy("body_start")))
        pull = sim.model.numpy("mass")[:, None] * sim.model.numpy("gravity")[world]
        gained = sim.model.numpy("mass")[:, None] * (sim.state.numpy("velocity") - before["velocity"])
        np.testing.assert_allclose(gained[free], ((force + pull) * DT)[free], atol=1e-9)
        spun = sim.model.numpy("inertia") * (sim.state.numpy("angular_velocity") - before["angular_velocity"])
        np.testing.assert_allclose(spun[free], (torque * DT)[free], atol=1e-9)
        assert abs(dc.contact_forces(sim)).max() > 0


def test_a_rope_pulls_with_the_weight_that_hangs_on_it():
    builder = dc.ModelBuilder()
    builder.add_world()
    hook = builder.add_body(type=dc.BodyType.STATIC)
    ball = builder.add_body((0.0, -1.0), mass=3.0)
    builder.add_disc(ball, 0.1)
    builder.add_distance_joint(hook, ball)
    sim = dc.Simulation(*builder.finalize())
    assert dc.joint_forces(sim).tolist() == [0]
    sim.run(200, DT)
    assert dc.joint_forces(sim) == pytest.approx([-3.0 * G], rel=1e-2)


def test_a_world_that_has_stopped_has_no_forces():
    sim = simulation()
    sim.run(30, DT)
    sim.collide(DT)
    sim.contacts.numpy("impulse")[:] = np.inf
    sim.solve()
    sim.advance()
    assert sim.state.numpy("flags").all()
    force, torque = dc.net_contact_forces(sim)
    assert not force.any() and not torque.any()


def by_hand(sim, touching):
    """Pairs of shapes that touch after a step, from those before it, one contact after the other."""
    slots, world = dc.contact_slots(sim.contacts)
    found, presses = {}, set()
    for slot, w in zip(slots, world):
        key, first = int(sim.contacts.numpy("key")[slot]), int(sim.model.numpy("shape_start")[w])
        pair = tuple(sorted((((key >> 39) & (2**23 - 1)) + first, ((key >> 16) & (2**23 - 1)) + first)))
        impulse = float(sim.contacts.numpy("impulse")[slot, 0])
        found[pair] = found.get(pair, 0.0) + impulse
        if impulse or sim.contacts.numpy("gap")[slot] < 0:
            presses.add(pair)
    return {pair: impulse for pair, impulse in found.items() if pair in presses or pair in touching}


def as_dict(touches):
    return {(int(a), int(b)): impulse for a, b, impulse in zip(touches.shape_a, touches.shape_b, touches.impulse)}


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_events_are_those_found_one_by_one(backend):
    sim = simulation(backend=backend)
    events = dc.ContactEvents(sim)
    assert not len(events.touching.impulse)
    touching, begun, ended = {}, 0, 0
    for _ in range(80 if backend == "warp" else 15):
        sim.step(1.5 * DT)
        events.update()
        now = by_hand(sim, touching)
        assert as_dict(events.touching) == pytest.approx(now)
        assert as_dict(events.begun) == pytest.approx({p: v for p, v in now.items() if p not in touching})
        assert as_dict(events.ended) == pytest.approx({p: v for p, v in touching.items() if p not in now})
        assert np.array_equal(events.begun.body_a, sim.model.numpy("shape_body")[events.begun.shape_a])
        begun, ended, touching = begun + len(events.begun.impulse), ended + len(events.ended.impulse), now
    assert begun > (3 if backend == "warp" else 1) and (ended or backend == "numpy")
    assert repr(events) == (
        f"<ContactEvents: {len(events.begun.impulse)} pairs begun, {len(events.ended.impulse)} ended, "
        f"{len(touching)} touching>"
    )
    assert not len(dc.ContactEvents(sim).begun.impulse)  # what touches already has not begun


def test_events_of_worlds_that_are_reset_or_stop():
    sim = worlds_of_one_size(2)
    sim.run(100, DT)
    events = dc.ContactEvents(sim)
    count = len(events.touching.impulse)
    assert count == 4
    sim.reset([1])
    events.update()
    assert len(events.ended.impulse) == 2 and (events.ended.shape_a >= 3).all()
    sim.state.numpy("flags")[0] = dc.Flag.NONFINITE
    sim.step(DT)
    events.update()
    assert not len(events.ended.impulse) and (events.touching.shape_a[:2] < 3).all()
    sim.collide(DT)
    with pytest.raises(ValueError, match=r"update\(\) in the middle of a step"):
        events.update()
