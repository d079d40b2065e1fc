"""Worlds whose bodies come and go: room, events, copies, sensors, resets, and changes that are refused."""

import io

import numpy as np
import pytest

import dc_kernels as dc
from tests.backends import NEEDS_TAICHI
from tests.driving.populated import DT, FIELDS, add, bits, build, check, first, second
from tests.driving.scenes import simulation


def test_more_slots_change_no_bit():
    """With sleepers, events and joints, in worlds of several sizes, in mid-run."""
    sim = simulation(traits=True, config=dc.SolverConfig(sleep=True, sleep_time=0.05, contact_events=True))
    sim.run(60, DT)
    other = sim.clone()
    other.reserve(bodies=7, shapes=30)
    for one in (sim, other):
        one.run(20, DT)
    bodies = np.arange(sim.model.body_count)
    assert bits(other, other.index(bodies=bodies)) == bits(sim, bodies)
    assert other.joints.numpy("joint_impulse").tobytes() == sim.joints.numpy("joint_impulse").tobytes()
    assert other.asleep[other.index(bodies=bodies)].tolist() == sim.asleep.tolist()
    for which in ("all", "begun", "ended"):
        one, two = (dc.contact_events(s, which) for s in (sim, other))
        assert other.index(shapes=one.shape_a).tolist() == two.shape_a.tolist()
        assert other.index(shapes=one.shape_b).tolist() == two.shape_b.tolist()


@NEEDS_TAICHI
def test_what_a_backend_has_no_kernels_for_is_refused_before_anything_changes():
    sim = build(first, backend="taichi")
    add(sim, second)
    version, ids = sim.layout_version, sim.ids.numpy("body_id").tolist()
    with pytest.raises(ValueError, match="backend is 'taichi', which has no rows of surfaces that move"):
        add(sim, lambda b: b.add_discs([(0.0, 2.0)], 0.2, rolling_resistance=0.1))
    with pytest.raises(ValueError, match="backend is 'taichi', which has no sensors"):
        add(sim, lambda b: b.add_box(b.add_body(type=dc.BodyType.STATIC), 0.5, 0.5, sensor=True))
    assert (sim.layout_version, sim.ids.numpy("body_id").tolist()) == (version, ids)


def _arrays(sim):
    """Every array of a simulation, and what it goes on with."""
    groups = {"model": sim.model, "state": sim.state, "built": sim.built, "joints": sim.joints, "ids": sim.ids}
    groups |= sim.storage.groups()
    found = {(key, name): group.numpy(name).tobytes() for key, group in groups.items() for name in group.table}
    return found, sim.layout_version, sim.variant, sim.added_kernels


def _belt(sim):
    more = sim.additions()
    more.add_box(more.existing(0), 1.0, 1.0, surface_speed=1.0)
    sim.add(more)


def _rolling(sim):
    add(sim, lambda b: b.add_discs([(0.0, 2.0)], 0.2, rolling_resistance=0.1))


@NEEDS_TAICHI
@pytest.mark.parametrize("change", [_belt, _rolling])
def test_a_refused_change_leaves_every_array(change):
    sim = build(first, backend="taichi")
    before = _arrays(sim)
    with pytest.raises(ValueError, match="backend is 'taichi', which has no rows of surfaces that move"):
        change(sim)
    assert _arrays(sim) == before


def test_events_follow_their_shapes_where_worlds_grow():
    sim = build(first, worlds=2)
    sim.run(40, DT)
    events = dc.ContactEvents(sim)
    touching = np.stack([events.touching.shape_a, events.touching.shape_b])
    sim.additions(0)
    add(sim, second, world=0)
    add(sim, lambda b: b.add_discs([(0.0, 9.0)], 0.1), world=0)
    assert not np.array_equal(sim.index(shapes=touching[0]), touching[0])
    events.update()
    assert (len(events.begun.impulse), len(events.ended.impulse)) == (0, 0)
    assert events.touching.shape_a.tolist() == sim.index(shapes=touching[0]).tolist()
    assert events.touching.shape_b.tolist() == sim.index(shapes=touching[1]).tolist()


def test_what_takes_the_slot_of_another_shape_begins_to_touch_and_what_was_removed_ends_nothing():
    sim = build(lambda b: b.add_discs([(0.0, 0.25), (1.0, 0.25)], 0.25))
    sim.run(30, DT)
    events = dc.ContactEvents(sim)
    assert events.touching.body_b.tolist() == [1, 2]
    sim.remove(bodies=1)
    added = add(sim, lambda b: b.add_discs([(0.0, 0.249)], 0.25))
    slot = sim.index(bodies=added.bodies).tolist()
    assert slot == [1]
    sim.run(1, DT)
    events.update()
    assert events.begun.body_b.tolist() == slot
    assert events.ended.body_b.tolist() == []
    assert events.touching.body_b.tolist() == [1, 2]
    sim.remove(bodies=2)
    events.update()
    assert (events.begun.body_b.tolist(), events.ended.body_b.tolist()) == ([], [])
    assert events.touching.body_b.tolist() == slot


def test_what_was_added_is_taken_back_without_the_bodies_that_were_there():
    sim = build(first)
    more = sim.additions()
    more.add_disc(more.existing(5), 0.1, center=(0.0, 0.4))
    bob = more.add_discs([(0.0, 2.0)], 0.1)[0]
    more.add_distance_joint(more.existing(0), bob)
    added = sim.add(more)
    assert (added.bodies.tolist(), added.new_bodies.tolist()) == ([5, 6, 0], [6])
    sim.remove(bodies=added.new_bodies, shapes=added.shapes, joints=added.joints)
    assert sorted(sim.ids.numpy("body_id")[sim.ids.numpy("body_id") >= 0]) == list(range(6))
    assert sim.ids.numpy("shape_id").max() == 7
    assert sim.joints.sizes["joint"] == 0


def test_steps_end_at_the_last_slot_that_has_been_filled():
    """What was removed is passed over when its pairs are forgotten for sure: after the arrays are laid out anew."""
    sim = build(first, worlds=2)
    bodies, shapes = sim.model.body_count // 2, sim.model.shape_count // 2

    def empty(sim):
        return [sim.motion.numpy("empty_bodies").tolist(), sim.pairs.numpy("empty_shapes").tolist()]

    assert empty(sim) == [[0, 0], [0, 0]]
    sim.reserve(bodies=6, shapes=10)
    assert empty(sim) == [[7, 7], [10, 10]]  # and the body that has the shapes of empty slots
    sim.run(3, DT)
    added = add(sim, second, world=1)
    assert empty(sim) == [[7, 4], [10, 6]]
    sim.run(3, DT)
    sim.remove(bodies=added.bodies)
    assert empty(sim) == [[7, 4], [10, 6]]
    there = sim.ids.numpy("body_id") >= 0
    assert not sim.motion.numpy("predicted")[: len(there)][~there][:7].any()
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    loaded = dc.Simulation.load(file)
    assert empty(loaded) == [[7, 7], [10, 10]]
    for one in (sim, loaded):
        one.run(20, DT)
    assert bits(sim, slice(None)) == bits(loaded, slice(None))
    sim.reserve(bodies=8)
    assert empty(sim) == [[9, 9], [10, 10]]
    assert bodies + 9 == sim.model.body_count // 2 and shapes + 10 == sim.model.shape_count // 2


def test_shapes_of_emptied_slots_keep_their_boxes():
    """They are looked at once after each change, so that those before the last that is filled cost next to nothing."""
    sim = build(first)
    added = add(sim, second)
    add(sim, second)
    sim.run(3, DT)
    sim.remove(bodies=added.bodies)
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    for one in (sim, dc.Simulation.load(file)):
        holes = np.flatnonzero(one.ids.numpy("shape_id") < 0)
        holes = holes[holes < np.flatnonzero(one.ids.numpy("shape_id") >= 0).max()]
        assert len(holes)
        one.run(2, DT)
        swept, box = one.pairs.numpy("swept"), one.pairs.numpy("box")
        assert (box[holes, :2] < swept[holes, :2]).all() and (swept[holes, 2:] < box[holes, 2:]).all()
        assert (box[holes] < 0).all()  # far from all
        swept[holes] = box[holes]
        one.run(2, DT)
        assert (swept[holes] == box[holes]).all()


def test_finite_numbers_in_empty_slots_mean_nothing():
    sim = build(first)
    sim.remove(bodies=1)
    other = sim.clone()
    empty = sim.ids.numpy("body_id") < 0
    assert empty.sum() == 2
    for name, value in (("position", 3.0), ("angle", 1.0), ("force", 7.0), ("velocity", 2.0)):
        sim.state.numpy(name)[empty] = value
    for one in (sim, other):
        one.run(10, DT)
    assert bits(sim, ~empty) == bits(other, ~empty)
    assert (sim.state.flags.numpy() == 0).all()


def test_sensors_come_and_go():
    sim = build(first)
    gate = add(sim, lambda b: b.add_box(b.add_body((0.5, 0.3), type=dc.BodyType.STATIC), 0.5, 0.5, sensor=True))
    sim.run(2, DT)
    assert dc.sensor_events(sim).shape_b.tolist() == [7]  # the box
    sim.remove(bodies=5)
    assert dc.sensor_events(sim).shape_b.tolist() == []
    sim.run(1, DT)
    sim.remove(bodies=gate.bodies)
    assert "sense_overlaps" not in sim.kernels
    sim.run(2, DT)


def test_damping_and_surfaces_come_with_the_first_that_has_them():
    sim = build(first)
    sim.run(3, DT)
    added = add(sim, lambda b: b.add_discs([(0.0, 2.5)], 0.2, linear_damping=5.0, rolling_resistance=0.1))
    check(sim)
    assert sim.model.numpy("linear_damping")[sim.index(bodies=added.bodies)].tolist() == [5.0]
    assert sim.model.numpy("gravity_scale").min() == 1.0
    assert np.count_nonzero(sim.model.numpy("shape_rolling_resistance")) == 1
    sim.run(20, DT)
    v = sim.state.numpy("velocity")[sim.index(bodies=added.bodies)][0, 1]
    assert v == pytest.approx(-9.8 / 5.0 * (1 - np.exp(-5.0 * 0.2)), rel=1e-5)


def test_reset_goes_back_to_what_was_added():
    sim = build(first)
    added = add(sim, second)
    start = bits(sim, slice(None))
    sim.run(20, DT)
    sim.remove(bodies=1)
    sim.reset()
    stays = np.flatnonzero(sim.ids.numpy("body_id") >= 0)
    now = {name: sim.state.numpy(name)[stays] for name in FIELDS}
    for name, then in start.items():
        then = np.frombuffer(then, np.float32).reshape((sim.model.body_count, -1))[stays].reshape(now[name].shape)
        assert now[name].tobytes() == then.tobytes()
    assert sim.index(bodies=added.bodies).min() >= 0


def test_what_is_given_for_all_leaves_empty_slots_empty():
    sim = build(first)
    sim.remove(bodies=[1, 5])
    sim.change_model(shape_category=3, shape_mask=0xFFFFFFFF, shape_friction=0.2)
    empty = sim.ids.numpy("shape_id") < 0
    assert empty.sum() == 2
    assert not sim.model.numpy("shape_category")[empty].any()
    sim.run(10, DT)


def test_what_lay_on_a_body_that_goes_wakes():
    config = dc.SolverConfig(sleep=True, sleep_time=0.1)
    sim = build(lambda b: b.add_discs([(0.0, 0.25), (0.0, 0.75), (2.0, 0.25)], 0.25), config=config)
    sim.run(200, DT)
    assert sim.asleep[1:4].all()
    sim.remove(bodies=1)
    high = float(sim.state.numpy("position")[2, 1])
    sim.run(10, DT)
    assert not sim.asleep[2]
    assert sim.asleep[3]  # which did not touch it
    assert sim.state.numpy("position")[2, 1] < high - 0.02
    sim.run(300, DT)
    assert sim.asleep[2:4].all()
    add(sim, lambda b: b.add_discs([(2.0, 1.0)], 0.25))  # falls upon one that sleeps
    sim.run(25, DT)
    assert not sim.asleep[3]
    sim.run(300, DT)
    assert sim.sleepers.sleeping.numpy().tolist() == [3]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda sim: sim.add(dc.ModelBuilder()), TypeError, r"additions is .*it must be what sim.additions\(\) makes"),
        (lambda sim: sim.add(build(first).additions()), ValueError, "made for another simulation"),
        (lambda sim: sim.additions(1), ValueError, r"world is 1; it must lie in \[0, 0\]"),
        (lambda sim: sim.additions(-1), ValueError, r"world is -1; it must lie in \[0, 0\]"),
        (
            lambda sim: build(first, worlds=2).additions().add_body(),
            ValueError,
            "body 0 has no world: call to_world first",
        ),
        (lambda sim: build(first, worlds=2).additions().existing(9), ValueError, "body 9 has no world: call to_world"),
        (lambda sim: sim.additions().add_world(), TypeError, "to_world"),
        (lambda sim: sim.additions().finalize(), TypeError, r"sim.add\(additions\)"),
        (lambda sim: sim.additions().existing(17), ValueError, "body is the id 17, which has never been"),
        (lambda sim: sim.additions().add_disc(0, 1.0), ValueError, "body of shape 0 is 0"),
        (lambda sim: sim.additions().add_body((float("nan"), 0)), ValueError, "position"),
        (lambda sim: sim.remove(bodies=[1, 1]), ValueError, r"bodies\[1\] is the id 1, which is there already"),
        (lambda sim: sim.remove(bodies=1.5), TypeError, "bodies"),
        (lambda sim: sim.remove(bodies=-1), ValueError, r"bodies\[0\] is the id -1, which has never been"),
        (lambda sim: sim.remove(joints=0), ValueError, r"joints\[0\] is the id 0, .* no joint has$"),
        (lambda sim: sim.reserve(bodies=-1), ValueError, "bodies"),
        (lambda sim: sim.index(bodies=1, shapes=1), ValueError, "ids of bodies, of shapes, or of joints"),
        (lambda sim: (sim.collide(DT), sim.remove(bodies=1)), ValueError, r"remove\(\) in the middle of a step"),
    ],
)
def test_a_wrong_change_is_refused_and_changes_nothing(change, error, message):
    sim = build(first)
    before = bits(sim, slice(None))
    with pytest.raises(error, match=message):
        change(sim)
    assert bits(sim, slice(None)) == before


def test_additions_to_what_has_changed_or_gone_are_refused_and_so_is_a_model_that_is_shared():
    sim = build(first)
    more = sim.additions()
    more.add_disc(more.existing(1), 0.1)
    sim.change_model(body_type=[0, 0, 2, 2, 2, 2])
    with pytest.raises(ValueError, match="body 1 has become STATIC: begin the additions anew"):
        sim.add(more)
    other = dc.Simulation(sim.model, sim.state.copy())
    with pytest.raises(ValueError, match="whose model or joints another one has too"):
        sim.remove(bodies=1)
    del other
    gone = build(first)
    more = gone.additions()
    more.existing(1)
    gone.remove(bodies=1)
    with pytest.raises(ValueError, match="is the id 1, which has been removed"):
        gone.add(more)
