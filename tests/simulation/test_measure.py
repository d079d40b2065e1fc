"""Energy, momentum and overlap of worlds made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels import measure

small = st.floats(-3, 3)


def worlds():
    """World 0: a disc and a box that move, and a kinematic body; world 1: empty; world 2: a disc at rest."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(1.0, -10.0), origin=(50.0, 0.0))
    disc = builder.add_body((51, 2), velocity=(3, 4), angular_velocity=5, mass=2.0, inertia=0.5)
    builder.add_disc(disc, 1.0)
    box = builder.add_body((50, -1), velocity=(0, 1), mass=4.0, inertia=1.0)
    builder.add_box(box, 1.0, 1.0)
    builder.add_disc(builder.add_body(type=dc.BodyType.KINEMATIC, velocity=(9, 9)), 1.0)
    builder.add_world()
    builder.add_world()
    builder.add_disc(builder.add_body((0, 3), mass=1.0), 1.0)
    model, state, _ = builder.finalize("float32", backend="numpy")
    return SimpleNamespace(model=model, state=state)


def test_kinetic_energy():
    energy = measure.kinetic_energy(worlds())
    assert energy == pytest.approx((2 * 25 / 2 + 0.5 * 25 / 2 + 4 / 2, 0, 0))
    assert energy.dtype == np.float64


def test_potential_energy_is_zero_at_the_worlds_origin():
    energy = measure.potential_energy(worlds())
    assert energy == pytest.approx((2 * (20 - 1) + 4 * -10, 0, 9.8 * 3), rel=1e-6)  # -m g.x


def test_momentum():
    linear, angular = measure.momentum(worlds())
    assert linear == pytest.approx(np.array(((6, 12), (0, 0), (0, 0))))
    assert angular == pytest.approx((1 * 8 - 2 * 6 + 0.5 * 5, 0, 0))


@given(small, small, small)
def test_a_body_in_parts_has_the_energy_of_its_points(vx, vy, spin):
    # two discs on a bar, against their points one by one: energy = sum of m v^2 / 2 and each disc's own rotation
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body(velocity=(vx, vy), angular_velocity=spin)
    builder.add_disc(body, 0.5, (0, 0), density=1.0)
    builder.add_disc(body, 0.5, (2, 0), density=3.0)
    model, state, _ = builder.finalize("float64", backend="numpy")
    mass = np.pi * 0.25 * np.array((1, 3))
    velocity = np.array(((vx, vy), (vx, vy + 2 * spin)))
    energy = (mass * ((velocity**2).sum(1) + 0.125 * spin**2)).sum() / 2
    assert measure.kinetic_energy(SimpleNamespace(model=model, state=state)) == pytest.approx([energy], abs=1e-12)


def with_contacts(recollided):
    sim = worlds()
    sizes = {"world": 3, "world+1": 4, "contact": 12}
    vars(sim)["contacts"] = dc.Contacts(sizes, "float32", backend="numpy")
    sim.contacts.contact_start[:] = (0, 4, 8, 12)
    sim.contacts.contact_count[:] = (4, 0, 2)
    sim.contacts.gap[:] = -9.0  # of unused slots
    sim.contacts.gap[:4] = (-0.1, 0.2, -0.3, 0.5)
    sim.contacts.gap[8:10] = (0.1, -0.5)
    sim.contacts.impulse[1, 0] = 2.0  # presses, though apart: counts as no overlap; slot 3 does not count
    sim.contacts.impulse[3, 1] = 0.0
    sim.collide = recollided.append
    return sim


def test_overlap_is_over_contacts_that_press_or_overlap():
    calls = []
    mean, largest = measure.overlap(with_contacts(calls))
    assert mean == pytest.approx((0.4 / 3, 0, 0.5))
    assert largest == pytest.approx((0.3, 0, 0.5))
    assert not calls


def test_overlap_of_the_present_positions():
    calls = []
    measure.overlap(with_contacts(calls), recollide=0.01)
    assert calls == [0.01]


def test_contact_slots():
    slots, world = measure.contact_slots(with_contacts([]).contacts)
    assert slots.tolist() == [0, 1, 2, 3, 8, 9]
    assert world.tolist() == [0, 0, 0, 0, 2, 2]
