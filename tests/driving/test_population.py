"""Bodies, shapes and joints that come and go: the bits of a world built at once, ids, room, errors."""

import io
import pickle

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.validate.scene import check_joints, check_model, check_state
from tests.backends import NEEDS_TAICHI
from tests.driving.scenes import simulation

DT = 0.01
CONFIG = dc.SolverConfig(tolerance=1e-6, max_sweeps=80)
FIELDS = ("position", "angle", "velocity", "angular_velocity")


def ground(builder):
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, ((-3, 3), (-3, 0), (3, 0), (3, 3)))
    return floor


def first(builder):
    """What a world begins with."""
    discs = builder.add_discs([(-2.0 + 0.5 * i, 0.24) for i in range(4)], 0.25, angular_velocity=0.5)
    box = builder.add_body((0.5, 0.3), angle=0.1)
    builder.add_box(box, 0.4, 0.25, radius=0.01)
    return [*discs, box]


def second(builder):
    """What comes: a dumbbell of two shapes, a capsule, a disc that is pushed."""
    dumbbell = builder.add_body((-1.5, 0.9), angle=0.3)
    builder.add_disc(dumbbell, 0.2, center=(-0.3, 0.0))
    builder.add_box(dumbbell, 0.15, 0.15, center=(0.3, 0.0))
    capsule = builder.add_body((0.6, 1.1))
    builder.add_capsule(capsule, (-0.3, 0.0), (0.3, 0.1), 0.15)
    disc = builder.add_body((1.5, 0.4), velocity=(-1.0, 0.0))
    builder.add_disc(disc, 0.25)
    return [dumbbell, capsule, disc]


def build(*parts, worlds=1, dtype="float32", backend="warp", **options):
    """A simulation of worlds that each have some parts from the beginning."""
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world(length_scale=0.5)
        ground(builder)
        for part in parts:
            part(builder)
    options.setdefault("config", CONFIG)
    return dc.Simulation(*builder.finalize(dtype, backend=backend), **options)


def add(sim, part, world=None):
    more = sim.additions(world)
    part(more)
    return sim.add(more)


def bits(sim, bodies):
    return {name: sim.state.numpy(name)[bodies].tobytes() for name in FIELDS}


def check(sim):
    """The arrays are those of a scene."""
    model = sim.model.views()
    check_model(model)
    check_state(sim.state.views(), model)
    check_joints(sim.joints.views(), model)


def twin(sim, other):
    """Another simulation goes on from the state, the contacts and their impulses of one.

    Both have the same bodies and shapes in the same order, the one among empty slots.
    """
    bodies, shapes = (np.flatnonzero(sim.ids.numpy(f"{kind}_id") >= 0) for kind in ("body", "shape"))
    for name in FIELDS:
        other.state.assign(name, sim.state.numpy(name)[bodies])
    slots, _ = dc.contact_slots(sim.contacts)
    arrays = {name: sim.contacts.numpy(name)[slots] for name in ("key", "impulse", "color", "age")}
    key = arrays["key"]
    place = np.full(sim.model.shape_count, -1)
    place[shapes] = np.arange(len(shapes))
    a, b = place[key >> 39], place[(key >> 16) & (2**23 - 1)]
    assert min(a.min(), b.min()) >= 0
    arrays["key"] = (a << 39) | (b << 16) | (key & 0xFFFF)
    other.restore_contacts(sim.contacts.numpy("contact_count"), arrays, sim.contacts.numpy("contact_dt"))
    return bodies


@pytest.mark.parametrize(
    ("dtype", "backend", "reserved"),
    [
        ("float32", "warp", False),
        ("float32", "warp", True),
        ("float64", "numpy", True),
        pytest.param("float32", "taichi", True, marks=NEEDS_TAICHI),
    ],
)
def test_what_is_added_before_the_first_step_moves_as_if_built_at_once(dtype, backend, reserved):
    steps = 8 if backend == "numpy" else 60
    whole = build(first, second, dtype=dtype, backend=backend)
    sim = build(first, dtype=dtype, backend=backend)
    if reserved:
        sim.reserve(bodies=5, shapes=6, vertices=24)
        sim.collide(DT)  # bound, as the slots are then filled
        sim.solve()
        sim.advance()
        sim.reset()
    version = sim.model.version
    added = add(sim, second)
    assert (sim.model.version == version) is reserved
    check(sim)
    for one in (whole, sim):
        if backend == "taichi":  # stage by stage: parity/test_taichi_solve.py compiles the same kernels
            for _ in range(steps):
                one.collide(DT)
                one.solve()
                one.advance()
        else:
            one.run(steps, DT)
    bodies = np.flatnonzero(sim.ids.numpy("body_id") >= 0)
    assert sim.index(bodies=added.bodies).tolist() == bodies[-3:].tolist()
    assert bits(sim, bodies) == bits(whole, slice(None))
    assert sim.contacts.contact_count.numpy().sum() > 5 if backend == "warp" else True


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_after_bodies_came_and_went_a_world_moves_as_one_built_at_once_of_what_is_there(dtype):
    sim = build(first, dtype=dtype)
    sim.run(20, DT)
    added = add(sim, second)
    sim.run(40, DT)
    sim.remove(bodies=[2, 5, added.bodies[0]])
    check(sim)

    def rest(builder):
        discs = [i for i in range(4) if i != 1]  # the bodies 1 to 4 are discs; 2 goes, and the box, 5
        builder.add_discs([(-2.0 + 0.5 * i, 0.24) for i in discs], 0.25)

    def came(builder):
        capsule = builder.add_body((0.6, 1.1))
        builder.add_capsule(capsule, (-0.3, 0.0), (0.3, 0.1), 0.15)
        builder.add_disc(builder.add_body((1.5, 0.4)), 0.25)

    whole = build(rest, came, dtype=dtype)
    bodies = twin(sim, whole)
    assert sim.contacts.contact_count.numpy()[0] >= 4
    assert (sim.contacts.numpy("impulse")[: sim.contacts.contact_count.numpy()[0], 0] > 0).any()
    for _ in range(30):
        sim.step(DT)
        whole.step(DT)
        assert bits(sim, bodies) == bits(whole, slice(None))
    assert sim.stats.sweeps.numpy().tolist() == whole.stats.sweeps.numpy().tolist()


def test_a_slot_is_taken_by_the_next_body_and_old_ids_are_refused():
    sim = build(first)
    sim.run(30, DT)
    place = int(sim.index(bodies=2)[0])
    sim.remove(bodies=2)
    more = sim.additions()
    square = more.add_body((0.0, 2.0))
    more.add_box(square, 0.2, 0.2)  # 4 vertices where there was one
    added = sim.add(more)
    check(sim)
    assert sim.index(bodies=added.bodies).tolist() == [place]
    assert added.bodies.tolist() == [6]
    for call in (sim.remove, sim.index):
        with pytest.raises(ValueError, match=r"bodies\[1\] is the id 2, which has been removed"):
            call(bodies=[1, 2])
    sim.run(100, DT)
    assert sim.state.numpy("position")[place][1] == pytest.approx(0.2, abs=0.3)
    assert (sim.state.flags.numpy() == 0).all()


def test_contacts_of_what_stays_keep_their_impulses_and_those_of_what_goes_are_forgotten():
    sim = build(lambda b: b.add_discs([(0.0, 0.25 + 0.5 * i) for i in range(4)], 0.25))
    sim.run(100, DT)
    pressed = sim.contacts.numpy("impulse")[:4, 0].copy()
    keys = sim.contacts.numpy("key")[:4].copy()
    sim.remove(bodies=4)  # the topmost
    count = int(sim.contacts.contact_count.numpy()[0])
    assert count == 3
    kept = np.isin(keys, sim.contacts.numpy("key")[:count])
    assert sim.contacts.numpy("impulse")[:count, 0].tobytes() == pressed[kept].tobytes()
    assert sim.cache.numpy("count").tolist() == [3]
    add(sim, lambda b: b.add_discs([(0.0, 1.75)], 0.25))  # in the slot that has become free
    sim.collide(DT)
    count = int(sim.contacts.contact_count.numpy()[0])
    fresh = ~np.isin(sim.contacts.numpy("key")[:count], keys[kept])
    assert fresh.sum() == 1
    assert sim.contacts.numpy("age")[:count][fresh].tolist() == [0]
    assert not sim.contacts.numpy("impulse")[:count][fresh].any()
    assert (sim.contacts.numpy("impulse")[:count][~fresh, 0] > 0).all()


def pendulums(builder):
    pivot = builder.add_body((0.0, 2.5), type=dc.BodyType.STATIC)
    bobs = builder.add_discs([(0.5, 2.5), (1.0, 2.5)], 0.1)
    builder.add_revolute_joint(pivot, bobs[0])
    builder.add_distance_joint(bobs[0], bobs[1], length=0.5)


def test_a_joint_between_bodies_that_are_there_acts_as_if_built_at_once():
    def loose(builder):
        builder.add_body((0.0, 2.5), type=dc.BodyType.STATIC)
        builder.add_discs([(0.5, 2.5), (1.0, 2.5)], 0.1)

    whole, sim = build(first, pendulums), build(first, loose)
    more = sim.additions()
    pivot, one, other = (more.existing(body) for body in (6, 7, 8))
    more.add_revolute_joint(pivot, one)
    more.add_distance_joint(one, other, length=0.5)
    added = sim.add(more)
    assert added.bodies.tolist() == [6, 7, 8]
    check(sim)
    whole.run(50, DT)
    sim.run(50, DT)
    bodies = np.flatnonzero(sim.ids.numpy("body_id") >= 0)
    assert bits(sim, bodies) == bits(whole, slice(None))
    pulled = sim.joints.numpy("joint_impulse").copy()
    assert pulled.any()
    sim.remove(joints=added.joints[0])
    rest = sim.joints.numpy("joint_impulse")
    assert rest.tobytes() == pulled[-1:].tobytes()
    assert sim.cache.numpy("joint_impulse").tobytes() == rest.tobytes()
    sim.run(60, DT)
    assert sim.state.numpy("position")[7, 1] < 1.0  # it fell
    sim.remove(bodies=7)
    assert sim.joints.sizes["joint"] == 0
    with pytest.raises(ValueError, match=r"joints\[0\] is the id 1, which has been removed"):
        sim.index(joints=added.joints[1])


@pytest.mark.parametrize("gone", ["joint", "body"])
def test_after_a_joint_went_a_world_moves_as_one_built_at_once_of_what_is_there(gone):
    def shorter(builder):
        pivot = builder.add_body((0.0, 2.5), type=dc.BodyType.STATIC)
        bobs = builder.add_discs([(0.5, 2.5), (1.0, 2.5)][: 1 if gone == "body" else 2], 0.1)
        builder.add_revolute_joint(pivot, bobs[0])

    sim, whole = build(first, pendulums), build(first, shorter)
    sim.run(30, DT)
    sim.remove(**({"joints": 1} if gone == "joint" else {"bodies": 8}))
    bodies = twin(sim, whole)
    whole.change_model(joint_impulse=sim.joints.numpy("joint_impulse"))
    assert sim.joints.numpy("joint_impulse").any()
    for _ in range(30):
        sim.step(DT)
        whole.step(DT)
        assert bits(sim, bodies) == bits(whole, slice(None))


def test_shapes_come_and_go_at_bodies_that_stay():
    sim = build(first)
    more = sim.additions()
    box = more.existing(5)
    more.add_disc(box, 0.3, center=(0.0, 0.5))
    added = sim.add(more)
    check(sim)
    lift = sim.state.numpy("position")[5, 1]
    sim.run(100, DT)
    queries = dc.Queries(sim)
    assert (
        queries.overlap_points([sim.state.numpy("position")[5]]).index.tolist()
        == [7, *sim.index(shapes=added.shapes)][:1]
    )
    sim.remove(shapes=[*added.shapes, 7])
    check(sim)
    queries.update()
    assert queries.overlap_points([sim.state.numpy("position")[5]]).index.tolist() == []
    sim.run(100, DT)
    assert sim.state.numpy("position")[5, 1] < lift - 1.0  # without shapes it falls through the floor
    with pytest.raises(ValueError, match=r"shapes\[0\] is the id 7, which has been removed"):
        sim.remove(shapes=7)


def test_several_worlds_are_added_to_in_one_call_and_keep_their_bits():
    sim, alone = build(first, worlds=3), build(first, worlds=3)
    sim.run(10, DT)
    alone.run(10, DT)
    more = sim.additions(2)
    second(more)
    more.to_world(0)
    second(more)
    added = sim.add(more)
    check(sim)
    index = sim.index(bodies=added.bodies)
    start = sim.model.numpy("body_start")
    assert (np.searchsorted(start, index, "right") - 1).tolist() == [2, 2, 2, 0, 0, 0]
    assert len(set(np.diff(start).tolist())) == 1  # views of worlds of one size stay arrays
    assert sim.state.worlds("position").shape == (3, start[1], 2)
    sim.run(30, DT)
    alone.run(30, DT)
    ids = sim.index(bodies=np.arange(6, 12))  # of the world in the middle
    assert bits(sim, ids) == bits(alone, slice(6, 12))
    one, two = (sim.state.worlds("position")[w] for w in (0, 2))
    assert one.tobytes() == two.tobytes() != sim.state.worlds("position")[1].tobytes()
    sim.remove(bodies=added.bodies[:3])
    sim.run(5, DT)
    check(sim)


@pytest.mark.parametrize("way", ["clone", "pickle", "file"])
def test_copies_and_files_keep_slots_and_ids(way):
    sim = build(first)
    add(sim, second)
    sim.run(20, DT)
    sim.remove(bodies=[2, 7])
    if way == "file":
        file = io.BytesIO()
        sim.save(file)
        file.seek(0)
        other = dc.Simulation.load(file)
    else:
        other = sim.clone() if way == "clone" else pickle.loads(pickle.dumps(sim))
    for name in sim.ids.table:
        assert other.ids.numpy(name).tolist() == sim.ids.numpy(name).tolist()
    for one in (sim, other):
        one.run(5, DT)
        assert add(one, second).bodies.tolist() == [9, 10, 11]
        one.run(20, DT)
    assert bits(sim, slice(None)) == bits(other, slice(None))


@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("body_id", 1, 0, r"body_id\[1\] is 0; it must be there once"),
        ("body_id", 1, 99, r"body_id\[1\] is 99; it must be in \[-2, 8\]"),
        ("body_id", 1, -1, r"body_id\[1\] is -1; it must be >= 0, for its body is not STATIC"),
        ("shape_id", 3, -1, r"shape_id\[3\] is -1; it must be -1 if its body has the id -2, else >= 0"),
        ("next_id", 0, 3, r"body_id\[3\] is 3; it must be in \[-2, 2\]"),
        ("next_id", 2, -5, r"next_id\[2\] is -5; it must be in \[0, "),
    ],
)
def test_ids_that_were_tampered_with_are_refused(name, index, value, message, tmp_path):
    h5py = pytest.importorskip("h5py")
    sim = build(first)
    add(sim, second)
    sim.remove(bodies=2)
    assert repr(sim).startswith("<Simulation of 1 world and 8 bodies in 1")
    sim.save(tmp_path / "changed.h5")
    dc.Simulation.load(tmp_path / "changed.h5")
    with h5py.File(tmp_path / "changed.h5", "r+") as file:
        file[f"ids/{name}"][index] = value
    with pytest.raises(ValueError, match=f"dataset ids/{message}"):
        dc.Simulation.load(tmp_path / "changed.h5")


def test_with_room_views_and_what_was_bound_stay():
    sim = build(first)
    sim.reserve(bodies=3, shapes=4, vertices=12)
    sim.run(2, DT)
    view, launches = sim.state.numpy("position"), sim._rounds["step"]
    for _ in range(4):
        added = add(sim, second)
        sim.run(3, DT)
        assert np.shares_memory(sim.state.numpy("position"), view)
        sim.remove(bodies=added.bodies)
        sim.run(1, DT)
    assert sim._rounds["step"] is launches


def test_a_simulation_that_does_not_grow_says_what_is_missing_and_stays_as_it_was():
    sim = build(first, on_overflow="raise")
    sim.reserve(bodies=2, shapes=8, vertices=30)
    before = bits(sim, slice(None))
    with pytest.raises(OverflowError, match="world 0 needs 10 body slots, 9 are there; reserve more before"):
        add(sim, second)
    assert bits(sim, slice(None)) == before
    add(sim, lambda b: b.add_discs([(0.0, 2.0), (1.0, 2.0)], 0.2))
    sim.run(5, DT)


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
