"""Impulses of rolling resistance are kept from step to step, as those of contacts are."""

import io

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.fields import PER_CONTACT, ROLLING

DT = 0.01
G = 9.8
SLOPE = np.arctan(0.15)


def slope(backend="warp", rolls=(0.2, 0.3), config=None, **floor):
    """Discs of mass 2 on a slope that they do not roll down where they resist it."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(G * np.sin(SLOPE), -G * np.cos(SLOPE)))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 50.0, 0.5, center=(0.0, -0.5), friction=1.0, **floor)
    for i, roll in enumerate(rolls):
        builder.add_disc(builder.add_body((3.0 * i, 0.5), mass=2.0), 0.5, friction=1.0, rolling_resistance=roll)
    return dc.Simulation(*builder.finalize("float64", backend=backend), config=config)


def pile(backend="warp", roll=0.3, **config):
    """Discs in a funnel, which hold each other by their resistance too, and two that lie aside."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(-2.0, 1.5), (0.0, 0.0), (2.0, 1.5)])
    builder.add_chain(ground, [(4.0, 0.0), (9.0, 0.0)])
    for i in range(6):
        builder.add_disc(
            builder.add_body((0.45 * (i % 3 - 1) + 0.03 * i, 0.8 + 0.45 * (i // 3))), 0.2, rolling_resistance=roll
        )
    for x in (5.0, 7.0):
        builder.add_disc(builder.add_body((x, 0.2)), 0.2, rolling_resistance=roll)
    return dc.Simulation(*builder.finalize("float64", backend=backend), config=dc.SolverConfig(**config))


def contacts_of(sim):
    """All fields of the contacts in use, by name."""
    slots, _ = dc.contact_slots(sim.contacts)
    names = [name for name, field in sim.contacts.table.items() if field.per in PER_CONTACT]
    return {name: sim.contacts.numpy(name)[slots] for name in names if len(sim.contacts.numpy(name))}


def arrays_of_rolling(sim):
    """Names of the arrays that are there for rolling resistance alone."""
    groups = sim.storage.groups().items()
    fields = [(key, group, field) for key, group in groups for field in group.table.values() if field.per == ROLLING]
    return [f"{key}.{field.name}" for key, group, field in fields if len(group.numpy(field.name))]


def bits(sim):
    state = {name: sim.state.numpy(name).tobytes() for name in sim.state.table}
    return state | {name: values.tobytes() for name, values in contacts_of(sim).items()}


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_step_starts_from_the_impulses_of_the_last(backend):
    sim = slope(backend)
    sim.run(100, DT)
    held = contacts_of(sim)["rolling_impulse"]
    np.testing.assert_allclose(held, 2.0 * G * np.sin(SLOPE) * DT, rtol=2e-3)  # of B, which else turns clockwise
    sim.collide(2.0 * DT)
    np.testing.assert_array_equal(contacts_of(sim)["rolling_impulse"], 2.0 * held)
    sim.solve(pause=0)
    slot = sim.rows.numpy("roll_slot")[:2]
    np.testing.assert_array_equal(sim.rows.numpy("impulse")[slot], 2.0 * held)
    sim.resume()
    np.testing.assert_allclose(contacts_of(sim)["rolling_impulse"], 2.0 * held, rtol=2e-3)
    sim.config = dc.SolverConfig(start="zero")
    sim.collide(DT)
    assert not contacts_of(sim)["rolling_impulse"].any()


def test_a_pile_is_held_by_a_sweep_a_step():
    """What starts from zero lets roll what one sweep does not hold: discs of a pile turn on and on."""
    sim = pile(max_sweeps=60, tolerance=1e-9, stop="change")
    sim.run(400, DT)
    assert (np.abs(contacts_of(sim)["rolling_impulse"]) > 1e-5).sum() > 4
    sim.config = dc.SolverConfig(max_sweeps=1, min_sweeps=1, acceleration="none")
    before = sim.state.numpy("angle").copy()
    sim.run(100, DT)
    assert np.abs(sim.state.numpy("angle") - before).max() < 1e-4


def test_impulses_go_with_snapshots_and_copies():
    sim = pile()
    sim.run(40, DT)
    file = io.BytesIO()
    sim.save(file)
    others = [dc.Simulation.load(io.BytesIO(file.getvalue())), sim.clone()]
    other = pile()
    for name in ("position", "angle", "velocity", "angular_velocity", "time"):
        other.state.numpy(name)[:] = sim.state.numpy(name)
    table = contacts_of(sim)
    other.restore_contacts(
        sim.contacts.numpy("contact_count"),
        {name: table[name] for name in ("key", "impulse", "color", "age", "rolling_impulse")},
        sim.contacts.numpy("contact_dt"),
    )
    for one in (sim, *others, other):
        one.run(20, DT)
        assert bits(one) == bits(sim)


def test_a_file_of_before_they_were_kept_starts_from_zero():
    sim = pile()
    sim.run(40, DT)
    file = io.BytesIO()
    sim.save(file)
    with h5py.File(file, "r+") as old:
        assert len(old["contacts/rolling_impulse"]) == old["sizes"].attrs[ROLLING] > 4
        del old["contacts/rolling_impulse"]
    with pytest.raises(ValueError, match=r"dataset contacts/rolling_impulse is missing"):
        dc.Simulation.load(io.BytesIO(file.getvalue()))
    with h5py.File(file, "r+") as old:
        del old["sizes"].attrs[ROLLING]
    loaded = dc.Simulation.load(io.BytesIO(file.getvalue()))
    assert contacts_of(loaded)["impulse"].tobytes() == contacts_of(sim)["impulse"].tobytes()
    assert not contacts_of(loaded)["rolling_impulse"].any()
    loaded.run(1, DT)
    assert contacts_of(loaded)["rolling_impulse"].any()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_sleepers_keep_them(backend):
    """In a world that sleeps as a whole, in one that is awake in part, and through a file; what wakes has them."""
    sim = pile(backend, sleep=True, sleep_time=0.1)
    sim.run(112, DT)
    assert sim.asleep[1:].all()
    before = contacts_of(sim)
    still = before["body_b"] != 8
    assert (np.abs(before["rolling_impulse"][still]) > 1e-5).sum() > 4

    def rolling_of(one):
        now = contacts_of(one)
        assert now["key"][now["body_b"] != 8].tolist() == before["key"][still].tolist()
        return now["rolling_impulse"][now["body_b"] != 8]

    sim.state.numpy("velocity")[-1] = (1.0, 0.0)
    sim.run(4, 0.5 * DT)
    assert sim.asleep.tolist() == [False, *[True] * 7, False]
    file = io.BytesIO()
    sim.save(file)
    other = dc.Simulation.load(io.BytesIO(file.getvalue()))
    for one in (sim, other):
        np.testing.assert_array_equal(rolling_of(one), 0.5 * before["rolling_impulse"][still])
        one.wake()
        one.collide(DT)
        assert not one.asleep.any()
        np.testing.assert_array_equal(rolling_of(one), before["rolling_impulse"][still])
        one.solve()
        one.advance()
    assert bits(other) == bits(sim)


def test_they_turn_over_with_the_bodies_of_their_contact():
    """A static body comes first in a contact; the impulse acts on the second one, so that its sign changes."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(G * np.sin(SLOPE), -G * np.cos(SLOPE)))
    builder.add_box(builder.add_body((0.0, -0.5), mass=2.0), 5.0, 0.5, friction=1.0)
    builder.add_disc(builder.add_body((0.0, 0.5), mass=2.0), 0.5, friction=1.0, rolling_resistance=0.3)
    sim = dc.Simulation(*builder.finalize("float64", backend="numpy"))
    sim.change_model(body_type=[dc.BodyType.DYNAMIC, dc.BodyType.STATIC], mass=[2.0, 0.0], inertia=[10.0, 0.0])
    sim.state.numpy("velocity")[0] = (0.0, 20.0)
    sim.step(DT)
    before = contacts_of(sim)
    assert before["body_a"].tolist() == [1]
    assert before["rolling_impulse"][0] != 0
    sim.change_model(body_type=[dc.BodyType.STATIC, dc.BodyType.DYNAMIC], mass=[0.0, 2.0], inertia=[0.0, 0.25])
    sim.collide(DT)
    after = contacts_of(sim)
    assert after["body_a"].tolist() == [0] and after["age"].tolist() == [1]
    np.testing.assert_array_equal(after["impulse"], before["impulse"])
    np.testing.assert_array_equal(after["rolling_impulse"], -before["rolling_impulse"])


def test_they_come_and_go_with_the_resistance():
    sim = slope(surface_speed=0.01)
    assert arrays_of_rolling(sim) == ["contacts.rolling_impulse", "cache.rolling_impulse", "rows.roll_slot"]
    sim.run(20, DT)
    normal = contacts_of(sim)["impulse"]
    sim.change_model(shape_rolling_resistance=0.0)
    assert "match_rolling" not in sim.kernels
    assert not arrays_of_rolling(sim)
    assert contacts_of(sim)["impulse"].tobytes() == normal.tobytes()
    sim.run(5, DT)
    sim.change_model(shape_rolling_resistance=0.4)
    assert not contacts_of(sim)["rolling_impulse"].any()
    sim.run(30, DT)
    np.testing.assert_allclose(contacts_of(sim)["rolling_impulse"] > 0, True)


def test_bodies_that_come_and_go_leave_those_of_others():
    sim = pile()
    sim.run(60, DT)
    before = contacts_of(sim)
    more = sim.additions()
    more.add_disc(more.add_body((8.0, 0.2)), 0.2, rolling_resistance=0.3)
    sim.add(more)
    sim.remove(bodies=7)
    gone = (before["body_a"] == 7) | (before["body_b"] == 7)
    assert gone.sum() == 1
    for name in ("key", "impulse", "rolling_impulse"):
        np.testing.assert_array_equal(contacts_of(sim)[name], before[name][~gone], err_msg=name)
    sim.collide(DT)
    known = np.isin(contacts_of(sim)["key"], before["key"])
    start = dict(zip(before["key"].tolist(), before["rolling_impulse"].tolist()))
    now = contacts_of(sim)
    assert now["rolling_impulse"][known].tolist() == [start[key] for key in now["key"][known].tolist()]
    assert not now["rolling_impulse"][~known].any()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_contact_that_is_off_has_none(backend):
    sim = slope(backend, (0.2, 0.3, 0.4), dc.SolverConfig(contact_switches=True))
    sim.run(30, DT)
    sim.collide(DT)
    start = contacts_of(sim)["rolling_impulse"]
    sim.change_contacts(enabled=[False, True, True])
    np.testing.assert_array_equal(contacts_of(sim)["rolling_impulse"], start[1:])
    sim.solve()
    sim.advance()
    now = contacts_of(sim)["rolling_impulse"]
    assert now[0] == 0
    np.testing.assert_allclose(now[1:], start[1:], rtol=1e-3)


def test_scenes_without_it_have_nothing_of_it():
    sim = slope(rolls=(0.0, 0.0), surface_speed=0.1)
    assert sim.variant == "surfaces"
    assert not {"match_rolling", "keep_rolling"} & {*sim.kernels, *sim.added_kernels}
    assert not arrays_of_rolling(sim)
    sim.run(2, DT)
    arrays = {**contacts_of(sim), "rolling_impulse": np.zeros(2)}
    with pytest.raises(ValueError, match=r"rolling_impulse is given, but no shape has a rolling_resistance"):
        sim.restore_contacts([2], arrays, [DT])


def test_starts_are_checked():
    sim = slope()
    sim.run(2, DT)

    def start(sim):
        sim.contacts.numpy("rolling_impulse")[1] = np.nan

    with pytest.raises(ValueError, match=r"contacts.rolling_impulse\[1\] \(contact 1 of world 0\) is nan"):
        sim.step(DT, start)
    sim = slope()
    sim.run(2, DT)
    arrays = {**contacts_of(sim), "rolling_impulse": np.array([0.0, np.inf])}
    with pytest.raises(ValueError, match=r"rolling_impulse\[1\] is inf"):
        sim.restore_contacts([2], arrays, [DT])
    assert [len(part) for part in sim.contacts.worlds("rolling_impulse")] == [2]
