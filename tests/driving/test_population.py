"""Bodies, shapes and joints that come and go: the bits of a world built at once, ids, room."""

import io
import pickle

import numpy as np
import pytest

import dc_kernels as dc
from tests.backends import NEEDS_TAICHI
from tests.driving.populated import DT, FIELDS, add, bits, build, check, first, second


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
