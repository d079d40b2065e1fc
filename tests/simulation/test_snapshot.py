"""A run that goes on from a snapshot equals one that never stopped; damaged files are refused."""

import errno
import os
import shutil
import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import snapshot
from dc_kernels.model.fields import CONTACTS, JOINTS, MODEL, PER_CONTACT, ROLLING, STATE, TRAITS
from dc_kernels.runtime.threads import usable_cores
from tests.driving.scenes import DT, simulation

TABLES = {"model": MODEL, "state": STATE, "joints": JOINTS, "contacts": CONTACTS}


def contents(sim):
    """All that counts, as bytes; of the contacts only the slots in use."""
    slots, _ = dc.measure.contact_slots(sim.contacts)
    found = {}
    for group, table in TABLES.items():
        for field in table.values():
            if field.name != "contact_start":  # capacity may differ
                values = getattr(sim, group).numpy(field.name)
                values = values[slots] if field.per in PER_CONTACT and len(values) else values
                found[f"{group}/{field.name}"] = (values.dtype.name, values.shape, values.tobytes())
    return found


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A snapshot in the middle of a run, not to be changed."""
    sim = simulation()
    sim.run(40, DT)
    path = tmp_path_factory.mktemp("snapshot") / "saved.h5"
    sim.save(path)
    return path


@pytest.fixture
def copy(saved, tmp_path):
    """A snapshot to damage."""
    return shutil.copy(saved, tmp_path / "copy.h5")


@pytest.mark.parametrize(("dtype", "backend"), [("float32", "warp"), ("float64", "warp"), ("float64", "numpy")])
def test_going_on_equals_never_stopping(dtype, backend, tmp_path):
    steps = 40 if backend == "warp" else 25
    sim = simulation(dtype, backend)
    sim.run(steps, DT)
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5")
    assert sim.contacts.numpy("impulse").any()  # there is a cache to lose
    assert contents(loaded) == contents(sim)
    assert loaded.config == sim.config
    assert (loaded.model.dtype, loaded.model.backend) == (sim.model.dtype, backend)
    for _ in range(steps):
        sim.step(DT)
        loaded.step(DT)
        assert np.array_equal(loaded.stats.sweeps, sim.stats.sweeps)
    assert contents(loaded) == contents(sim)


def test_threads_and_schedule(saved, tmp_path):
    one, two = (dc.Simulation.load(saved, threads=threads) for threads in (1, 2))
    for sim in (one, two):
        sim.run(10, DT)
    assert contents(one) == contents(two)
    sim = simulation(schedule="color", on_overflow="raise")
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5")
    assert (loaded.schedule, loaded.on_overflow) == ("color", "raise")


def test_what_the_last_solve_took_and_the_threads_are_kept(tmp_path):
    sim = simulation()
    sim.most_threads = 2  # as on a machine that has them
    sim.run(3, DT)
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5")
    for name in ("sweeps", "change", "residual", "colors"):
        assert np.array_equal(loaded.stats.numpy(name), sim.stats.numpy(name)), name
    assert loaded.stats.numpy("sweeps").any() and not loaded.running.any()
    assert loaded.threads == min(2, usable_cores(), sim.model.world_count)
    with h5py.File(tmp_path / "snapshot.h5", "r+") as file:
        file["stats/sweeps"][0] = -1
    with pytest.raises(ValueError, match=r"dataset stats/sweeps\[0\] is -1; it must be >= 0"):
        dc.Simulation.load(tmp_path / "snapshot.h5")
    with h5py.File(tmp_path / "snapshot.h5", "r+") as file:  # as earlier versions wrote it
        del file["stats"], file.attrs["threads"]
    assert dc.Simulation.load(tmp_path / "snapshot.h5").threads == 1


def test_before_the_first_step(tmp_path):
    sim = simulation()
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5")
    for one in (sim, loaded):
        one.run(5, DT)
    assert contents(loaded) == contents(sim)


@pytest.mark.parametrize("specialize", [True, False])
def test_the_kernels_stay_the_same(specialize, tmp_path):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs(((0, 0), (3, 0)), 1.0)
    sim = dc.Simulation(*builder.finalize(), specialize=specialize)
    sim.save(tmp_path / "snapshot.h5")
    assert dc.Simulation.load(tmp_path / "snapshot.h5").variant == sim.variant
    assert dc.Simulation.load(tmp_path / "snapshot.h5", specialize=False).variant == "general"


def test_not_in_the_middle_of_a_step(tmp_path):
    sim = simulation()
    sim.collide(DT)
    with pytest.raises(ValueError, match="middle of a step"):
        sim.save(tmp_path / "snapshot.h5")
    sim.step(DT)
    sim.save(tmp_path / "snapshot.h5")


def test_a_frozen_world_stays_frozen(tmp_path):
    sim = simulation()
    sim.state.numpy("force")[3] = np.nan  # what the constructor would refuse
    sim.state.numpy("flags")[0] = dc.Flag.NONFINITE
    sim.save(tmp_path / "snapshot.h5")
    assert contents(dc.Simulation.load(tmp_path / "snapshot.h5")) == contents(sim)


def crowded(on_overflow="raise", room=4.0):
    """Two worlds in which discs come to touch: with little room a step overflows."""
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), ((-2, 3), (-2, 0), (2, 0), (2, 3)))
        x, y = np.meshgrid(np.arange(-3, 4) * 0.21, np.arange(5) * 0.215 + 0.12)
        builder.add_discs(np.stack((x.ravel(), y.ravel()), axis=1), 0.1)
    config = dc.SolverConfig(max_sweeps=60)
    return dc.Simulation(*builder.finalize(), config=config, on_overflow=on_overflow, contacts_per_body=room)


def test_after_an_overflow_the_last_finished_step_is_kept(tmp_path):
    """The failed step leaves its contacts behind; what is saved goes on from those of the step before, bit for bit."""
    sim, other = crowded(room=0.6), crowded("grow")
    with pytest.raises(OverflowError, match=r"world \d needs \d+ contacts"):
        for _ in range(200):
            sim.step(DT)
            other.step(DT)
    done = sim.state.numpy("time")[0]
    assert done > 0.0
    assert not np.array_equal(sim.contacts.numpy("contact_count"), sim.cache.numpy("count"))
    sim.save(tmp_path / "snapshot.h5")
    with h5py.File(tmp_path / "snapshot.h5") as file:
        assert set(file["cache"]) == {*sim.cache.table} - {"rolling_impulse"}  # which this scene has not got
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5", on_overflow="grow")
    assert contents(loaded) == contents(sim)
    assert np.array_equal(loaded.cache.numpy("count"), sim.cache.numpy("count"))
    for one in (loaded, other):
        one.run(20, DT)
    assert contents(loaded) == contents(other)
    assert loaded.state.numpy("time")[0] > done
    loaded.save(tmp_path / "later.h5")
    with h5py.File(tmp_path / "later.h5") as file:
        assert "cache" not in file


def test_a_world_that_froze_in_a_step_goes_on_as_if_it_had_not_been_saved(tmp_path):
    """Its contacts are those of the failed step, with numbers that are not finite; the next step starts before it."""
    sim = simulation()
    sim.run(20, DT)
    sim.collide(DT)
    sim.contacts.numpy("impulse")[:] = np.inf
    sim.solve()
    sim.advance()
    assert sim.state.numpy("flags")[0] == dc.Flag.NONFINITE
    sim.save(tmp_path / "snapshot.h5")
    loaded = dc.Simulation.load(tmp_path / "snapshot.h5")
    assert contents(loaded) == contents(sim)
    for one in (sim, loaded):
        one.state.numpy("flags")[:] = 0
        one.run(5, DT)
    assert contents(loaded) == contents(sim)


def test_what_could_not_be_loaded_is_not_saved(copy):
    before = copy.read_bytes()
    sim = simulation()
    dc.to_numpy(sim.model.inv_mass)[3] = 5.0
    with pytest.raises(ValueError, match=r"model\.inv_mass\[3\] is 5\.0; it must be 1 / mass"):
        sim.save(copy)
    assert copy.read_bytes() == before


def test_datasets_say_what_they_are(saved):
    with h5py.File(saved) as file:
        assert file.attrs["schema"] == "deep-contact snapshot"
        for group, table in TABLES.items():
            there = [field for field in table.values() if field.per not in (*TRAITS, ROLLING)]  # which it has not got
            assert set(file[group]) == {field.name for field in there}
            for field in there:
                attributes = file[group][field.name].attrs
                assert attributes["unit"] == field.unit
                assert attributes["meaning"] == field.meaning
                assert attributes["axis"] == field.per


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_truncated_file(copy, share):
    os.truncate(copy, int(os.path.getsize(copy) * share))
    with pytest.raises(ValueError, match=r"copy\.h5 is not an HDF5 file, or is truncated"):
        dc.Simulation.load(copy)


def test_foreign_files(tmp_path):
    text, other = tmp_path / "text.h5", tmp_path / "other.h5"
    text.write_text("position velocity\n" * 1000)
    with pytest.raises(ValueError, match=r"text\.h5 is not an HDF5 file"):
        dc.Simulation.load(text)
    with h5py.File(other, "w") as file:
        file["data"] = np.zeros(3)
    with pytest.raises(ValueError, match=r"other\.h5 is not a deep-contact snapshot"):
        dc.Simulation.load(other)
    with h5py.File(other, "w") as file:
        file.attrs["schema"] = "deep-contact.dataset"
        layout = h5py.VirtualLayout((3,), float)
        layout[:] = h5py.VirtualSource("shard-00000.h5", "a", (3,))
        file.create_virtual_dataset("a", layout)
    with pytest.raises(ValueError, match=r"schema 'deep-contact\.dataset', not a deep-contact snapshot"):
        dc.Simulation.load(other)
    with pytest.raises(FileNotFoundError):
        dc.Simulation.load(tmp_path / "none.h5")


def replace(file, name, values):
    del file[name]
    file[name] = values


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: f.attrs.__setitem__("schema_version", 99), "schema version 99; this version reads 1"),
        (lambda f: f.attrs.__delitem__("schema_version"), "schema version None"),
        (lambda f: f.attrs.__delitem__("schedule"), "attribute is missing.*schedule"),
        (lambda f: f.attrs.__setitem__("dtype", "float16"), "attribute has a wrong value.*float16"),
        (lambda f: f.__delitem__("sizes"), "group sizes is missing"),
        (lambda f: f["sizes"].attrs.__delitem__("body"), "attribute is missing.*body"),
        (
            lambda f: f["sizes"].attrs.__setitem__("body", 10**12),
            r"model/body_type has shape \(\d+,\).* must be \(10+,\)",
        ),
        (lambda f: f["sizes"].attrs.__setitem__("world", 10**12), r"model/body_start has shape \(3,\).* must be"),
        (lambda f: f["config"].attrs.__setitem__("tolerance", -1.0), "config: SolverConfig.tolerance is -1.0"),
        (lambda f: f["config"].attrs.__setitem__("colour", 1), "config: .*colour"),
        (lambda f: f.__delitem__("contacts"), "dataset contacts/contact_start is missing"),
        (lambda f: f.__delitem__("state/angle"), "dataset state/angle is missing"),
        (lambda f: replace(f, "state/angle", f["state/angle"][1:]), r"state/angle has shape \(\d+,\).* must be"),
        (lambda f: replace(f, "state/angle", f["state/angle"][()].astype("f8")), "state/angle .* dtype float64"),
        (lambda f: (f.__delitem__("state/angle"), f.create_group("state/angle")), "state/angle has shape None"),
        (lambda f: f["contacts/body_a"].__setitem__(0, -1), r"contacts/body_a\[0\] is -1; .* a body of its world 0"),
        (
            lambda f: f["model/shape_body"].__setitem__(0, 999),
            r"model/shape_body\[0\] is 999; .* a body of its world 0",
        ),
        (
            lambda f: f["model/vertex_start"].__setitem__(1, 10**6),
            r"model/vertex_start\[2\] is \d+; .* at least the one before",
        ),
        (lambda f: f["model/body_start"].__setitem__(0, 1), r"model/body_start\[0\] is 1; it must be 0"),
        (
            lambda f: f["contacts/contact_count"].__setitem__(0, 0),
            r"contacts/contact_count adds up to \d+; it must be \d+",
        ),
    ],
)
def test_what_is_wrong_is_named(copy, damage, message):
    with h5py.File(copy, "r+") as file:
        damage(file)
    with pytest.raises(ValueError, match=rf"copy\.h5.*{message}"):
        dc.Simulation.load(copy)


@pytest.mark.parametrize("name", ["model/vertices", "state/position", "contacts/impulse"])
def test_one_wrong_bit_is_found(copy, name):
    with h5py.File(copy) as file:
        offset = file[name].id.get_chunk_info(0).byte_offset
    with open(copy, "r+b") as raw:
        raw.seek(offset + 5)
        byte = raw.read(1)[0]
        raw.seek(offset + 5)
        raw.write(bytes([byte ^ 0x10]))
    with pytest.raises(ValueError, match=rf"copy\.h5: dataset {name} is damaged"):
        dc.Simulation.load(copy)


class Stop(BaseException):
    """Not an Exception, as KeyboardInterrupt is not."""


def stopped(*_):
    raise Stop


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("failure", [stopped, full])
@pytest.mark.parametrize("place", ["write", "sync", "replace"])
def test_a_failure_leaves_the_old_file(copy, tmp_path, monkeypatch, failure, place):
    before = copy.read_bytes()
    sim = simulation()
    if place == "write":  # after the first datasets
        monkeypatch.setattr(snapshot, "contact_slots", failure)
    else:
        monkeypatch.setattr(os, {"sync": "fsync", "replace": "replace"}[place], failure)
    with pytest.raises((Stop, OSError)):
        sim.save(copy)
    monkeypatch.undo()
    assert copy.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [copy.name]  # no half-written file either
    sim.save(copy)
    assert contents(dc.Simulation.load(copy)) == contents(sim)


def test_no_such_folder(tmp_path):
    with pytest.raises(OSError, match="none"):
        simulation().save(tmp_path / "none" / "snapshot.h5")


# A process of its own that saves to argv[1].
SAVE = """
import sys
import numpy as np
import dc_kernels as dc
from dc_kernels import snapshot
builder = dc.ModelBuilder()
builder.add_world()
builder.add_discs(np.zeros((2000, 2)), 1.0)
sim = dc.Simulation(*builder.finalize(backend="numpy"))
"""
needs_posix = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")


def save_elsewhere(path, code):
    command = [sys.executable, "-c", SAVE + code + "\nsnapshot.save(sim, sys.argv[1])", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@needs_posix
def test_a_kill_leaves_the_old_file(copy):
    before = copy.read_bytes()
    kill = "import os, signal; os.fsync = lambda *_: os.kill(os.getpid(), signal.SIGKILL)"
    assert save_elsewhere(copy, kill).returncode == -signal.SIGKILL
    assert copy.read_bytes() == before


@needs_posix
def test_a_disk_that_fills_up_leaves_the_old_file(copy, tmp_path):
    before = copy.read_bytes()
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))"  # the system refuses more
    result = save_elsewhere(copy, limit)
    assert result.returncode == 1
    assert "OSError" in result.stderr
    assert "File too large" in result.stderr
    assert copy.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [copy.name]
    assert save_elsewhere(copy, "").returncode == 0
    assert copy.read_bytes() != before
