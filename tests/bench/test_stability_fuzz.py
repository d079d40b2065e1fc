"""Whole scenes drawn at random keep the laws in every step; what checks them finds what is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import dc_kernels as dc
from bench.stability import fuzz as stability_fuzz
from bench.stability import invariants
from dc_kernels.model.enums import BodyType

BODY = stability_fuzz.Body("box", BodyType.DYNAMIC, 0.5, 4, 1.0, (0.0, 0.31), 0.0, (1.0, -1.0), 0.5, 0.5, 0.0)
BODIES = tuple(
    replace(BODY, kind=kind, position=(0.1 * i, 0.4 + 0.9 * i)) for i, kind in enumerate(stability_fuzz.KINDS)
)
PILE = stability_fuzz.World(
    bodies=BODIES,
    gravity=(0.0, -9.8),
    ground=(0.0,) * 6,
    ground_friction=0.5,
    joints=((0, 1),),
    config=dc.SolverConfig(tolerance=1e-9),
    dtype="float64",
    dt=0.01,
    schedule="world",
    specialize=True,
)  # fmt: skip


@settings(max_examples=40, suppress_health_check=list(HealthCheck))
@given(stability_fuzz.worlds())
def test_laws_hold_in_any_scene(world):
    assert stability_fuzz.faults(world) == []


def in_flight(steps=60):
    """The pile in the middle of a step: its start impulses are there too."""
    sim = PILE.simulation()
    sim.run(steps, PILE.dt)
    sim.collide(PILE.dt)
    start = invariants.contact_table(sim)["impulse"]
    sim.solve()
    assert invariants.step_faults(sim, start) == []
    assert (invariants.contact_table(sim)["impulse"][:, 0] > 0).sum() > 3
    return sim, start


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda sim, c: sim.contacts.numpy("impulse").__setitem__((c, 0), -1.0), "normal impulse is -1"),
        (lambda sim, c: sim.contacts.numpy("impulse").__setitem__((c, 1), 1e3), "friction exceeds"),
        (lambda sim, c: sim.motion.numpy("solved").__setitem__((1, 2), 7.0), "velocity 2 of body 1 is 7"),
        (lambda sim, c: sim.motion.numpy("solved").__setitem__((1, 0), np.nan), "not finite"),
        (lambda sim, c: sim.motion.numpy("solved").__setitem__((0, 1), 1e-3), "not dynamic changed its velocity"),
        (lambda sim, c: sim.joints.numpy("joint_impulse").__setitem__(0, 9.0), "its impulses say"),
    ],
)
def test_a_broken_step_is_found(spoil, message):
    sim, start = in_flight()
    pressing = int(np.flatnonzero(sim.contacts.numpy("impulse")[:, 0] > 0)[0])
    spoil(sim, pressing)
    assert message in " ".join(invariants.step_faults(sim, start))


def test_a_lost_contact_and_a_wrong_gap_are_found():
    sim, _ = in_flight()
    assert invariants.lost_contacts(sim, 1e-9) == []
    count = int(sim.contacts.numpy("contact_count")[0])
    sim.contacts.numpy("gap")[0] -= 1.0
    sim.contacts.numpy("key")[count - 1] = sim.contacts.numpy("key")[count - 2]
    found = " ".join(invariants.lost_contacts(sim, 1e-9))
    assert "a key occurs twice" in found
    dc.to_numpy(sim.contacts.contact_count)[0] = 0
    assert "no contact" in " ".join(invariants.lost_contacts(sim, 1e-9))


@pytest.mark.parametrize("half", [0.0, 0.1])
@pytest.mark.parametrize(("aside", "lost"), [(1.001, False), (0.999, True)])
def test_only_shapes_that_pass_by_need_no_contact(aside, lost, half):
    """One flies at a disc; with its centre more than two radii aside it passes, 13 mm away at the beginning."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_disc(builder.add_body((0.0, 0.0)), 0.5)
    other = builder.add_body((-0.16 - half, aside), velocity=(100.0, 0.0))
    if half:
        builder.add_capsule(other, (-half, 0.0), (half, 0.0), 0.5)
    else:
        builder.add_disc(other, 0.5)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.collide(0.01)
    dc.to_numpy(sim.contacts.contact_count)[0] = 0
    assert bool(invariants.lost_contacts(sim, 1e-9)) == lost


def test_energy_that_a_solve_adds_is_found():
    sim, _ = in_flight()
    gain, scale = invariants.energy_gain(sim)
    assert gain < 1e-9 * scale
    sim.motion.numpy("solved")[1, :2] *= 5.0
    gain, scale = invariants.energy_gain(sim)
    assert gain > 1e-3 * scale


@pytest.mark.parametrize("length", [0.4, 1.0, 3.0])
@pytest.mark.parametrize("depth", [0.02, 0.1, 0.2, 0.3])
def test_a_hull_sunk_into_a_flat_chain_keeps_its_contact(depth, length):
    """Segments agree on the side: that with less of the hull beyond. Else each left it to its neighbour."""
    draw = np.random.default_rng(0)
    builder = dc.ModelBuilder()
    for _ in range(400):
        builder.add_world(length_scale=1.0)
        x = np.arange(-6, 7) * length
        builder.add_chain(builder.add_body(type=BodyType.STATIC), np.stack([x, np.zeros(13)], axis=1))
        count = int(draw.integers(3, 9))
        turn = (np.arange(count) + draw.uniform(-0.3, 0.3, count)) * (2.0 * math.pi / count)
        corners = 0.7 * np.stack([np.cos(turn), draw.uniform(0.3, 1.0) * np.sin(turn)], axis=1)
        angle = draw.uniform(-3.0, 3.0)
        height = (corners @ invariants.rotation(angle).T)[:, 1]
        place = (draw.uniform(-length, length), -height.min() - depth * np.ptp(height))
        builder.add_polygon(builder.add_body(place, angle), corners)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.collide(0.01)
    assert (sim.contacts.numpy("contact_count") > 0).all()
