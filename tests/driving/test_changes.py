"""What is written takes effect or raises: fields of model, joints and state while a simulation uses them."""

import io
import pickle

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.driving.changes import turned_keys
from dc_kernels.model.fields import CACHE, JOINTS, MODEL, PER_CONTACT, STATE
from tests.driving.scenes import DT, bits, of_worlds, simulation

RUN = 40


def fresh(sim):
    """A simulation that is built of the present model and state, with the same contacts to start from."""
    made = dc.Simulation(
        sim.model.copy(), sim.state.copy(), sim.joints.copy(), config=sim.config, specialize=sim.specialize
    )
    used = [
        np.arange(a, a + n) for a, n in zip(sim.contacts.numpy("contact_start"), sim.cache.numpy("count"), strict=False)
    ]
    names = [name for name, field in CACHE.items() if field.per in PER_CONTACT and sim.cache.sizes[field.per]]
    arrays = {name: sim.cache.numpy(name)[np.concatenate(used)] for name in names}
    made.restore_contacts(sim.cache.numpy("count"), arrays, sim.contacts.numpy("contact_dt"))
    return made


def new_values(sim, name):
    """Other values of a field that go together with the rest, and what has to be given with them."""
    group = sim.model if name in MODEL else sim.joints if name in JOINTS else sim.state
    values = group.numpy(name).copy()
    match name:
        case "body_type":
            body = 3  # a disc of the first world, with contacts
            values[body] = dc.BodyType.STATIC
        case "mass" | "inertia":
            values *= 2
        case "inv_mass" | "inv_inertia":
            values /= 2
        case "shape_mask" | "shape_category":
            values[1:8] = 0
        case "shape_role":
            values[1:8] = dc.ShapeRole.SENSOR
        case "shape_one_way":
            values[1:8] += 1.0
            role = np.zeros(len(values), np.int32)
            role[1:8] = dc.ShapeRole.ONE_WAY
            return {name: values, "shape_role": role}
        case "length_scale":
            values *= 20
        case "shape_radius":
            values *= 1.1
        case "vertices":
            values[-9:] += 0.03
            boxes = sim.model.numpy("vertex_start")[np.flatnonzero(sim.model.numpy("shape_type") == 1)[0]]
            values[boxes : boxes + 4] *= 1.2
        case "joint_body_a":
            values[:] = 5
        case "joint_body_b":
            values[:] = 7
        case "joint_impulse":
            values[:] += 0.05
        case "joint_axis":
            values[:] = (0.0, 1.0)
        case "joint_broken" | "joint_collides":
            values = 1 - values
        case "joint_break_force":
            values[:] = 50.0
        case "origin" | "time":
            values += 1000.0
        case "flags":
            values[:] = dc.Flag.NONFINITE
        case _:
            values = values * 0.7 + 0.05
    return {name: values}


REFUSED = {name for name in {**MODEL, **JOINTS} if name not in (*dc.Model.changeable, *dc.Joints.changeable)}


@pytest.mark.parametrize("name", [*dc.Model.changeable, *dc.Joints.changeable])
def test_a_change_acts_as_in_a_simulation_that_is_built_with_it(name):
    sim = simulation("float64", traits=True) if name in dc.Model.traits else simulation()
    sim.run(RUN, DT)
    plain = sim.clone()
    values = new_values(sim, name)
    sim.change_model(**values)
    for field, array in values.items():
        group = sim.model if field in MODEL else sim.joints
        assert np.array_equal(group.numpy(field), array)
    anew = fresh(sim)
    assert (anew.variant, anew.only_discs) == (sim.variant, sim.only_discs)
    rebuilds = sim.pairs.numpy("rebuilds").copy()
    for one in (sim, anew, plain):
        one.run(1, DT)
    rebuilt = sim.pairs.numpy("rebuilds") > rebuilds
    for one in (sim, anew, plain):
        one.run(2, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(anew, [0, 1])
    if name == "origin":
        return  # where the world lies changes nothing in it
    if name == "cell_size":
        assert rebuilt.all()  # which moving bodies alone do not ask for in both worlds at once
    else:
        assert of_worlds(sim, [0, 1]) != of_worlds(plain, [0, 1])


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_other_fields_of_a_model_in_use_are_refused(name):
    sim = simulation("float64", "numpy")
    group, kind = (sim.model, "model") if name in MODEL else (sim.joints, "joints")
    with pytest.raises(KeyError, match=rf"{name} cannot be changed in a simulation; make a new one. It may be one of "):
        sim.change_model(**{name: group.numpy(name)})
    with pytest.raises(ValueError, match=f"{name} is in use by a simulation"):
        group.assign(name, group.numpy(name))
    with pytest.raises(ValueError, match=rf"read-only: {name} is in use by a simulation, .* {kind}.copy\(\)"):
        group.numpy(name)[...] = 0
    with pytest.raises(AttributeError, match="cannot be replaced"):
        setattr(group, name, 0)


@pytest.mark.parametrize("name", sorted({*MODEL, *JOINTS} - REFUSED))
def test_what_is_assigned_acts_or_names_the_way(name):
    sim = simulation("float64", "numpy")
    group = sim.model if name in MODEL else sim.joints
    if name == "joint_impulse":
        sim.collide(DT)  # as the start of a solve only
    if group.writable(name):
        group.assign(name, group.numpy(name))
        return
    with pytest.raises(ValueError, match=rf"sim\.change_model\({name}=values\) changes it there"):
        group.assign(name, group.numpy(name))
    with pytest.raises(ValueError, match=rf"read-only: {name} .* sim\.change_model\({name}=values\) changes it"):
        group.numpy(name)[...] = 0


def test_fields_that_are_shown_are_plain_arrays_but_for_writing():
    """Who writes in place is told how to change the field; what is computed, picked or copied may be written."""
    sim = simulation("float64", "numpy")
    mass = sim.model.numpy("mass")
    for write in (
        lambda: mass.__iadd__(1.0),
        lambda: mass[1:].__imul__(2.0),
        lambda: mass.fill(0.0),
        lambda: mass[2:].sort(),
        lambda: sim.model.worlds("mass")[0].put(0, 1.0),
    ):
        with pytest.raises(ValueError, match=r"read-only: mass .* sim\.change_model\(mass=values\)"):
            write()
    picked, copied = mass[[1, 2]], mass.copy()
    picked += 1.0
    picked[0] = copied[0] = 5.0
    back = pickle.loads(pickle.dumps(mass))
    for plain in (2.0 * mass, mass > 0.0, copied, back, copied + mass):
        assert type(plain) is np.ndarray and plain.flags.writeable
    assert type(mass.sum()) is np.float64 and repr(mass).startswith("array([")
    np.testing.assert_array_equal(back, mass)


@pytest.mark.parametrize("name", [*STATE, *dc.Model.live, "joint_anchor_a", "joint_anchor_b", "joint_length"])
def test_what_may_be_assigned_acts_at_the_next_step(name):
    """All of a state; of the model and its joints what a step reads anew (a weight stays)."""
    sim = simulation(config=dc.SolverConfig(relative_tolerance=float("inf"), max_sweeps=60))
    sim.run(RUN, DT)
    plain = sim.clone()
    group = next(g for g in (sim.state, sim.model, sim.joints) if name in g.table)
    group.assign(name, new_values(sim, name)[name])
    if name == "flags":
        sim.run(1, DT)
        assert np.array_equal(sim.state.numpy("time"), plain.state.numpy("time"))
        return
    anew = fresh(sim)
    for one in (sim, anew, plain):
        one.run(3, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(anew, [0, 1])
    assert name == "origin" or of_worlds(sim, [0, 1]) != of_worlds(plain, [0, 1])


def test_a_limit_beyond_the_other_is_refused_as_what_no_snapshot_would_bring_back():
    builder = dc.ModelBuilder()
    builder.add_world()
    wall, arm, weight = builder.add_body(type=dc.BodyType.STATIC), *builder.add_discs([(1.0, 0.0), (2.0, 0.0)], 0.2)
    builder.add_revolute_joint(wall, arm, lower=-0.5, upper=0.5)
    builder.add_distance_joint(arm, weight)
    builder.add_revolute_joint(wall, weight)  # without limits, so that its fields of them mean nothing
    sim = dc.Simulation(*builder.finalize("float64", backend="numpy"))
    before = sim.joints.numpy("joint_lower").copy()
    with pytest.raises(ValueError, match=r"joint_lower\[0\] is 1.0; it must be at most joint_upper"):
        sim.joints.assign("joint_lower", [1.0, 0.0, 0.0])
    with pytest.raises(
        ValueError, match=r"joint_length\[1\] is 0.0; it must be finite and > 0, for the joint is rigid"
    ):
        sim.joints.assign("joint_length", [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(sim.joints.numpy("joint_lower"), before)
    assert sim.joints.numpy("joint_length")[1] == 1.0
    sim.joints.assign("joint_upper", [2.0, 0.0, 0.0])
    sim.joints.assign("joint_lower", [1.0, 1.0, 1.0])
    assert sim.clone().joints.numpy("joint_lower")[0] == 1.0
    sim.change_model(joint_lower=[-2.0, 0.0, 0.0], joint_upper=[-1.0, 1.0, 1.0])  # both beyond each other
    assert sim.clone().joints.numpy("joint_upper")[0] == -1.0


def test_coefficients_may_differ_from_now_on_and_be_alike_again():
    sim = simulation()
    sim.run(RUN, DT)
    for friction in (np.linspace(0.1, 0.9, sim.model.shape_count), 0.2):
        sim.change_model(shape_friction=friction)
        anew = fresh(sim)
        for one in (sim, anew):
            one.run(3, DT)
        assert of_worlds(sim, [0, 1]) == of_worlds(anew, [0, 1])
        found = sim.contacts.numpy("friction")[dc.contact_slots(sim.contacts)[0]]
        assert (len(set(found)) > 1) == (np.ndim(friction) > 0)


def test_what_was_written_to_the_memory_is_taken_up():
    sim, other = simulation(), simulation()
    for one in (sim, other):
        one.run(RUN, DT)
    dc.to_numpy(sim.model.shape_friction)[:] = 0.01
    dc.to_numpy(sim.model.shape_mask)[-1] = 0
    sim.change_model()
    mask = other.model.numpy("shape_mask").copy()
    mask[-1] = 0
    other.change_model(shape_friction=0.01, shape_mask=mask)
    for one in (sim, other):
        one.run(3, DT)
    slots, _ = dc.contact_slots(sim.contacts)
    assert (sim.contacts.numpy("friction")[slots] == np.float32(0.01)).all()
    for name in ("position", "velocity"):
        np.testing.assert_allclose(sim.state.numpy(name), other.state.numpy(name), atol=1e-3)
    dc.to_numpy(sim.model.inv_mass)[3] = 7
    with pytest.raises(ValueError, match=r"model\.inv_mass\[3\] is 7\.0; it must be 1 / mass"):
        sim.change_model()


@pytest.mark.parametrize("first", [True, False])
def test_contacts_keep_their_impulses_when_a_body_is_frozen_or_released(first):
    """Shape A of a contact is static, or has the lower index: its key turns, also that of its vertices."""
    builder = dc.ModelBuilder()
    builder.add_world()
    floor = builder.add_body() if first else None
    box = builder.add_body((0.0, 0.5))
    builder.add_box(box, 0.5, 0.5)
    floor = builder.add_body() if floor is None else floor
    builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
    model, state, joints = builder.finalize()
    saved = {name: model.numpy(name).copy() for name in ("body_type", "mass", "inertia")}
    types = saved["body_type"].copy()
    types[floor] = dc.BodyType.STATIC
    sim = dc.Simulation(model, state, joints)
    sim.change_model(body_type=types)
    assert not sim.model.numpy("mass")[floor] and not sim.model.numpy("inv_inertia")[floor]
    sim.run(30, DT)
    held = sim.contacts.numpy("impulse")[:2].copy()
    assert held[:, 0].sum() == pytest.approx(9.81 * DT, rel=1e-2)
    sim.change_model(**saved)
    assert np.array_equal(sim.model.numpy("inv_mass"), model.numpy("inv_mass"))
    sim.state.assign("force", [[0, 0], [0, 0]])
    sim.collide(DT)
    count = int(sim.contacts.numpy("contact_count")[0])
    assert count == 2 and (sim.contacts.numpy("age")[:2] > 0).all()
    assert np.allclose(np.sort(sim.contacts.numpy("impulse")[:2, 0]), np.sort(held[:, 0]))
    sim.solve()
    sim.advance()
    sim.change_model(body_type=types)  # frozen anew: what falls comes to rest
    assert not sim.state.numpy("velocity")[floor].any()
    sim.run(2, DT)
    assert (sim.contacts.numpy("age")[:2] > 0).all()


def test_keys_turn_and_turn_back():
    sim = simulation()
    sim.run(RUN, DT)
    slots, world = dc.contact_slots(sim.contacts)
    keys = sim.contacts.numpy("key")[slots]
    assert np.array_equal(turned_keys(keys, world, sim.model), keys)


def test_a_released_body_keeps_the_momentum():
    """Contacts at a body that was static may all have one colour: kept, they would be solved at once, wrongly."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, 0))
    center = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_disc(center, 0.5)
    angle = 2 * np.pi * np.arange(5) / 5
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = builder.add_discs(around, radius=0.5)
    sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(tolerance=1e-9, relative_tolerance=1e-9))
    sim.state.numpy("force")[ring] = -10 * around
    sim.run(20, DT)
    assert (sim.contacts.numpy("color")[:5] == 0).all()
    types, mass, inertia = (sim.model.numpy(name).copy() for name in ("body_type", "mass", "inertia"))
    types[center], mass[center], inertia[center] = dc.BodyType.DYNAMIC, mass[ring[0]], inertia[ring[0]]
    with pytest.raises(ValueError, match="mass is missing; body 0 becomes DYNAMIC and needs one"):
        sim.change_model(body_type=types)
    sim.change_model(body_type=types, mass=mass, inertia=inertia)
    sim.state.numpy("force")[ring[0]] = 0
    sim.step(DT)
    assert len(set(sim.contacts.numpy("color")[:5])) == 5
    momentum = (mass[:, None] * sim.state.numpy("velocity")).sum(axis=0)
    np.testing.assert_allclose(momentum, sim.state.numpy("force").sum(axis=0) * DT, atol=1e-6)


def test_a_world_of_which_nothing_changes_keeps_its_bits():
    sim = simulation()
    sim.run(RUN, DT)
    plain = sim.clone()
    radius, friction = (sim.model.numpy(name).copy() for name in ("shape_radius", "shape_friction"))
    last = sim.model.numpy("shape_start")[1]
    radius[last:] *= 0.9
    friction[last:] = 0.0
    types = sim.model.numpy("body_type").copy()
    types[-1] = dc.BodyType.STATIC
    sim.change_model(shape_radius=radius, shape_friction=friction, body_type=types)
    for one in (sim, plain):
        one.run(5, DT)
    assert of_worlds(sim, [0]) == of_worlds(plain, [0])
    assert of_worlds(sim, [1]) != of_worlds(plain, [1])


@pytest.mark.parametrize("name", ["body_type", "joint_body_a", "shape_friction", "mass"])
@pytest.mark.parametrize("way", ["clone", "file"])
def test_what_was_changed_is_copied_and_saved(name, way):
    sim = simulation()
    sim.run(RUN, DT)
    sim.change_model(**new_values(sim, name))
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    other = sim.clone() if way == "clone" else dc.Simulation.load(file)
    for one in (sim, other):
        one.run(3, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(other, [0, 1])
    sim.reset()
    other = dc.Simulation(sim.model.copy(), sim.state.copy(), sim.joints.copy(), config=sim.config)
    for one in (sim, other):
        one.run(3, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(other, [0, 1])


def test_a_run_may_be_changed_and_reset_by_its_callback():
    def callback(sim):
        if sim.state.numpy("time")[0] > 0.15:
            sim.change_model(shape_friction=float(rng.uniform(0.1, 0.9)))
            sim.reset([0])

    found = []
    for threads in (1, 2):
        rng = np.random.default_rng(1)
        sim = simulation(threads=threads)
        sim.run(40, DT, callback=callback)
        found.append(of_worlds(sim, [0, 1]))
    assert found[0] == found[1]


def test_simulations_that_share_a_model_all_go_by_it():
    model, state, joints = simulation().model.copy(), None, None
    first = simulation()
    state, joints = first.state.copy(), first.joints
    second = dc.Simulation(first.model, state, joints, config=first.config)
    for one in (first, second):
        one.run(RUN, DT)
    first.change_model(shape_friction=0.05)
    assert model is not first.model
    for one in (first, second):
        one.run(1, DT)
        assert (one.contacts.numpy("friction")[dc.contact_slots(one.contacts)[0]] == np.float32(0.05)).all()
    first.collide(DT)
    with pytest.raises(ValueError, match=r"change_model\(\) in the middle of a step"):
        second.change_model(shape_friction=0.2)


def test_kernels_for_discs_give_way_to_others_and_come_back():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5, center=(0.0, -0.5))
    builder.add_discs([(0.0, 0.5), (1.0, 0.5)], 0.5)
    box = builder.add_body((3.0, 0.4), type=dc.BodyType.STATIC)
    builder.add_box(box, 0.4, 0.4)
    sim = dc.Simulation(*builder.finalize())
    sim.run(5, DT)
    version = sim.layout_version
    assert sim.variant == "discs"
    types, mass, inertia = (sim.model.numpy(name).copy() for name in ("body_type", "mass", "inertia"))
    types[box], mass[box], inertia[box] = dc.BodyType.DYNAMIC, 0.64, 0.07
    sim.change_model(body_type=types, mass=mass, inertia=inertia)
    assert sim.variant == "general" and sim.layout_version > version
    anew = fresh(sim)
    for one in (sim, anew):
        one.run(20, DT)
    assert of_worlds(sim, [0]) == of_worlds(anew, [0])
    types[box] = dc.BodyType.STATIC
    sim.change_model(body_type=types)
    assert sim.variant == "discs"
    anew = fresh(sim)
    for one in (sim, anew):
        one.run(5, DT)
    assert of_worlds(sim, [0]) == of_worlds(anew, [0])
    assert not sim.state.numpy("flags").any()


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"shape_friction": -1.0}, ValueError, r"model\.shape_friction\[0\] is -1\.0; it must be finite and >= 0"),
        ({"shape_restitution": 1.5}, ValueError, r"model\.shape_restitution\[0\] is 1\.5"),
        ({"shape_friction": np.zeros(3)}, ValueError, r"shape_friction has shape \(3,\); it must be \(\d+,\)"),
        ({"shape_mask": 0.5}, ValueError, "shape_mask"),
        ({"mass": 0.0}, ValueError, r"model\.mass\[1\] is 0\.0; it must be > 0 if its body is DYNAMIC"),
        ({"body_type": 7}, ValueError, r"model\.body_type\[0\] is 7; it must be one of 0 \(STATIC\)"),
        ({"joint_body_a": 2}, ValueError, r"joints\.joint_body_b\[0\] is 2; it must be another body than body A"),
        ({"joint_length": 0.0}, ValueError, r"joints\.joint_length\[0\] is 0\.0; it must be finite and > 0"),
        ({"shape_radius": 0.0}, ValueError, r"model\.shape_radius\[\d+\] is 0\.0; it must be > 0"),
        ({"friction": 0.0}, KeyError, r"friction is no field .* \(did you mean shape_friction\?\)\. It may be one of "),
        ({"masss": 1.0}, KeyError, r"\(did you mean mass or inv_mass\?\)"),
        (
            {"velocity": 1.0},
            KeyError,
            r"velocity is no field .* but of the state, .*: sim\.state\.assign\(\"velocity\"",
        ),
        ({"gravity": 0.0}, ValueError, r"gravity has shape \(\); it must be \(2, 2\)"),
        ({"shape_friction": "smooth"}, TypeError, "shape_friction is 'smooth'"),
    ],
)
def test_an_error_leaves_all_as_it_was(values, error, message):
    sim = simulation()
    sim.run(5, DT)
    before = bits(sim)
    with pytest.raises(error, match=message):
        sim.change_model(**{"shape_friction": 0.3, **values})
    assert bits(sim) == before


def test_images_follow_the_shapes():
    pytest.importorskip("torch")
    sim = simulation()
    spec = dc.ImageSpec(grid=dc.Grid(rows=30, columns=30, spacing=0.1, origin=(-1.5, -0.5)), area=True)
    images = dc.Images(sim, spec)
    images.splat()
    sim.change_model(shape_radius=sim.model.numpy("shape_radius") * 0.5)
    images.splat()
    anew = dc.Images(sim, spec)
    anew.splat()
    assert np.array_equal(images.numpy(), anew.numpy())


def test_reset_leaves_a_body_at_rest_that_has_become_static():
    sim = simulation()
    sim.built.numpy("velocity")[3] = (1.0, 0.0)
    types = sim.model.numpy("body_type").copy()
    types[3] = dc.BodyType.STATIC
    sim.change_model(body_type=types)
    sim.run(3, DT)
    sim.reset([0])
    assert not sim.state.numpy("velocity")[3].any()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("state", r"sim\.state is that of this simulation, .*; sim\.state\.assign.* and sim\.reset\(None, state\) all"),
        ("model", r"sim\.model is that of this simulation, .* sim\.change_model\(NAME=values\)"),
        ("contacts", r"sim\.contacts is that of .* written by the steps, and by restore_contacts"),
        ("threads", r"sim\.threads is .*; make another one: dc\.Simulation\(\.\.\., threads=\.\.\.\)"),
        ("dtype", r"sim\.dtype is .*; make another one of ModelBuilder\.finalize\(dtype=\.\.\.\)"),
        ("gravity", r"sim\.gravity is a field of the model; sim\.change_model\(gravity=values\) changes it"),
        ("joint_length", r"sim\.joint_length is a field of the joints; sim\.change_model"),
        ("velocity", r'sim\.velocity is a field of the state; sim\.state\.assign\("velocity", values\)'),
    ],
)
def test_parts_and_fields_are_no_attributes_to_set(name, message):
    sim = simulation("float64", "numpy")
    with pytest.raises(AttributeError, match=message):
        setattr(sim, name, 3)
    with pytest.raises(AttributeError, match="state has no velocities; it has position, angle, velocity, "):
        sim.state.velocities = 3
    with pytest.raises(TypeError, match=r"takes no dtype: ModelBuilder\.finalize\(dtype=\.\.\.\) does"):
        dc.Simulation(sim.model, dtype="float64")
    sim.note = "what a caller keeps"
    sim.note = "goes by any other name"
