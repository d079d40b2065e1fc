"""Contacts that do not act: one-way shapes, one-sided chains, and what a user changes between collide and solve."""

import dataclasses
import io

import numpy as np
import pytest

import dc_kernels as dc
from tests.parity.scenes import crowd

DT = 0.01
G = 9.8
SWITCHES = dc.SolverConfig(contact_switches=True)


def steps(sim, count, dt=DT):
    """Positions and velocities after each of some steps, (count, bodies, 2) each."""
    found = []
    for _ in range(count):
        sim.step(dt)
        found.append([sim.state.numpy("position").copy(), sim.state.numpy("velocity").copy()])
    return np.moveaxis(np.array(found), 1, 0)


def platform(kind, one_way=(0.0, 1.0), backend="warp", angle=0.0, **jumper):
    """A platform at y = 0 that turns by an angle, and a disc and a box below it that are thrown up."""
    builder = dc.ModelBuilder()
    builder.add_world(origin=(5.0, 5.0))
    body = builder.add_body((5.0, 5.0), angle, type=dc.BodyType.STATIC)
    if kind == "box":
        builder.add_box(body, 3.0, 0.25, one_way=one_way)
    elif kind == "chain":
        builder.add_chain(body, np.stack([np.linspace(3, -3, 7), np.zeros(7)], axis=1), one_way=one_way)
    elif kind == "one-sided":
        builder.add_chain(body, np.stack([np.linspace(3, -3, 7), np.zeros(7)], axis=1), one_sided=True)
    for x in (-1.5, 1.1):
        thrown = builder.add_body((5.0 + x, 5.0 - 1.5), velocity=(0.0, 9.0), angular_velocity=0.7, **jumper)
        if x < 0:
            builder.add_disc(thrown, 0.3)
        else:
            builder.add_box(thrown, 0.25, 0.25)
    return dc.Simulation(*builder.finalize("float64", backend=backend))


@pytest.mark.parametrize("kind", ["box", "chain", "one-sided"])
def test_what_jumps_through_a_platform_flies_free_and_lands_on_it(kind):
    """Bit for bit as without it until it falls onto the top, where it rests; so it does from high above."""
    sim, free = platform(kind), platform("none")
    (place, _), (flown, _) = steps(sim, 320), steps(free, 320)
    top = 0.25 if kind == "box" else 0.0
    for body, reach in ((1, 0.3), (2, 0.25)):
        fallen = int(np.flatnonzero((flown[:, body, 1] < top + reach) & (np.arange(320) > 100))[0])
        assert place[: fallen - 10, body].tobytes() == flown[: fallen - 10, body].tobytes()
        assert place[-1, body, 1] == pytest.approx(top + reach, abs=2e-3)
        assert abs(place[-40:, body, 1] - place[-1, body, 1]).max() < 1e-3
    count = sim.contacts.numpy("contact_count")[0]
    assert count >= 3 and (sim.contacts.numpy("age")[:count] > 50).all()


@pytest.mark.parametrize("kind", ["box", "chain"])
@pytest.mark.parametrize(
    ("place", "velocity", "way"),
    [
        ((-4.0, 0.1), (5.0, 0.0), "through"),  # from aside
        ((-1.0, -1.0), (0.0, 3.0), "through"),  # from below
        ((-1.0, 1.2), (0.0, -3.0), "stops"),
        ((-3.0, 1.5), (2.0, -3.0), "stops"),
    ],
)
def test_the_side_that_it_comes_from_decides(kind, place, velocity, way):
    """In a world without gravity, turned by any angle: direction and velocities are the platform's."""
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    body = builder.add_body(angle=angle, type=dc.BodyType.STATIC)
    if kind == "box":
        builder.add_box(body, 3.0, 0.25, one_way=(0.0, 2.0))
    else:
        builder.add_chain(body, [(-3.0, 0.0), (0.0, 0.0), (3.0, 0.0)], one_way=(0.0, 2.0))
    builder.add_discs([turn @ place], 0.3, velocity=turn @ velocity, friction=0.0)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.run(60, DT)
    moved, kept = turn.T @ sim.state.numpy("velocity")[1], np.array(velocity)
    if way == "stops":
        kept[1] = 0.0
    np.testing.assert_allclose(moved, kept, atol=1e-12 if way == "through" else 1e-6)


def test_what_turns_back_within_a_platform_falls_out_of_it():
    """A disc whose apex lies within a thick platform, and a mast that stands on the ground and reaches through it."""
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(body, 6.0, 0.5, center=(0.0, -2.5))
    builder.add_box(body, 4.0, 0.25, one_way=(0.0, 1.0))
    disc = builder.add_discs([(-2.0, -1.0)], 0.3, velocity=(0.0, np.sqrt(2 * G * 0.9)))[0]
    mast = builder.add_body((2.0, 0.0))
    builder.add_box(mast, 0.2, 2.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(contact_events=True))
    (place, _), touched = steps(sim, 45), dc.contact_events(sim)
    assert abs(place[:, disc, 1].max() + 0.1) < 0.05 and touched.shape_b.tolist() == [3]
    (place, _) = steps(sim, 250)
    assert "one-way: 1 one-sided shape; 2 contacts inactive in the last step" in sim.explain()
    assert place[-1, disc, 1] == pytest.approx(-1.7, abs=2e-3)
    assert place[-1, mast] == pytest.approx([2.0, 0.0], abs=2e-3)
    assert dc.overlap(sim).max < 1e-3  # what passes through a platform overlaps nothing that holds it
    look = dc.ContactEvents(sim)
    assert len(look.touching.shape_a) == len(dc.contact_events(sim).shape_a) == 2
    off = sim.contacts.numpy("color")[: sim.contacts.numpy("contact_count")[0]] < 0
    assert off.sum() == 2 and not sim.contacts.numpy("impulse")[: len(off)][off].any()
    assert (np.diff(sim.contacts.numpy("key")[: len(off)]) > 0).all()  # those that are off among the others
    assert (sim.contacts.numpy("age")[: len(off)][off] > 100).all()


def test_a_lift_that_is_one_way_carries_what_it_comes_to_from_below():
    builder = dc.ModelBuilder()
    builder.add_world()
    lift = builder.add_body((0.0, -3.0), velocity=(0.0, 1.0), type=dc.BodyType.KINEMATIC)
    builder.add_box(lift, 3.0, 0.1, one_way=(0.0, 1.0))
    shelf = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(shelf, 1.0, 0.1)
    crate = builder.add_body((0.0, 0.35))
    builder.add_box(crate, 0.25, 0.25)
    below = builder.add_body((2.0, -4.0), velocity=(0.0, 9.0))
    builder.add_box(below, 0.25, 0.25)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.run(500, DT)
    assert sim.state.numpy("position")[[lift, crate, below], 1] == pytest.approx([2.0, 2.35, 2.35], abs=5e-3)
    assert sim.state.numpy("velocity")[[crate, below], 1] == pytest.approx([1.0, 1.0], abs=1e-3)


def bowl():
    """Vertices of a hollow regular polygon, clockwise, so that its inside is to the right of the way around it."""
    turn = np.linspace(0, 2 * np.pi, 25)[:-1]
    return 3.0 * np.stack([np.cos(turn), -np.sin(turn)], axis=1)


def test_a_one_sided_chain_holds_from_one_side_alone():
    """What is in a bowl that opens inwards stays, with any spin and speed; what flies into it from outside passes."""
    draw = np.random.default_rng(0)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    body = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(body, bowl(), closed=True, one_sided=True, friction=0.3)
    inside = []
    for i in range(12):
        at = draw.uniform(-1.6, 1.6, 2)
        inside.append(builder.add_body(at, draw.uniform(-3, 3), draw.normal(0, 4, 2), draw.normal(0, 4)))
        if i % 2:
            builder.add_box(inside[-1], 0.2, 0.1, restitution=0.8, category=2, mask=1)
        else:
            builder.add_disc(inside[-1], 0.2, restitution=0.8, category=2, mask=1)
    speed = np.array([(6.0, 0.4), (-5.0, 0.0), (0.3, 7.0)])
    outside = builder.add_discs(
        -1.2 * speed, 0.2, velocity=speed, angular_velocity=2.0, category=2, mask=1, restitution=0.5
    )
    model, state, joints = builder.finalize("float64")
    sim = dc.Simulation(model, state, joints)
    for step in range(300):
        sim.step(DT)
        assert np.hypot(*sim.state.numpy("position")[inside].T).max() < 3.0
        came = sim.state.numpy("position")[outside]
        if step * DT < 1.2:  # in to the middle
            np.testing.assert_allclose(sim.state.numpy("velocity")[outside], speed, atol=1e-12)
            np.testing.assert_allclose(came, (step + 1) * DT * speed - 1.2 * speed, atol=1e-9)
    assert np.hypot(*came.T).max() < 3.0  # and they are held, once they are in
    assert abs(sim.state.numpy("velocity")[outside] - speed).max() > 1.0


def test_a_one_sided_chain_is_a_ground_like_another():
    """A box slides over its joints without a bump, and the bits are those of a chain that holds from both sides."""
    found = []
    for one_sided in (False, True):
        builder = dc.ModelBuilder()
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        corners = np.array([(4, 1.0), (3, 0.3), (2, 0), (1, 0), (0, 0), (-1, 0.0), (-2, 0), (-3, 0.5), (-4, 1.5)])
        builder.add_chain(ground, corners, one_sided=one_sided, friction=0.1)
        for i in range(6):
            body = builder.add_body((-1.5 + 0.6 * i, 1.0 + 0.5 * (i % 3)), 0.3 * i, velocity=(2.0, 0.0))
            if i % 2:
                builder.add_box(body, 0.3, 0.2)
            else:
                builder.add_disc(body, 0.25)
        sim = dc.Simulation(*builder.finalize("float64"))
        sim.run(300, DT)
        found.append(sim.state.numpy("position").copy())
    assert found[0].tobytes() == found[1].tobytes()


def test_the_oracle_agrees():
    """A crowd among one-way shapes and one-sided chains, with too little room, kernel by kernel in its results."""
    sims = []
    for backend in ("warp", "numpy"):
        builder = dc.ModelBuilder()
        crowd(builder, 5)
        builder.add_disc(builder.add_body((9.0, 9.0)), 1.0, one_way=(1.0, 1.0))
        model, state, joints = builder.finalize("float64", backend=backend)
        role, way = model.numpy("shape_role").copy(), model.numpy("shape_one_way").copy()
        role[::3], way[::3] = dc.ShapeRole.ONE_WAY, np.arange(len(way[::3]))
        role[model.numpy("shape_type") == dc.ShapeType.SEGMENT] = dc.ShapeRole.ONE_SIDED
        model.assign("shape_role", role)
        model.assign("shape_one_way", way)
        config = dc.SolverConfig(max_sweeps=10, contact_events=True, contact_switches=True)
        sims.append(dc.Simulation(model, state, joints, config=config, pairs_per_shape=0.5, contacts_per_body=0.2))
    off = 0
    for step in range(8):
        for sim in sims:
            sim.collide(DT)
            count = int(sim.contacts.numpy("contact_count")[0])
            sim.change_contacts(enabled=np.arange(count) % 5 > 0, friction=0.3 + 0.01 * step)
            sim.solve()
            sim.advance()
        one, two = (sim.contacts for sim in sims)
        count = int(one.numpy("contact_count")[0])
        assert count == two.numpy("contact_count")[0]
        for name in ("key", "body_a", "body_b", "color", "age"):
            np.testing.assert_array_equal(one.numpy(name)[:count], two.numpy(name)[:count], err_msg=name)
        for name in ("normal", "gap", "impulse", "friction"):
            np.testing.assert_allclose(one.numpy(name)[:count], two.numpy(name)[:count], atol=1e-8, err_msg=name)
        np.testing.assert_allclose(*(sim.state.numpy("position") for sim in sims), atol=1e-9)
        off += int((one.numpy("color")[:count] < 0).sum())
        assert (one.numpy("age")[:count][one.numpy("color")[:count] < 0] >= 0).all()
        lists = [dc.contact_events(sim) for sim in sims]
        np.testing.assert_array_equal(lists[0].shape_a, lists[1].shape_a)
    assert off > 20


def floors(mu=0.5, e=0.0, belt=0.0, worlds=3, backend="warp", config=SWITCHES, **options):
    """A crate on a floor in each world, one of which slides."""
    builder = dc.ModelBuilder()
    for w in range(worlds):
        builder.add_world(gravity=(0.0, -G))
        floor = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(floor, 20.0, 0.5, center=(0.0, -0.5), friction=mu, surface_speed=belt)
        crate = builder.add_body((0.0, 0.25), velocity=(3.0 * (w == 1), 0.0), fixed_rotation=True)
        builder.add_box(crate, 0.25, 0.25, friction=mu, restitution=e)
    return dc.Simulation(*builder.finalize("float64", backend=backend), config=config, **options)


@pytest.mark.parametrize("threads", [1, 2])
def test_contacts_that_are_switched_off_do_not_act(threads):
    """What they held falls freely; the others keep their bits; keys and ages go on; all of it over a snapshot."""
    sim, plain = floors(threads=threads), floors(config=None)
    for _ in range(20):
        for one in (sim, plain):
            one.step(DT)

    def start(sim):
        _, world = dc.contact_slots(sim.contacts)
        sim.switches.numpy("enabled")[dc.contact_slots(sim.contacts)[0]] = world != 2
        sim.change_contacts()  # what was written
        assert sim.contacts.numpy("contact_count").tolist() == [2, 2, 0]
        assert sim.switches.numpy("count").tolist() == [0, 0, 2]

    for _ in range(5):
        sim.step(DT, start)
        plain.step(DT)
    assert sim.contacts.numpy("contact_count").tolist() == [2, 2, 2]
    assert sim.contacts.numpy("age")[dc.contact_slots(sim.contacts)[0]].tolist() == [24] * 6
    found, wanted = sim.state.numpy("position"), plain.state.numpy("position")
    assert found[:4].tobytes() == wanted[:4].tobytes()
    fallen = G * DT**2 * np.arange(1, 6).sum()
    assert found[5, 1] == pytest.approx(wanted[5, 1] - fallen, abs=1e-12)
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    others = [sim.clone(), dc.Simulation.load(file)]
    for one in (sim, *others):
        one.run(3, DT, start)
        one.step(DT)  # and all act again
        assert one.switches.numpy("count").tolist() == [0, 0, 0]
        assert (one.contacts.numpy("color")[dc.contact_slots(one.contacts)[0]] >= 0).all()
    for other in others:
        assert sim.state.numpy("position").tobytes() == other.state.numpy("position").tobytes()
    sim.reset()
    sim.run(30, DT)
    assert sim.state.numpy("position")[[1, 5], 1] == pytest.approx([0.25, 0.25], abs=1e-3)


@pytest.mark.parametrize(
    ("method", "backend"), [("pgs", "warp"), ("jacobi", "warp"), ("tgs_soft", "warp"), ("pgs", "numpy")]
)
def test_friction_of_a_contact_is_what_it_was_changed_to(method, backend):
    """The crate loses mu g t, with the mu of its contacts of each step; the others stay where they are."""
    config = dc.SolverConfig(method=method, substeps=4 if method == "tgs_soft" else 1, tolerance=1e-9)
    sim = floors(backend=backend, config=config)
    sim.run(10, DT, lambda sim: sim.change_contacts(friction=0.1))
    speed = 3.0 - 0.1 * G * 10 * DT
    assert sim.state.numpy("velocity")[3, 0] == pytest.approx(speed, rel=1e-3)
    sim.run(5, DT, lambda sim: sim.change_contacts(friction=np.array([9.0, 9.0, 0.2, 0.2, 0.0, 0.0])))
    assert sim.state.numpy("velocity")[3, 0] == pytest.approx(speed - 0.2 * G * 5 * DT, rel=1e-3)
    sim.collide(DT)
    sim.contacts.numpy("friction")[dc.contact_slots(sim.contacts)[0]] = 0.0
    sim.change_contacts()
    before = sim.state.numpy("velocity")[3, 0]
    sim.solve()
    sim.advance()
    assert sim.state.numpy("velocity")[3, 0] == pytest.approx(before, abs=1e-9)


def test_restitution_and_belts_of_a_contact_are_what_they_were_changed_to():
    sim = floors(belt=1.0, worlds=2)
    sim.run(10, DT)
    mu, pushed = 0.5, sim.state.numpy("velocity")[1, 0]
    assert pushed == pytest.approx(mu * G * 10 * DT, rel=1e-2)
    slots, _ = dc.contact_slots(sim.contacts)
    sim.collide(DT)
    assert sim.rows.numpy("surface_speed")[slots].tolist() == [1.0] * 4
    sim.change_contacts(surface_speed=[-1.0, -1.0, 1.0, 1.0])
    sim.solve()
    sim.advance()
    assert sim.state.numpy("velocity")[1, 0] == pytest.approx(pushed - mu * G * DT, rel=1e-2)
    sim.state.numpy("velocity")[1] = (0.0, -4.0)
    sim.step(DT, lambda sim: sim.change_contacts(restitution=[0.75, 0.75, 0.0, 0.0]))
    assert sim.state.numpy("velocity")[1, 1] == pytest.approx(3.0, rel=1e-6)


def test_a_hook_that_changes_nothing_changes_no_bit():
    one, two = floors(e=0.3), floors(e=0.3, config=None)
    for sim in (one, two):
        sim.state.numpy("position")[1::2, 1] += 0.5
    one.run(60, DT, lambda sim: sim.change_contacts(enabled=True))
    two.run(60, DT, lambda sim: sim.change_contacts())
    three = floors(e=0.3, config=None)
    three.state.numpy("position")[1::2, 1] += 0.5
    three.run(60, DT)
    for name in ("position", "velocity"):
        bits = {sim.state.numpy(name).tobytes() for sim in (one, two, three)}
        assert len(bits) == 1
    assert not three.switches.nbytes() and "show_switched" not in three.explain() and "show_switched" in one.explain()


def test_sleepers_keep_what_is_off():
    """What rests on the ground within a one-way platform falls asleep, wakes, and is not caught by it."""
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(body, 6.0, 0.5, center=(0.0, -0.5))
    builder.add_box(body, 3.0, 0.1, center=(0.0, 0.8), one_way=(0.0, 1.0))
    mast = builder.add_body((0.0, 1.0))
    builder.add_box(mast, 0.5, 1.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(sleep=True))
    sim.run(200, DT)
    assert sim.asleep[mast]
    sim.wake()
    sim.state.numpy("velocity")[mast] = (0.0, 2.0)
    (place, _) = steps(sim, 100)
    assert place[:, mast, 1].max() == pytest.approx(1.0 + 2.0**2 / 2 / G, abs=0.02)
    assert place[-1, mast, 1] == pytest.approx(1.0, abs=2e-3)


def test_errors_name_what_is_wrong():
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body(type=dc.BodyType.STATIC)
    with pytest.raises(ValueError, match=r"one_way of shape 0 is \(0, 0\); it must be a direction"):
        builder.add_box(body, 1.0, 1.0, one_way=(0.0, 0.0))
    with pytest.raises(ValueError, match="shape 0 is to be SENSOR and ONE_WAY; it has one role"):
        builder.add_box(body, 1.0, 1.0, one_way=(0.0, 1.0), sensor=True)
    with pytest.raises(ValueError, match="shape 0 is to be ONE_WAY and ONE_SIDED; it has one role"):
        builder.add_chain(body, [(0, 0), (1, 0)], one_sided=True, one_way=(0.0, 1.0))
    with pytest.raises(TypeError, match="one_sided"):
        builder.add_box(body, 1.0, 1.0, one_sided=True)
    builder.add_box(body, 1.0, 1.0, one_way=(0.0, 1.0))
    sim = dc.Simulation(*builder.finalize())
    with pytest.raises(
        ValueError, match=r"shape_role\[0\] is 3; it must be another role than ONE_SIDED, for its shape"
    ):
        sim.change_model(shape_role=[3])
    sim = floors()
    with pytest.raises(ValueError, match=r"change_contacts\(\) out of turn"):
        sim.change_contacts(friction=0.1)
    sim.collide(DT)
    with pytest.raises(KeyError, match=r"gap is nothing that change_contacts\(\) changes"):
        sim.change_contacts(gap=0.0)
    with pytest.raises(ValueError, match=r"friction\[3\] is -1.0; it must be finite and >= 0"):
        sim.change_contacts(friction=[0, 0, 0, -1.0, 0, 0])
    with pytest.raises(ValueError, match=r"enabled has shape \(2,\); it must be \(6,\)"):
        sim.change_contacts(enabled=[True, False])
    with pytest.raises(ValueError, match=r"enabled\[0\] is nan; it must be in \[0, 1\], False or True"):
        sim.change_contacts(enabled=np.nan)
    with pytest.raises(ValueError, match=r"enabled\[0\] is 2; it must be in \[0, 1\]"):
        sim.change_contacts(enabled=2)
    with pytest.raises(ValueError, match="no shape has a surface_speed or rolling_resistance; no contact"):
        sim.change_contacts(surface_speed=1.0)
    sim.contacts.numpy("restitution")[0] = 2.0
    with pytest.raises(ValueError, match=r"restitution\[0\] is 2.0; it must be in \[0, 1\]"):
        sim.change_contacts()
    with pytest.raises(ValueError, match=r"config\.contact_switches changes in the middle of a step"):
        sim.config = dataclasses.replace(sim.config, contact_switches=False)
    plain = floors(config=None)
    plain.collide(DT)
    with pytest.raises(ValueError, match=r"SolverConfig\.contact_switches is False; no contact of this simulation"):
        plain.change_contacts(enabled=False)
    with pytest.raises(ValueError, match=r"SolverConfig\.contact_switches is False; no contact of this simulation has"):
        plain.change_contacts(surface_speed=1.0)
    pytest.importorskip("taichi")
    with pytest.raises(ValueError, match="'taichi', which has no contacts that may be off"):
        platform("box", backend="taichi")
