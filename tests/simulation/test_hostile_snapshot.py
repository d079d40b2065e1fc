"""A snapshot that was tampered with is refused by the name of the dataset, or loads as what it says."""

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.fields import CONTACTS, JOINTS, MODEL, PER_CONTACT, STATE

TABLES = {"model": MODEL, "state": STATE, "joints": JOINTS, "contacts": CONTACTS}
DATASETS = [f"{group}/{name}" for group, table in TABLES.items() for name in table]
DT = 0.01


def simulation():
    """Two worlds of the oracle, whose kernels need no compiler: a chain, a joint, discs, a box."""
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), ((-2, 2), (-2, 0), (2, 0), (2, 2)))
        discs = builder.add_discs([(-0.3, 0.099), (0.0, 0.099), (0.199, 0.099)], 0.1, rolling_resistance=0.1)
        builder.add_distance_joint(discs[0], discs[1])
        builder.add_box(builder.add_body((1.0, 0.0999), linear_damping=0.1), 0.1, 0.1, surface_speed=0.1)
    return dc.Simulation(*builder.finalize(backend="numpy"), config=dc.SolverConfig(max_sweeps=5))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A snapshot with contacts in both worlds, not to be changed."""
    sim = simulation()
    sim.run(2, DT)
    assert sim.contacts.numpy("contact_count").min() >= 3
    path = tmp_path_factory.mktemp("hostile") / "saved.h5"
    sim.save(path)
    return path


@pytest.fixture(scope="module")
def stored(saved):
    """The arrays of the snapshot by their names, not to be changed."""
    with h5py.File(saved) as file:
        return {name: file[name][()] for name in DATASETS}


def loaded_arrays(sim):
    slots, _ = contact_slots(sim.contacts)
    return {
        f"{group}/{name}": getattr(sim, group).numpy(name)[slots if field.per in PER_CONTACT else ...]
        for group, table in TABLES.items()
        for name, field in table.items()
    }


def another_dtype(values):
    return values.astype(np.int16 if values.dtype.kind == "f" else np.float64)


def with_value(value):
    """Put a value at two places of the array; None where the dtype has no such value."""

    def change(values):
        if values.dtype.kind != "f" and not np.isfinite(value):
            return None
        limits = np.iinfo(values.dtype) if values.dtype.kind in "iu" else np.finfo(values.dtype)
        changed = values.copy()
        changed.reshape(-1)[[0, -1]] = np.clip(value, limits.min, limits.max) if np.isfinite(value) else value
        return changed

    return change


SHAPES = {
    "dtype": another_dtype,
    "longer": lambda values: np.concatenate([values, values[:1]]),
    "deeper": lambda values: values[:, None],
    "scalar": lambda values: values.reshape(-1)[0],
}
VALUES = {"nan": with_value(np.nan), "huge": with_value(2.0**62), "negative": with_value(-3.0)}
OTHERS = {"zero": np.zeros_like, "turned": lambda values: values[::-1]}


@pytest.mark.parametrize("name", DATASETS)
def test_a_dataset_that_was_tampered_with(saved, stored, tmp_path, name):
    turn = DATASETS.index(name)  # of some changes each takes its turn
    changes = dict(list(table.items())[turn % len(table)] for table in (SHAPES, OTHERS))
    for word, change in {**changes, **VALUES}.items():
        values = change(stored[name])
        if values is None:
            continue
        path = tmp_path / f"{word}.h5"
        path.write_bytes(saved.read_bytes())
        with h5py.File(path, "r+") as file:
            del file[name]
            file[name] = values
        try:
            sim = dc.Simulation.load(path)
        except ValueError as error:
            # what breaks no rule by itself may break one of another array
            limit = name if word in ("nan", *SHAPES) else ""
            assert f"{path}: dataset {limit}" in str(error), (word, error)
            continue
        assert word not in ("nan", *SHAPES)
        found = loaded_arrays(sim)
        for other, want in {**stored, name: values}.items():
            if other != "contacts/contact_start":  # the simulation reserves its slots itself
                assert found[other].tobytes() == want.tobytes(), (word, other)
        sim.step(DT)


def removed(file, name):
    del file[name]


def made_a_group(file, name):
    del file[name]
    file.create_group(name)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *((name, removed) for name in (*DATASETS, *TABLES)),
        *((name, made_a_group) for name in (*DATASETS[::9], *TABLES)),
    ],
)
def test_a_dataset_that_is_not_there(saved, tmp_path, name, change):
    path = tmp_path / "copy.h5"
    path.write_bytes(saved.read_bytes())
    with h5py.File(path, "r+") as file:
        change(file, name)
    with pytest.raises(ValueError, match=rf"{path}: dataset {name}"):
        dc.Simulation.load(path)


def test_what_else_is_in_the_file_changes_nothing(saved, tmp_path):
    path = tmp_path / "copy.h5"
    path.write_bytes(saved.read_bytes())
    before = loaded_arrays(dc.Simulation.load(path))
    with h5py.File(path, "r+") as file:
        for group in TABLES:
            file[f"{group}/extra"] = np.full(3, np.nan)
        file["notes"] = "settled for an hour"
    after = loaded_arrays(dc.Simulation.load(path))
    assert all(before[name].tobytes() == after[name].tobytes() for name in DATASETS)


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        *(
            ("sizes", axis, size)
            for axis in ("world", "body", "shape", "vertex", "joint", "contact")
            for size in (-1, 0)
        ),
        ("sizes", "body", 2**40),
        ("config", "position_iterations", 2**31),
        ("config", "max_sweeps", -1),
        ("config", "tolerance", np.nan),
        ("config", "method", "magic"),
        ("/", "schedule", "none"),
        ("/", "on_overflow", 7),
        ("/", "backend", "none"),
        ("/", "dtype", "int8"),
    ],
)
def test_an_attribute_that_was_tampered_with(saved, tmp_path, group, name, value):
    path = tmp_path / "copy.h5"
    path.write_bytes(saved.read_bytes())
    with h5py.File(path, "r+") as file:
        file[group].attrs[name] = value
    with pytest.raises(ValueError, match="dataset" if group == "sizes" else name):
        dc.Simulation.load(path)


def test_one_contact_of_another_world(saved, tmp_path):
    path = tmp_path / "copy.h5"
    path.write_bytes(saved.read_bytes())
    with h5py.File(path, "r+") as file:
        foreign = int(file["model/body_start"][1])
        file["contacts/body_b"][0] = foreign
    message = (
        rf"dataset contacts/body_b\[0\] is {foreign}; it must be a body of its world 0 \(bodies 0 \.\. {foreign - 1}\)"
    )
    with pytest.raises(ValueError, match=message):
        dc.Simulation.load(path)


@pytest.fixture
def restored():
    """A simulation, and what ``restore_contacts`` takes to put back what it has."""
    sim = simulation()
    sim.run(2, DT)
    slots, _ = contact_slots(sim.contacts)
    names = [name for name, field in CONTACTS.items() if field.per in PER_CONTACT]
    arrays = {name: sim.contacts.numpy(name)[slots].copy() for name in names}
    return sim, sim.contacts.numpy("contact_count").copy(), arrays, sim.contacts.numpy("contact_dt").copy()


def test_restored_contacts_are_held_to_their_rules(restored):
    sim, count, arrays, contact_dt = restored
    before = {name: a.tobytes() for name, a in loaded_arrays(sim).items()}
    foreign = int(sim.model.numpy("body_start")[1])
    cases = [
        ("color", 200, r"color\[0\] is 200; it must be in \[-1, 63\]"),
        ("color", -2, r"color\[0\] is -2"),
        ("age", -1, r"age\[0\] is -1"),
        ("age", 2**40, r"age\[0\] is 1099511627776; it must be an int32"),
        ("key", -1, r"key\[0\] is -1"),
        ("key", 2**62, r"key\[1\] is \d+; it must be larger than the one before"),
        ("body_a", foreign, rf"body_a\[0\] is {foreign}; it must be a body of its world 0"),
        ("body_b", -1, r"body_b\[0\] is -1; it must be a body of its world 0"),
        ("impulse", np.nan, r"impulse\[0, 0\] is nan; it must be finite"),
        ("impulse", 1e300, r"impulse\[0, 0\] is inf; it must be finite"),
        ("normal", 2.0, r"normal\[0\] is \(2\.0, 2\.0\); it must be a unit vector"),
        ("friction", -0.5, r"friction\[0\] is -0\.5"),
        ("restitution", 1.5, r"restitution\[0\] is 1\.5"),
    ]
    for name, value, message in cases:
        changed = arrays[name].astype(np.int64 if arrays[name].dtype.kind == "i" else np.float64)
        changed[0] = value
        with pytest.raises(ValueError, match=message):
            sim.restore_contacts(count, {**arrays, name: changed}, contact_dt)
    for name in ("key", "impulse", "color", "age"):
        with pytest.raises(ValueError, match=f"{name} is missing"):
            sim.restore_contacts(count, {k: a for k, a in arrays.items() if k != name}, contact_dt)
    for name, message in (("contact_dt", "contact_dt is no field of a contact"), ("colour", "colour is no field")):
        with pytest.raises(ValueError, match=message):
            sim.restore_contacts(count, {**arrays, name: arrays["age"]}, contact_dt)
    with pytest.raises(ValueError, match=r"impulse has shape \(\d+,\); it must be"):
        sim.restore_contacts(count, {**arrays, "impulse": arrays["impulse"][:, 0]}, contact_dt)
    for wrong, message in (
        (count + 1, r"contact_count adds up to"),
        (-count, r"contact_count\[0\] is -"),
        (count[:1], r"contact_count has shape \(1,\)"),
        (count + 0.5, r"contact_count\[0\] is .*; it must be an int64"),
    ):
        with pytest.raises(ValueError, match=message):
            sim.restore_contacts(wrong, arrays, contact_dt)
    for wrong in (-contact_dt, contact_dt * np.nan, contact_dt[:1]):
        with pytest.raises(ValueError, match="contact_dt"):
            sim.restore_contacts(count, arrays, wrong)
    assert {name: a.tobytes() for name, a in loaded_arrays(sim).items()} == before  # nothing was touched
    sim.restore_contacts(count.tolist(), {name: a.tolist() for name, a in arrays.items()}, contact_dt)
    assert {name: a.tobytes() for name, a in loaded_arrays(sim).items()} == before
