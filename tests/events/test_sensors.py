"""Shapes that detect overlap and carry no impulse."""

import io

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from tests.driving.scenes import scene
from tests.parity.scenes import add_ground, crowd

DT = 0.01


def pairs_of(found):
    """The pairs of a list, each with the lower index first."""
    return {(int(min(a, b)), int(max(a, b))) for a, b in zip(found.shape_a, found.shape_b)}


def gate(sensor_on=dc.BodyType.STATIC, backend="warp", angle=0.0):
    """A gate half a metre wide that a disc of a radius of 0.19 m flies through at 10 m/s, from -1 m on."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0), origin=(100.0, -50.0))
    body = builder.add_body((100.0, -50.0), angle, type=sensor_on, mass=1.0)
    builder.add_box(body, 0.25, 1.0, sensor=True)
    builder.add_discs([(99.0, -50.0)], 0.19, velocity=(10.0, 0.0))
    return dc.Simulation(*builder.finalize("float64", backend=backend))


@pytest.mark.parametrize("kind", list(dc.BodyType))
@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_flies_through_is_seen_where_it_overlaps(kind, backend):
    sim = gate(kind, backend)
    seen = []
    for _ in range(20):
        before = sim.state.numpy("position")[1, 0]  # the overlaps are those where the step begins
        sim.step(DT)
        lists = [dc.sensor_events(sim, which) for which in ("all", "begun", "ended")]
        assert len(lists[0].shape_a) == (abs(before) <= 0.25 + 0.19)
        for found in lists:
            assert found.shape_a.tolist() == [0] * len(found.slot) and found.shape_b.tolist() == [1] * len(found.slot)
        seen.append([len(found.slot) for found in lists])
    assert np.sum(seen, axis=0).tolist() == [9, 1, 1]
    assert sim.state.numpy("velocity")[1].tolist() == [10.0, 0.0] and not sim.state.numpy("velocity")[0].any()
    assert sim.only_discs and "sensors: 1 shape" in sim.explain()


def shapes(builder, body, kind, **material):
    """One shape about the body's origin, of a reach of about half a metre."""
    if kind == "disc":
        builder.add_disc(body, 0.4, **material)
    elif kind == "capsule":
        builder.add_capsule(body, (-0.4, 0.0), (0.4, 0.0), 0.1, **material)
    elif kind == "rounded":
        builder.add_box(body, 0.3, 0.2, radius=0.1, **material)
    else:
        builder.add_polygon(body, [(-0.4, -0.3), (0.5, -0.2), (0.0, 0.4)], **material)


def corners(kind):
    """Corners of the core, and its radius."""
    return {
        "disc": ([(0.0, 0.0)], 0.4),
        "capsule": ([(-0.4, 0.0), (0.4, 0.0)], 0.1),
        "rounded": ([(-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2)], 0.1),
        "sharp": ([(-0.4, -0.3), (0.5, -0.2), (0.0, 0.4)], 0.0),
    }[kind]


def placed(kind, angle, place):
    """Corners of a core that is turned and moved, counter-clockwise, and its radius."""
    core, radius = corners(kind)
    c, s = np.cos(angle), np.sin(angle)
    return np.array(core) @ np.array([[c, s], [-s, c]]) + place, radius


def depth(points, core):
    """The signed distance of the point that is deepest in a core: of a polygon negative within."""
    following = np.roll(core, -1, axis=0)
    edge = following - core
    square = np.maximum((edge**2).sum(axis=1), 1e-30)
    to = points[:, None] - core
    along = np.clip((to * edge).sum(axis=2) / square, 0, 1)
    outside = np.hypot(*np.moveaxis(to - along[..., None] * edge, -1, 0)).min(axis=1)
    within = (edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= 0).all(axis=1) & (len(core) > 2)
    return np.where(within, -outside, outside).min()


def sides(core, count=2000):
    """Points along the sides of a core."""
    t = np.linspace(0, 1, count)[:, None, None]
    return ((1 - t) * core + t * np.roll(core, -1, axis=0)).reshape(-1, 2)


@pytest.mark.parametrize("kind", ["disc", "capsule", "rounded", "sharp"])
@pytest.mark.parametrize("other", ["disc", "capsule", "rounded", "sharp"])
def test_overlap_is_that_of_the_exact_shapes(kind, other):
    """Every pair of kinds, at random angles and distances, against points along their sides; NumPy's oracle too."""
    draw = np.random.default_rng(len(kind) * 7 + len(other))
    places, angles = draw.uniform(-0.8, 0.8, (30, 2)), draw.uniform(-4, 4, (30, 2))
    found = {}
    for backend in ("warp", "numpy"):
        builder = dc.ModelBuilder()
        for place, angle in zip(places, angles):
            builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
            shapes(builder, builder.add_body(angle=angle[0], mass=1.0), kind, sensor=True)
            shapes(builder, builder.add_body(place, angle[1]), other)
        sim = dc.Simulation(*builder.finalize("float64", backend=backend))
        sim.collide(DT)
        assert not sim.contacts.numpy("contact_count").any()
        found[backend] = sim.overlaps.numpy("count").tolist()
    assert found["warp"] == found["numpy"]
    told = 0
    for w, (place, angle) in enumerate(zip(places, angles)):
        (one, radius), (two, more) = placed(kind, angle[0], (0.0, 0.0)), placed(other, angle[1], place)
        apart = min(depth(sides(one), two), depth(sides(two), one)) - radius - more
        if abs(apart) > 1e-3:  # the points are that dense
            assert found["warp"][w] == (apart < 0), (w, apart)
            told += 1
    assert told > 25 and 0 < sum(found["warp"]) < 30


def crowd_with_sensors(backend, **options):
    builder = dc.ModelBuilder()
    crowd(builder, 3)
    builder.add_disc(builder.add_body((0.0, 1.0), type=dc.BodyType.STATIC), 1.0, sensor=True)
    model, state, joints = builder.finalize("float64", backend=backend)
    role = model.numpy("shape_role").copy()
    role[::4] = dc.ShapeRole.SENSOR
    model.assign("shape_role", role)
    return dc.Simulation(model, state, joints, **options)


def test_the_oracle_agrees_in_a_crowd():
    """Lists and motion, from too little room on; what is not listed as a sensor's pair is as without events."""
    config = dc.SolverConfig(max_sweeps=10, contact_events=True, hit_speed=0.5)
    sims = [
        crowd_with_sensors(backend, config=config, pairs_per_shape=0.5, contacts_per_body=0.2)
        for backend in ("warp", "numpy")
    ]
    begun = ended = hit = 0
    for _ in range(6):
        for sim in sims:
            sim.step(DT)
        for which in ("all", "begun", "ended", "hit"):
            lists = [dc.contact_events(sim, which) for sim in sims]
            lists += [dc.sensor_events(sim, which) for sim in sims if which != "hit"]
            for one, two in zip(lists[::2], lists[1::2]):
                for name in ("shape_a", "shape_b", "world"):
                    np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        slots = [dc.contact_events(sim).slot for sim in sims]
        struck = sims[0].touches.numpy("blow")[slots[0]] > 0
        for name in ("impulse", "speed", "blow", "point", "normal"):
            one, two = (sim.touches.numpy(name)[at] for sim, at in zip(sims, slots))
            chosen = struck if name in ("point", "normal") else slice(None)
            np.testing.assert_allclose(one[chosen], two[chosen], atol=1e-8)
        np.testing.assert_allclose(*(sim.state.numpy("position") for sim in sims), atol=1e-9)
        begun += len(dc.sensor_events(sims[0], "begun").slot)
        ended += len(dc.sensor_events(sims[0], "ended").slot)
        hit += len(dc.contact_events(sims[0], "hit").slot)
    assert min(begun, ended, hit) > 3


def pile(sensors, config=None):
    """Boxes and discs that fall on a floor, of which some carry sensors, and a zone that they fall through."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(ground, 5.0, 0.5, center=(0.0, -0.5))
    if sensors:
        builder.add_box(ground, 2.0, 0.7, center=(0.1, 1.3), sensor=True)
    for i in range(8):
        body = builder.add_body((0.3 * (i % 3), 0.6 + 0.9 * i), 0.2 * i, mass=2.0 if i % 2 else None)
        if i % 3:
            builder.add_box(body, 0.4, 0.3)
        else:
            builder.add_disc(body, 0.4)
        if sensors and i % 2:
            builder.add_disc(body, 0.9, center=(0.2, 0.1), sensor=True)
    return dc.Simulation(*builder.finalize("float64"), config=config)


def test_sensors_change_no_bit_of_the_motion():
    one, two = pile(False), pile(True)
    for name in ("length_scale", "mass", "inertia", "center_of_mass"):
        assert one.model.numpy(name).tobytes() == two.model.numpy(name).tobytes(), name
    seen = 0
    for _ in range(60):
        one.step(DT)
        two.step(DT)
        seen += len(dc.sensor_events(two, "begun").slot)
    assert seen > 10
    for name in ("position", "angle", "velocity", "angular_velocity"):
        assert one.state.numpy(name).tobytes() == two.state.numpy(name).tobytes(), name
    assert not one.overlaps.nbytes() and not one.touches.nbytes() and two.overlaps.nbytes()


def rows_of_hulls(sensor):
    """Boxes, capsules and triangles, all of one pose, that fall side by side, and a zone that they fall through."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    if sensor:
        builder.add_box(ground, 2.0, 2.0, center=(0.0, 1.0), sensor=True)
    builder.add_box(ground, 40.0, 0.5, center=(0.0, -0.5))
    rng = np.random.default_rng(0)
    for i in range(150):
        body = builder.add_body((-10.0 + 0.8 * (i % 25) + 0.05 * rng.random(), 0.6 + 0.8 * (i // 25)))
        kind = rng.integers(3)
        if kind == 0:
            builder.add_box(body, 0.3, 0.25)
        elif kind == 1:
            builder.add_capsule(body, (-0.2, 0.0), (0.25, 0.0), 0.2)
        else:
            builder.add_polygon(body, [(-0.4, -0.3), (0.4, -0.3), (0.1, 0.4)], radius=0.05)
    return dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(max_sweeps=12, min_sweeps=5))


def test_hulls_beside_a_sensor_keep_their_own_corners():
    """What is kept of a pair of hulls goes with it where pairs of sensors before it are taken out."""
    one, two = rows_of_hulls(False), rows_of_hulls(True)
    for _ in range(100):
        one.step(DT)
        two.step(DT)
    assert one.state.numpy("velocity").tobytes() == two.state.numpy("velocity").tobytes()


@pytest.mark.parametrize("substeps", [1, 3])
def test_lists_are_the_differences_from_step_to_step(substeps):
    """Of all whole substeps together; a copy, a snapshot and a reset go on from them."""
    sim = pile(True, dc.SolverConfig(contact_events=True, substeps=substeps))
    calls = (dc.sensor_events, dc.contact_events)
    before = [pairs_of(call(sim)) for call in calls]
    for step in range(60):
        sim.step(1.5 * DT)
        for k, call in enumerate(calls):
            now = pairs_of(call(sim))
            assert pairs_of(call(sim, "begun")) == now - before[k]
            assert pairs_of(call(sim, "ended")) == before[k] - now
            before[k] = now
        if step == 30:
            file = io.BytesIO()
            sim.save(file)
            file.seek(0)
            others = [sim.clone(), dc.Simulation.load(file)]
            for other in others:
                for call in calls:
                    for which in ("all", "begun", "ended"):
                        assert pairs_of(call(other, which)) == pairs_of(call(sim, which))
        elif step > 30:
            for other in others:
                other.step(1.5 * DT)
                for name in ("begun", "ended"):
                    assert [pairs_of(call(other, name)) for call in calls] == [
                        pairs_of(call(sim, name)) for call in calls
                    ]
    assert min(map(len, before)) > 4
    sim.reset()
    assert not any(len(call(sim, which).slot) for call in calls for which in ("all", "begun", "ended"))
    first = pile(True, dc.SolverConfig(contact_events=True, substeps=substeps))
    for one in (sim, first):
        one.run(40, 1.5 * DT)
    assert [pairs_of(call(sim, "begun")) for call in calls] == [pairs_of(call(first, "begun")) for call in calls]


def test_what_sleeps_neither_begins_nor_ends():
    builder = dc.ModelBuilder()
    builder.add_world()
    add_ground(builder)
    zone = builder.add_body((0.0, 0.5), type=dc.BodyType.STATIC)
    builder.add_box(zone, 0.6, 0.6, sensor=True)
    box = builder.add_body((0.0, 0.5))
    builder.add_box(box, 0.5, 0.5)
    config = dc.SolverConfig(sleep=True, contact_events=True)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    sim.step(DT)
    assert len(dc.sensor_events(sim, "begun").slot) == len(dc.contact_events(sim, "begun").slot) == 1
    asleep = 0
    for _ in range(120):
        sim.step(DT)
        asleep += sim.asleep[box]
        for call in (dc.sensor_events, dc.contact_events):
            assert [len(call(sim, which).slot) for which in ("all", "begun", "ended")] == [1, 0, 0]
    assert asleep > 20
    sim.state.numpy("position")[box] = (1.5, 4.0)
    sim.run(2, DT)
    assert [len(call(sim).slot) for call in (dc.sensor_events, dc.contact_events)] == [0, 0]


def test_a_shape_becomes_a_sensor_and_solid_again():
    sim = pile(True)
    sim.run(80, DT)
    solid, role = sim.model.numpy("shape_role").copy(), np.full(sim.model.shape_count, dc.ShapeRole.SENSOR)
    role[0] = dc.ShapeRole.SOLID
    sim.change_model(shape_role=role)
    sim.run(20, DT)
    assert not sim.contacts.numpy("contact_count").any() and sim.state.numpy("velocity")[1:, 1].max() < -1.0
    sim.change_model(shape_role=solid)
    sim.run(2, DT)
    assert sim.contacts.numpy("contact_count").any()
    sim.change_model(shape_role=np.zeros_like(role))
    assert not sim.overlaps.nbytes()
    sim.run(2, DT)
    assert not len(dc.sensor_events(sim).slot)


def test_what_a_sensor_weighs():
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body()
    builder.add_disc(body, 0.5)
    builder.add_disc(body, 2.0, center=(1.0, 0.0), sensor=True)
    heavy = builder.add_body((9.0, 0.0))
    builder.add_disc(heavy, 0.5)
    builder.add_disc(heavy, 0.5, center=(1.0, 0.0), sensor=True, density=1.0)
    chain = builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, -1), (1, -1), (2, -2)], sensor=True)
    flags = builder.add_discs(np.arange(6).reshape(3, 2) * 9.0, 0.1, sensor=[True, False, True])
    model = builder.finalize("float64")[0]
    assert model.numpy("mass")[[body, heavy]] == pytest.approx([np.pi / 4, np.pi / 2])
    assert model.numpy("center_of_mass")[heavy] == pytest.approx([0.5, 0.0])
    role = model.numpy("shape_role")
    assert role[chain].all() and role[np.searchsorted(model.numpy("shape_body"), flags)].tolist() == [1, 0, 1]
    assert model.numpy("length_scale") == pytest.approx([1.0])  # the median of 1, 1 and 0.2: without the sensors


def test_taichi_says_that_it_has_none():
    pytest.importorskip("taichi")
    with pytest.raises(ValueError, match="backend is 'taichi', which has no sensors; use 'warp' or 'numpy'"):
        gate(backend="taichi")
    model, state, joints = scene("float64", "taichi")
    with pytest.raises(ValueError, match=r"'taichi', which has no contact events \(SolverConfig.contact_events\)"):
        dc.Simulation(model, state, joints, config=dc.SolverConfig(contact_events=True))


def test_errors_name_what_is_wrong():
    builder = dc.ModelBuilder()
    builder.add_world()
    body = builder.add_body(mass=1.0)
    with pytest.raises(TypeError, match="sensor of shape 0 is 1; it must be True or False"):
        builder.add_disc(body, 1.0, sensor=1)
    with pytest.raises(TypeError, match=r"sensor is \[0, 1\]; it must be True, False, or bools of shape \(2,\)"):
        builder.add_discs(np.zeros((2, 2)), 1.0, sensor=[0, 1])
    with pytest.raises(ValueError, match=r"sensor has shape \(3,\); it must be a bool or \(2,\)"):
        builder.add_discs(np.zeros((2, 2)), 1.0, sensor=[True, False, True])
    with pytest.raises(TypeError, match=r"add_discs\(\) has no argument 'role'"):
        builder.add_discs(np.zeros((2, 2)), 1.0, role=1)
    with pytest.raises(TypeError, match="role"):
        builder.add_disc(body, 1.0, role=1)
    with pytest.raises(ValueError, match=r"angular_velocity\[1\] is 2; a body of fixed_rotation has one of 0"):
        builder.add_discs(np.zeros((2, 2)), 1.0, angular_velocity=[0.0, 2.0], fixed_rotation=True)
    locked = builder.add_discs(np.zeros((2, 2)), 1.0, angular_velocity=[0.0, 2.0], fixed_rotation=[True, False])
    builder.add_disc(body, 1.0, sensor=True)
    model, state, joints = builder.finalize("float64")
    assert (model.numpy("inv_inertia")[locked] > 0).tolist() == [False, True]
    sim = dc.Simulation(model, state, joints)
    sim.step(DT)
    for name, value, what in (
        ("overlaps/a", 9, r"overlaps/a\[0\] is 9; it must be a shape of its world"),
        ("overlaps/count", 5, "overlaps/count adds up to 5; it must be 2, its pairs"),
        ("overlaps/parts", 0, r"overlaps/parts\[0\] is 0; it must be >= 1"),
    ):
        file = io.BytesIO()
        sim.save(file)
        with h5py.File(file, "r+") as opened:
            opened[name][0] = value
        file.seek(0)
        with pytest.raises(ValueError, match=f"dataset {what}"):
            dc.Simulation.load(file)
    with pytest.raises(ValueError, match="which is 'hit'; it must be one of"):
        dc.sensor_events(sim, "hit")
    with pytest.raises(ValueError, match=r"SolverConfig.contact_events is False; no step lists what touches"):
        dc.contact_events(sim)
    with pytest.raises(ValueError, match=r"shape_role\[2\] is 7; it must be one of 0 \(SOLID\), 1 \(SENSOR\)"):
        sim.change_model(shape_role=[0, 0, 7])
