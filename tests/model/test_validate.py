"""Every field with a rule is held to it, and fields to each other; what is wrong is named with its index."""

import re

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.fields import CONTACTS, JOINTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS, MODEL, PER_CONTACT, STATE
from dc_kernels.model.rules import Ascending, BrokenRule, Code, Index, Number, Start, Unit
from dc_kernels.model.shapes import edge_normals
from dc_kernels.model.validate import glance
from dc_kernels.model.validate.arrays import PART
from dc_kernels.model.validate.contacts import check_contacts
from dc_kernels.model.validate.scene import check_joints, check_model, check_scene, check_state

TABLES = {"model": MODEL, "state": STATE, "joints": JOINTS, "contacts": CONTACTS}
PENTAGON = [(np.cos(a), np.sin(a)) for a in 2 * np.pi * np.arange(5) / 5]


def add_world(builder):
    """A chain, a kinematic box, two discs with a joint, a pentagon, a damped capsule."""
    builder.add_world()
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), ((8, 5), (8, 0), (-2, 0), (-2, 5))[::-1])
    builder.add_box(builder.add_body((6, 0.49), type=dc.BodyType.KINEMATIC), 0.5, 0.5)
    discs = builder.add_discs([(0, 0.499), (0.999, 0.499)], 0.5)
    builder.add_distance_joint(discs[0], discs[1], (0, 0.1))
    builder.add_polygon(builder.add_body((3, 0.9), angle=-np.pi / 10), PENTAGON, 0.1)
    capsule = builder.add_body((6, 1.28), linear_damping=0.1)
    builder.add_capsule(capsule, (-0.3, 0), (0.3, 0), 0.3, rolling_resistance=0.1)


@pytest.fixture(scope="module")
def scene():
    """Arrays of a scene of two worlds with contacts, by group; not to be changed."""
    builder = dc.ModelBuilder()
    for _ in range(2):
        add_world(builder)
    sim = dc.Simulation(*builder.finalize(backend="numpy"), config=dc.SolverConfig(max_sweeps=20))
    for _ in range(3):
        sim.step(1 / 60)
    slots, _ = contact_slots(sim.contacts)
    found = {name: {k: a.copy() for k, a in getattr(sim, name).views().items()} for name in TABLES}
    contacts = found["contacts"]
    del contacts["contact_start"]
    contacts.update({name: a[slots] for name, a in contacts.items() if CONTACTS[name].per in PER_CONTACT})
    assert contacts["contact_count"].min() >= 5
    return found


@pytest.fixture(params=["numpy", "warp", "small"])
def backend(request, monkeypatch):
    """NumPy's checks alone, after compiled looks, which small arrays are spared otherwise, and of all small at once."""
    monkeypatch.setattr(glance, "LEAST", glance.LEAST if request.param == "small" else 1)
    return "numpy" if request.param == "small" else request.param


def check(groups, backend, **options):
    check_model(groups["model"], backend=backend)
    check_state(groups["state"], groups["model"], backend=backend, **options)
    check_joints(groups["joints"], groups["model"])
    check_contacts(groups["contacts"], groups["model"], "contacts.", backend=backend)


def copied(scene):
    return {name: {key: array.copy() for key, array in group.items()} for name, group in scene.items()}


def breaches(name, field):
    """What breaks the rule of a field: a word, and a function of the array and of the model that returns its index."""

    def put(value, index=1):
        def change(array, model):
            array[index] = value(array, model) if callable(value) else value
            return (index,) if array.ndim == 1 else (index, 0)

        return change

    def foreign(array, model):
        return model[f"{field.rule.axis}_start"][1]  # the first of the second world

    match field.rule:
        case Number(low, high, is_open):
            if field.dtype in ("real", "vec2", "vec2d", "float64"):
                yield "nan", put(np.nan)
                yield "inf", put(np.inf)
            if np.isfinite(low):
                yield "low", put(low if is_open else low - 1)
            if np.isfinite(high) and high < 2**31 - 1:
                yield "high", put(high + 1)
        case Code(values):
            yield "negative", put(-1)
            yield "unknown", put(max(values) + 1)
        case Start():
            yield "first", put(1, 0)
            yield "falls", put(lambda array, _: array[0] - 1)
            yield "last", lambda array, model: (array.__setitem__(-1, array[-1] + 1), (len(array) - 1,))[1]
        case Index():
            yield "negative", put(-1)
            yield "beyond", put(2**30)
            yield "foreign", put(foreign, 0)
        case Unit():
            yield "long", lambda array, _: (array.__setitem__(1, 2 * array[1]), (1,))[1]
            yield "zero", lambda array, _: (array.__setitem__(1, 0), (1,))[1]
            yield "nan", lambda array, _: (array.__setitem__(1, np.nan), (1,))[1]
        case Ascending():
            yield "negative", put(-1, 0)
            yield "twice", put(lambda array, _: array[0])


CASES = [
    pytest.param(group, name, change, id=f"{group}.{name}-{word}")
    for group, table in TABLES.items()
    for name, field in table.items()
    if name != "contact_start"
    for word, change in breaches(name, field)
    if (name, word) != ("joint_start", "last")  # below
]


def test_a_scene_that_was_made_here_passes(scene, backend):
    check(scene, backend)


def test_what_is_right_takes_one_look(scene, backend):
    """Compiled code sees all that it could, so that NumPy need not."""
    look, model, contacts = glance.Glance(backend, np.float32), scene["model"], scene["contacts"]
    start = np.concatenate(([0], np.cumsum(contacts["contact_count"], dtype=np.int64)))
    whole = look.bodies(model), look.shapes(model), look.contacts(contacts, model, start)
    seen = {name for group in ("model", "state", "contacts") for name in look.keeping(scene[group], TABLES[group])}
    assert whole == (backend == "warp",) * 3
    each = {
        name
        for group in ("model", "state", "contacts")
        for name, field in TABLES[group].items()
        if isinstance(field.rule, Number | Code | Unit) and field.dtype not in ("vec2d", "float64")
    } - {"contact_dt"}  # which may be 0 beside its range
    if glance.LEAST == 1:
        assert seen == (each if backend == "warp" else set())
    else:
        numbers = {name for name in each if not isinstance((MODEL | STATE | CONTACTS)[name].rule, Unit)}
        assert seen == numbers


@pytest.mark.parametrize(("group", "name", "change"), CASES)
def test_a_breach_is_named(scene, backend, group, name, change):
    groups = copied(scene)
    index = change(groups[group][name], groups["model"])
    value = groups[group][name][index]
    label = re.escape(f"{group}.{name}[{', '.join(map(str, index))}] is")
    with pytest.raises(BrokenRule, match=rf"^{label} .*; it must be ") as caught:
        check(groups, backend)
    if np.ndim(value) == 0:
        assert str(value) in str(caught.value)


def test_every_field_with_numbers_or_places_has_a_rule():
    """Masks are any bits; all else has limits."""
    free = [f"{group}.{name}" for group, table in TABLES.items() for name, field in table.items() if field.rule is None]
    assert free == ["model.shape_category", "model.shape_mask"]


def set_value(group, name, index, value):
    def change(groups):
        groups[group][name][index] = value

    return change


def vertices_of(groups, shape):
    return slice(*groups["model"]["vertex_start"][shape : shape + 2])


def give(groups, shape, vertices):
    """Other vertices, with normals, centre and extent that suit them."""
    model, at = groups["model"], vertices_of(groups, shape)
    model["vertices"][at], model["vertex_normals"][at] = vertices, edge_normals(vertices)
    model["shape_center"][shape] = vertices.mean(axis=0)
    reach = np.hypot(*(vertices - vertices.mean(axis=0)).T).max()
    model["shape_extent"][shape] = reach + model["shape_radius"][shape]


def reordered(order):
    def change(groups):
        give(groups, 6, groups["model"]["vertices"][vertices_of(groups, 6)][list(order)])

    return change


def dented(groups):
    vertices = groups["model"]["vertices"][vertices_of(groups, 6)].copy()
    vertices[2] *= 0.1
    give(groups, 6, vertices)


def flattened(groups):
    give(groups, 6, np.stack([np.array([0.0, 0.3, 0.6, 1.0, 0.5]), np.zeros(5)], axis=1).astype(np.float32))


def another_pair(groups):
    """Shape B of the last contact becomes a shape that its world does not have."""
    groups["contacts"]["key"][-1] |= (2**KEY_SHAPE_BITS - 1) << KEY_FEATURE_BITS


def one_color(groups):
    groups["contacts"]["color"][:] = 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_value("model", "shape_start", 1, 3), r"model\.shape_body\[3\] is 1; .* body of its world 1 \(bodies 6"),
        (set_value("model", "shape_body", 4, 7), r"shape_body\[4\] is 7; .* body of its world 0 \(bodies 0 \.\. 5\)"),
        (
            set_value("model", "shape_type", 6, 0),
            r"model\.vertex_start\[7\] is \d+; it must be 1 above .* shape 6 is a DISC",
        ),
        (set_value("model", "shape_type", 4, 1), r"vertex_start\[5\] is \d+; it must be 2 to 8 above .* is a POLYGON"),
        (set_value("model", "shape_radius", 4, 0), r"shape_radius\[4\] is 0\.0; it must be > 0"),
        (set_value("model", "shape_radius", 7, 0), r"shape_radius\[7\] is 0\.0; it must be > 0"),
        (set_value("model", "mass", 2, 0), r"model\.mass\[2\] is 0\.0; it must be > 0 if its body is DYNAMIC"),
        (set_value("model", "mass", 0, 1), r"model\.mass\[0\] is 1\.0; .* 0 if not"),
        (set_value("model", "inv_mass", 1, 1), r"model\.inv_mass\[1\] is 1\.0; it must be 0 if mass is"),
        (set_value("model", "inv_mass", 3, 5), r"model\.inv_mass\[3\] is 5\.0; it must be 1 / mass"),
        (
            set_value("model", "inertia", 1, 1),
            r"model\.inertia\[1\] is 1\.0; it must be 0, for its body is not DYNAMIC",
        ),
        (
            set_value("model", "inv_inertia", 3, 0),
            r"model\.inv_inertia\[3\] is 0\.0; it must be 0 if inertia is, else > 0",
        ),
        (set_value("model", "inv_inertia", 4, 9), r"model\.inv_inertia\[4\] is 9\.0; it must be 1 / inertia"),
        (
            set_value("model", "body_type", 2, 0),
            r"model\.mass\[2\] is .*; it must be > 0 if its body is DYNAMIC, 0 if not",
        ),
        (
            set_value("model", "vertex_normals", 1, (0, 1)),
            r"model\.vertex_normals\[1\] is \(0\.0, 1\.0\); .* unit normal",
        ),
        (
            set_value("model", "vertex_normals", 1, (0, 0)),
            r"model\.vertex_normals\[1\] is \(0\.0, 0\.0\); .* unit normal",
        ),
        (set_value("model", "shape_extent", 4, 9), r"model\.shape_extent\[4\] is 9\.0; .* farthest point"),
        (set_value("model", "shape_extent", 6, 0.1), r"model\.shape_extent\[6\] is 0\.1\d*; .* farthest point"),
        (set_value("model", "shape_center", 6, 9), r"model\.shape_center\[6\] is \(9\.0, 9\.0\); .* within"),
        (reordered((4, 3, 2, 1, 0)), r"model\.vertices\[\d+\] is .* a convex corner of a counter-clockwise polygon"),
        (reordered((0, 2, 4, 1, 3)), r"model\.vertices\[18\] is .* around which vertices go once"),
        (dented, r"model\.vertices\[\d+\] is .* a convex corner"),
        (flattened, r"model\.vertices\[18\] is .* around which vertices go once"),
        (set_value("joints", "joint_body_b", 0, 2), r"joints\.joint_body_b\[0\] is 2; .* another body than body A"),
        (set_value("joints", "joint_body_b", slice(0, 1), 1), None),
        (
            lambda g: g["joints"].update(joint_body_a=np.array([0, 8], "i4"), joint_body_b=np.array([1, 9], "i4")),
            "DYNAMIC",
        ),
        (lambda g: g["joints"].update(joint_body_a=g["joints"]["joint_body_a"][:1]), r"joints has 1; .* model's 2"),
        (set_value("model", "joint_start", -1, 3), r"joints has 2; it must be the model's 3"),
        (another_pair, r"contacts\.key\[\d+\] is \d+; it must be of shapes of its world; shape B is not"),
        (
            set_value("contacts", "body_a", 0, 5),
            r"contacts\.body_a\[0\] is 5; .* the body of shape A in the contact's key",
        ),
        (set_value("contacts", "contact_count", 0, 1), r"contacts\.contact_count adds up to \d+; it must be \d+"),
        (
            one_color,
            r"contacts\.color\[\d+\] is 0; it must be another than that of contact \d+, which acts on body \d+",
        ),
    ],
)
def test_fields_are_held_to_each_other(scene, backend, change, message):
    groups = copied(scene)
    change(groups)
    if message is None:  # a change that is as good
        check(groups, backend)
        return
    with pytest.raises(BrokenRule, match=message):
        check(groups, backend)


def test_kept_colours_and_the_serial_one_may_come_twice(scene, backend):
    groups = copied(scene)
    for color in (-1, 63):
        one_color(groups)
        groups["contacts"]["color"][:] = color
        check(groups, backend)


def test_numbers_of_a_frozen_world_pass_only_when_asked(scene, backend):
    groups = copied(scene)
    groups["state"]["force"][1] = np.nan
    with pytest.raises(BrokenRule, match=r"state\.force\[1, 0\] is nan"):
        check(groups, backend, frozen=True)
    groups["state"]["flags"][0] = dc.Flag.NONFINITE
    check(groups, backend, frozen=True)
    with pytest.raises(BrokenRule, match=r"state\.force\[1, 0\] is nan"):
        check(groups, backend)
    groups["contacts"]["impulse"][0] = np.inf
    check_contacts(groups["contacts"], groups["model"], flags=groups["state"]["flags"], backend=backend)
    groups["contacts"]["impulse"][-1] = np.inf  # of the other world
    with pytest.raises(BrokenRule, match=r"impulse\[\d+, 0\] is inf"):
        check_contacts(groups["contacts"], groups["model"], flags=groups["state"]["flags"], backend=backend)


@pytest.mark.parametrize("group", ["model", "state", "joints"])
def test_what_changed_since_it_was_made_is_checked_again(group):
    """A simulation compares what its builder has checked, and checks what is no longer the same."""
    builder = dc.ModelBuilder()
    add_world(builder)
    made = dict(zip(("model", "state", "joints"), builder.finalize(backend="numpy"), strict=True))
    name = {"model": "mass", "state": "angle", "joints": "joint_length"}[group]
    made[group].memory(name)[0] = np.nan
    with pytest.raises(ValueError, match=rf"{group}\.{name}\[0\] is nan"):
        dc.Simulation(*made.values())
    made[group].memory(name)[0] = 1.0 if group == "joints" else 0.0
    dc.Simulation(*made.values())


def test_far_from_the_centre_of_mass_rounding_is_no_breach():
    """A float32 box of 1 mm, 1 km from the centre of its body, has edges of a few roundings."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    for x in (-1000.0, 1000.0):
        builder.add_box(ground, 5e-4, 5e-4, (x, 0.3))
    model, state, joints = builder.finalize(backend="numpy")
    check_scene(model, state, joints)
    for simulation in (dc.Simulation, lambda given: dc.Simulation(given, state)):
        with pytest.raises(TypeError, match=r"model is a ModelBuilder; give .*: \*builder\.finalize\(\)"):
            simulation(builder)
    with pytest.raises(TypeError, match="state is a NoneType; it must be a State"):
        dc.Simulation(model)


@pytest.mark.parametrize("backend", ["numpy", "warp"])
@pytest.mark.parametrize("count", [PART, PART + 1, 2 * PART + 3])
def test_parts_meet(count, backend):
    """Where one part of an array ends and the next begins nothing is missed."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs(np.stack([3.0 * np.arange(count + 1), np.zeros(count + 1)], axis=1), 1.0)
    model = {name: array.copy() for name, array in builder.finalize(backend="numpy")[0].views().items()}
    first = np.arange(count, dtype=np.int64)
    key = (first << (KEY_SHAPE_BITS + KEY_FEATURE_BITS)) | ((first + 1) << KEY_FEATURE_BITS)
    contacts = {"contact_count": np.array([count]), "key": key, "color": (first % 2).astype(np.int32)}
    check_model(model, backend=backend)
    check_contacts(contacts, model, backend=backend)
    for i in {PART - 1, PART, count - 1} & set(range(1, count)):
        wrong = {**contacts, "color": contacts["color"].copy()}
        wrong["color"][i] = contacts["color"][i - 1]
        with pytest.raises(
            BrokenRule, match=rf"color\[{i}\] is {1 - i % 2}; .* contact {i - 1}, which acts on body {i}"
        ):
            check_contacts(wrong, model, backend=backend)
        wrong = {**contacts, "key": key.copy()}
        wrong["key"][i] = key[i - 1]
        with pytest.raises(BrokenRule, match=rf"key\[{i}\] is {key[i - 1]}; .* larger than the one before"):
            check_contacts(wrong, model, backend=backend)
        for name, value in (
            ("inv_mass", 7.0),
            ("shape_radius", -1.0),
            ("shape_extent", 5.0),
            ("shape_body", count + 1),
        ):
            kept = model[name][i].copy()
            model[name][i] = value
            with pytest.raises(BrokenRule, match=rf"model\.{name}\[{i}\] is"):
                check_model(model, backend=backend)
            model[name][i] = kept


def rows_of_shapes():
    """A model of boxes, segments, pentagons and discs in rows: compiled code looks at four that are alike at once."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(k, 0.1 * (k % 2)) for k in range(7)])
    for k in range(6):
        builder.add_box(ground, 0.5, 0.3, center=(k, 2.0), angle=0.1 * k)
    for k in range(5):
        builder.add_polygon(ground, [(x + k, y + 5.0) for x, y in PENTAGON])
    builder.add_disc(ground, 0.5)
    builder.add_capsule(ground, (0.0, 0.0), (1.0, 0.0), 0.2)
    return builder.finalize(backend="numpy")[0].views()


def test_every_vertex_and_normal_is_finite_and_fits_its_shape(backend):
    model = {name: values.copy() for name, values in rows_of_shapes().items()}
    check_model(model, backend=backend)
    assert glance.Glance(backend, np.float32).shapes(model) == (backend == "warp")
    for name in ("vertices", "vertex_normals"):
        for i in range(len(model[name])):
            for number in (np.nan, np.inf):
                kept = model[name][i, 1]
                model[name][i, 1] = number
                with pytest.raises(BrokenRule, match=rf"model\.{name}\[{i}, 1\] is {number}; it must be finite"):
                    check_model(model, backend=backend)
                model[name][i, 1] = kept
    start, held = model["vertex_start"], np.flatnonzero(model["shape_type"] != dc.ShapeType.DISC)
    for shape in held:
        for name, k, off in (("vertices", 0, 0.05), ("vertex_normals", 1, 0.1), ("shape_extent", 0, 0.05)):
            i = start[shape] + k if name != "shape_extent" else shape
            kept = model[name][i].copy()
            model[name][i] += off
            with pytest.raises(BrokenRule):
                check_model(model, backend=backend)
            model[name][i] = kept
