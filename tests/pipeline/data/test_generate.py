"""Data sets: what their files hold, read by plain h5py, and that nothing is lost or doubled whatever happens."""

from __future__ import annotations

import dataclasses
import errno
import functools
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import hdf5plugin  # noqa: F401  (for h5py, which reads zstd with it)
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.cli import main, parse
from pipeline.data import generate as generation
from pipeline.data import layout, packing, shards
from pipeline.data.generate import generate
from pipeline.data.recipe import GenerateOptions, Recipe, load_recipe, parse_recipe
from pipeline.data.recorder import make_shard
from pipeline.files import LOCK, sole_writer, write_bytes
from pipeline.scenes import Chain, Conveyor, Mixed, Stack, Thesis

SMALL = Recipe(scene=Thesis(bodies=6), options=GenerateOptions(worlds=5, seed=7, steps=70, dt=0.02, shard_worlds=2))
SHARDS = ["shard-00000.h5", "shard-00001.h5", "shard-00002.h5"]


def changed(recipe: Recipe, **options) -> Recipe:
    """A recipe with other options."""
    return dataclasses.replace(recipe, options=dataclasses.replace(recipe.options, **options))


def make(recipe: Recipe, folder: Path, **options) -> dict:
    """A data set, without a bar."""
    return generate(recipe, folder, **{"threads": 1, "progress": False, **options})


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder but the index, which tells how many worlds there are."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name != layout.INDEX}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A data set of three shards; for reading only."""
    folder = tmp_path_factory.mktemp("whole")
    assert make(SMALL, folder)["complete"]
    return folder


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    """Its shards, without the index."""
    for name in SHARDS:
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    return tmp_path


# ---------------------------------------------------------------------- chunks


FILTERS = {"zstd": (2, 32015, 3), "gzip": (2, 1, 3)}  # shuffle, the codec, fletcher32, as they are registered


def filters(data: h5py.Dataset) -> tuple[int, ...]:
    """Filters that HDF5 applied to a dataset, in their order."""
    properties = data.id.get_create_plist()
    return tuple(properties.get_filter(i)[0] for i in range(properties.get_nfilters()))


def written(values: np.ndarray, axis: int, rows: int, compression: str) -> h5py.File:
    """A file of one dataset, packed by us."""
    column = layout.DatasetSpec(values.dtype, "1", "a test", values.shape[axis + 1 :], values.shape[:axis])
    packed = packing.pack(values, axis, rows, compression)
    image = packing.file_image({"group/data": packed}, {"group/data": column}, {})
    return h5py.File(io.BytesIO(image), "r")


@given(
    st.sampled_from(["f4", "f8", "i8", "i4", "u1"]),
    st.integers(0, 40),
    st.sampled_from([(0, ()), (0, (2,)), (1, (2,)), (0, (3, 2))]),
    st.integers(1, 17),
    st.integers(0, 2**32 - 1),
    st.sampled_from(sorted(FILTERS)),
)
def test_plain_h5py_reads_what_is_packed(dtype, rows, layout, chunk, seed, compression):
    axis, rest = layout
    shape = (3, rows, *rest) if axis else (rows, *rest)
    values = np.random.default_rng(seed).integers(0, 255, (*shape, np.dtype(dtype).itemsize), np.uint8)
    values = values.view(dtype)[..., 0] if rows else np.zeros(shape, dtype)
    with written(values, axis, chunk, compression) as file:
        data = file["group/data"]
        assert data[...].tobytes() == values.tobytes()
        assert not rows or filters(data) == FILTERS[compression]


@given(st.binary(min_size=2, max_size=2000))
def test_checksum_is_that_of_hdf5(data):
    with h5py.File("checksum", "w", driver="core", backing_store=False) as file:
        values = np.frombuffer(data, np.uint8)
        found = file.create_dataset("data", data=values, chunks=values.shape, fletcher32=True)
        file.flush()
        chunk = bytes(found.id.read_direct_chunk((0,))[1])
    assert chunk == data + packing.fletcher32(data)


def test_checksum_of_multiples_of_the_modulus():
    """65535 and 0 are one residue, but not one checksum."""
    for data in (b"\xff\xff" * 7, b"\x00\x00" * 7, b"\xff\xfe\x00\x01" * 65535, b"\x00"):
        test_checksum_is_that_of_hdf5.hypothesis.inner_test(data)


# ---------------------------------------------------------------------- what a data set holds


def test_layout_is_as_documented(whole):
    config = SMALL.config()
    for name in (*SHARDS, layout.INDEX):
        with h5py.File(whole / name) as file:
            assert (file.attrs["schema"], file.attrs["version"]) == ("deep-contact.dataset", layout.VERSION)
            index = file.attrs["kind"] == "index"
            known = config if index else {key: value for key, value in config.items() if key != "worlds"}
            assert json.loads(file.attrs["config"]) == known
            assert json.loads(file.attrs["versions"])["warp-lang"]
            assert file.attrs["flags"] == 0 and 0.9 < file.attrs["label_reached"] <= 1.0
            worlds = {"shard-00002.h5": 1, layout.INDEX: 5}.get(name, 2)
            assert (file.attrs["worlds"], file.attrs["steps"]) == (worlds, 70)
            assert file["world/seed"][0] == file.attrs["seed"]
            for axis, columns in layout.LAYOUT.items():
                for key, column in columns.items():
                    data = file[axis][key]
                    assert (data.attrs["unit"], data.attrs["meaning"]) == (column.unit, column.meaning)
                    assert data.dtype == column.dtype
                    if index and f"{axis}/{key}" not in layout.STARTS:
                        assert data.is_virtual
                    else:
                        assert filters(data) == FILTERS["gzip" if index else "zstd"]
            for start, rows in layout.STARTS.items():
                offsets = file[start][...]
                count = next(d for k, d in file[rows].items() if f"{rows}/{k}" not in layout.STARTS).shape[0]
                if rows == "contact":
                    count = file["contact/gap"].shape[0]
                assert offsets[0] == 0 and offsets[-1] == count and (np.diff(offsets) >= 0).all(), start
            assert list(file["contact/impulse"].attrs["stages"]) == ["start", "impulse", "label"]
    assert sorted(path.name for path in whole.iterdir()) == [layout.INDEX, *SHARDS]


def test_readers_without_our_code_find_a_state(whole):
    """The example of the README, against the simulation itself."""
    with h5py.File(whole / "index.h5") as file:
        s = file["world/step_start"][3] + 65  # world 3, step 65
        a, b = file["step/contact_start"][s : s + 2]
        start, impulse, label = file["contact/impulse"][:, a:b]
        key, point = file["contact/key"][a:b], file["contact/point"][a:b]
        a, b = file["step/motion_start"][s : s + 2]
        position = file["motion/position"][a:b]
        note = {name: file[f"step/{name}"][s] for name in ("sweeps", "change", "label_change", "label_sweeps", "step")}
    sim = dc.Simulation(*SMALL.scene.build(1, 10).finalize(), config=SMALL.solver)
    sim.run(65, 0.02)
    sim.collide(0.02)
    slots, _ = contact_slots(sim.contacts)
    np.testing.assert_array_equal(position, sim.state.numpy("position"))
    np.testing.assert_array_equal(key, sim.contacts.numpy("key")[slots])
    place = position[sim.contacts.numpy("body_a")[slots]] + sim.contacts.numpy("arm_a")[slots]
    np.testing.assert_array_equal(point, place)
    np.testing.assert_array_equal(start, sim.contacts.numpy("impulse")[slots])
    sim.solve()
    np.testing.assert_array_equal(impulse, sim.contacts.numpy("impulse")[slots])
    assert (note["sweeps"], note["change"]) == (sim.stats.numpy("sweeps")[0], sim.stats.numpy("change")[0])
    sim.solve(SMALL.label_config)
    np.testing.assert_array_equal(label, sim.contacts.numpy("impulse")[slots])
    assert (note["label_sweeps"], note["label_change"]) == (sim.stats.numpy("sweeps")[0], sim.stats.numpy("change")[0])
    assert note["step"] == 65 and len(key) > 5 and (label != impulse).any()


def test_index_shows_the_shards_as_one(whole):
    with h5py.File(whole / layout.INDEX) as index:
        parts = [h5py.File(whole / name) for name in SHARDS]
        for name, data in shards.datasets(parts[0]):
            axis = 1 if name == "contact/impulse" else 0
            if name not in layout.STARTS:
                np.testing.assert_array_equal(index[name], np.concatenate([part[name] for part in parts], axis))
            else:
                sizes = np.concatenate([np.diff(part[name]) for part in parts])
                np.testing.assert_array_equal(np.diff(index[name]), sizes)
            assert index[name].attrs["meaning"] == data.attrs["meaning"]
        assert index["world/seed"][...].tolist() == [7, 8, 9, 10, 11]
        assert index["shard/world_start"][...].tolist() == [0, 2, 4, 5]


def test_threads_and_shards_change_no_bit(whole, tmp_path):
    make(SMALL, tmp_path / "threads", threads=2)
    assert contents(tmp_path / "threads") == contents(whole)
    make(changed(SMALL, shard_worlds=5), tmp_path / "one")
    with h5py.File(tmp_path / "one" / layout.INDEX) as one, h5py.File(whole / layout.INDEX) as three:
        for name, data in shards.datasets(three):
            if not name.startswith("shard/"):
                np.testing.assert_array_equal(one[name], data, name)


def test_growth_within_a_shard_changes_no_bit(whole, monkeypatch):
    """Room runs out in mid-run: the step is repeated, no state is kept twice."""
    monkeypatch.setattr(dc, "Simulation", functools.partial(dc.Simulation, contacts_per_body=0.2, pairs_per_shape=0.2))
    assert bytes(make_shard(SMALL, 0)) == (whole / SHARDS[0]).read_bytes()


def test_labels_are_tighter_than_the_run(whole):
    with h5py.File(whole / layout.INDEX) as file:
        busy = np.diff(file["step/contact_start"]) > 0
        change, label = file["step/change"][...][busy], file["step/label_change"][...][busy]
        reached = file["step/label_reached"][...][busy] == 1
        residual, label_residual = file["step/residual"][...][busy], file["step/label_residual"][...][busy]
    np.testing.assert_array_equal(reached, label <= np.float32(1e-5))
    assert (label[reached] <= 1e-5).all() and (change > 1e-5).any()
    assert np.median(label_residual) < 0.3 * np.median(residual)


def test_labels_may_stop_by_the_residual():
    recipe = dataclasses.replace(SMALL, solver=dc.SolverConfig(stop="residual", tolerance=1e-3))
    recipe = changed(recipe, worlds=1, label_tolerance=1e-4)
    with h5py.File(io.BytesIO(make_shard(recipe, 0))) as file:
        reached, residual = file["step/label_reached"][...] == 1, file["step/label_residual"][...]
        np.testing.assert_array_equal(reached, residual <= np.float32(1e-4))
        assert reached.mean() > 0.9


def test_a_world_that_stops_is_marked(tmp_path):
    recipe = Recipe(scene=Thesis(bodies=2, gravity=1e37), options=GenerateOptions(worlds=1, steps=30, dt=1.0))
    summary = make(recipe, tmp_path)
    assert summary["flags"] == "NONFINITE"
    with h5py.File(tmp_path / layout.INDEX) as file:
        flags = file["step/flags"][...]
        assert flags[-1] and file.attrs["flags"] == flags[-1]
        first = int(np.argmax(flags != 0))
        assert not np.diff(file["step/contact_start"])[first + 1 :].any()
        assert np.isfinite(file["motion/position"][...]).all()
    assert "NONFINITE" in generation.describe(summary)


# ---------------------------------------------------------------------- ranges


def test_ranges_are_drawn_from_each_worlds_seed(tmp_path):
    ranges = (("radius", 0.2, 0.4), ("bodies", 3, 8), ("dt", 0.01, 0.03))
    recipe = changed(SMALL, worlds=6, ranges=ranges, steps=3)
    make(recipe, tmp_path)
    with h5py.File(tmp_path / layout.INDEX) as file:
        drawn = {name: file[f"drawn/{name}"][...] for name, _, _ in ranges}
        for name, low, high in ranges:
            assert len(set(drawn[name].tolist())) > 2 and low <= drawn[name].min() and drawn[name].max() <= high
        assert drawn["bodies"].dtype == np.int64
        np.testing.assert_array_equal(file["world/dt"], drawn["dt"].astype(np.float32))
        bodies, steps = file["world/body_start"][...], file["world/step_start"][...]
        motion, velocity = file["step/motion_start"][...], file["motion/velocity"][...]
        for w in range(6):
            scene = dataclasses.replace(SMALL.scene, radius=drawn["radius"][w], bodies=int(drawn["bodies"][w]))
            model, state, _ = scene.build(1, 7 + w).finalize()
            rows = slice(motion[steps[w]], motion[steps[w] + 1])
            np.testing.assert_array_equal(file["motion/position"][rows], state.numpy("position"))
            np.testing.assert_array_equal(file["body/mass"][bodies[w] : bodies[w + 1]], model.numpy("mass"))
            fallen = velocity[motion[steps[w] + 1] + 1]
            np.testing.assert_allclose(fallen, [0.0, -9.8 * drawn["dt"][w]], rtol=1e-6, atol=1e-7)
    # a further range changes nothing in what is drawn for the others
    more = changed(recipe, ranges=(*ranges, ("friction", 0.1, 0.9)))
    assert {**more.draw(9), "friction": None} == {**recipe.draw(9), "friction": None}


@pytest.mark.parametrize(
    "ranges, match",
    [
        ((("weight", 0.0, 1.0),), r"ranges.weight: thesis has .*'radius'.* to draw from"),
        ((("radius", 0.6, 0.4),), r"ranges.radius is \(0.6, 0.4\)"),
        ((("bodies", 2.5, 4.0),), "ranges.bodies .* must be integers"),
        ((("radius", -0.1, 0.4),), "thesis.radius is -0.1"),
        ((("restitution", 0.0, 1.5),), "thesis.restitution is 1.5"),
        ((("dt", 0.0, 0.1),), "dt is 0.0"),
        ((("radius", 0.1, 0.2), ("radius", 0.3, 0.4)), "ranges.radius is given twice"),
    ],
)
def test_bad_ranges_are_named(ranges, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        make(changed(SMALL, ranges=ranges), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options, match",
    [
        ({"worlds": 0}, "worlds is 0; it must be an integer"),
        ({"seed": -1}, "seed is -1"),
        ({"label_tolerance": 1e-3}, "label_tolerance is 0.001; it must not exceed solver.tolerance"),
        ({"label_sweeps": 0}, "label_sweeps is 0"),
        ({"grids": True, "grid_spacing": 0.0}, "spacing is 0"),
        ({"grids": True, "grid_spacing": 0.01}, "grid_spacing is 0.01: 2253001 nodes; 349525 can be stored"),
    ],
)
def test_bad_options_are_named(options, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        make(changed(SMALL, **options), tmp_path)


def test_joints_are_refused(tmp_path):
    with pytest.raises(ValueError, match="scene chain has joints"):
        make(Recipe(scene=Chain(), options=SMALL.options), tmp_path)
    with pytest.raises(ValueError, match="scene conveyor has surfaces that move or resist rolling"):
        make(Recipe(scene=Conveyor(), options=SMALL.options), tmp_path)


# ---------------------------------------------------------------------- grids


def test_stored_grids_are_those_made_from_the_states(tmp_path):
    dataset = pytest.importorskip("pipeline.data.dataset")
    splatter = pytest.importorskip("pipeline.data.splatter")
    recipe = Recipe(scene=Mixed(bodies=6), options=changed(SMALL, worlds=2, grids=True, grid_size=(5.0, 5.0)).options)
    make(recipe, tmp_path)
    states = dataset.States(tmp_path, min_contacts=0)
    image, label = splatter.Splatter(dc.ImageSpec(recipe.options.grid))(states.batch(range(len(states))))
    with h5py.File(tmp_path / layout.INDEX) as file:
        np.testing.assert_array_equal(file["grid/input"], image)
        np.testing.assert_array_equal(file["grid/label"], label)
        assert label.any() and file["grid/input"].is_virtual
    with h5py.File(tmp_path / SHARDS[0]) as file:
        assert filters(file["grid/input"]) == FILTERS["zstd"]


# ---------------------------------------------------------------------- cut short, damaged, full


def test_a_finished_data_set_is_kept(copy, whole):
    before = {name: (copy / name).stat().st_mtime_ns for name in SHARDS}
    summary = make(SMALL, copy)
    assert (summary["shards_kept"], summary["worlds_made"]) == (3, 0)
    assert before == {name: (copy / name).stat().st_mtime_ns for name in SHARDS}
    assert contents(copy) == contents(whole)


KILLED = """
import json, os, signal, sys
from pathlib import Path
from pipeline.data import generate as generation
from pipeline.data.recipe import parse_recipe

recipe, out = parse_recipe(json.loads(sys.argv[1])), Path(sys.argv[2])

def note(step):
    if len(list(out.glob("shard-*.h5"))) > 1:
        os.kill(os.getpid(), signal.SIGKILL)

generation.Progress.of = lambda progress, number: note
generation.generate(recipe, out, threads=1, progress=False)
"""


def test_a_killed_run_goes_on(whole, tmp_path):
    """SIGKILL in the middle of a shard, then the same command: every world once, finished shards untouched."""
    recipe = changed(SMALL, worlds=12)
    command = [sys.executable, "-c", KILLED, json.dumps(recipe.config()), str(tmp_path)]
    assert subprocess.run(command, stderr=subprocess.DEVNULL, check=False).returncode == -signal.SIGKILL
    finished = {path.name: path.stat().st_ino for path in tmp_path.glob("shard-*.h5")}
    assert 2 <= len(finished) < 6
    (tmp_path / ".shard-00004.1.partial.h5").write_bytes(b"half a shard")
    summary = make(recipe, tmp_path)
    assert summary["shards_kept"] == len(finished)
    assert sorted(path.name for path in tmp_path.iterdir()) == [layout.INDEX, *(f"shard-0000{n}.h5" for n in range(6))]
    assert all((tmp_path / name).stat().st_ino == inode for name, inode in finished.items())
    with h5py.File(tmp_path / layout.INDEX) as file:
        assert file["world/seed"][...].tolist() == list(range(7, 19))
        assert file["step/step"].shape == (12 * 70,)
    assert (tmp_path / "shard-00005.h5").read_bytes() == bytes(make_shard(recipe, 5))


def test_interrupt_keeps_what_is_finished(whole, tmp_path, monkeypatch):
    made = []

    def one_then_interrupt(recipe, number, *rest, **options):
        if made:
            os.kill(os.getpid(), signal.SIGINT)
        made.append(number)
        return make_shard(recipe, number, *rest, **options)

    monkeypatch.setattr(generation, "make_shard", one_then_interrupt)
    before = signal.getsignal(signal.SIGINT)
    summary = make(SMALL, tmp_path)
    assert not summary["complete"] and not (tmp_path / layout.INDEX).exists()
    assert signal.getsignal(signal.SIGINT) is before
    assert "the same command goes on" in generation.describe(summary)
    monkeypatch.undo()
    assert make(SMALL, tmp_path)["complete"]
    assert contents(tmp_path) == contents(whole)


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_full_disk_is_named_and_loses_nothing(whole, tmp_path, monkeypatch):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def full(path, content):
        if path.name == SHARDS[2]:  # the system refuses larger files from now on, as a full disk does
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        write_bytes(path, content)

    monkeypatch.setattr(generation, "write_bytes", full)
    try:
        with pytest.raises(OSError, match=r"shard-00002.h5 was not written: File too large") as raised:
            make(SMALL, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert raised.value.errno == errno.EFBIG
    assert contents(tmp_path) == {name: (whole / name).read_bytes() for name in SHARDS[:2]}
    monkeypatch.undo()
    make(SMALL, tmp_path)
    assert contents(tmp_path) == contents(whole)


@pytest.mark.parametrize(
    "field, recipe",
    [
        ("scene.radius = 0.5, not 0.4", dataclasses.replace(SMALL, scene=Thesis(bodies=6, radius=0.4))),
        ("scene.name = 'thesis', not 'stack'", dataclasses.replace(SMALL, scene=Stack(bodies=6))),
        (
            "solver.slop = 0.0005, not 0.001",
            dataclasses.replace(SMALL, solver=dataclasses.replace(SMALL.solver, slop=1e-3)),
        ),
        ("steps = 70, not 71", changed(SMALL, steps=71)),
        ("label_tolerance = 1e-05, not 1e-06", changed(SMALL, label_tolerance=1e-6)),
        ("worlds is 4: a data set may grow, not shrink", changed(SMALL, worlds=4)),
        ("shard_worlds = 2, not 3", changed(SMALL, shard_worlds=3)),
        ("ranges.radius = None", changed(SMALL, ranges=(("radius", 0.3, 0.4),))),
    ],
)
def test_another_recipe_is_refused(field, recipe, copy):
    before = contents(copy)
    with pytest.raises(ValueError, match=field.replace("(", r"\(")):
        make(recipe, copy)
    assert contents(copy) == before


def flip(path: Path, place: int) -> None:
    """Change one byte of a file."""
    data = bytearray(path.read_bytes())
    data[place] ^= 0x40
    path.write_bytes(data)


def test_damage_anywhere_is_found(copy, whole):
    """A byte in a chunk of any dataset, or in the file's structure."""
    path = copy / SHARDS[1]
    with h5py.File(path) as file:
        places = []
        for _, data in shards.datasets(file):
            if data.id.get_num_chunks():
                info = data.id.get_chunk_info(0)
                places.append(info.byte_offset + info.size // 2)
    for place in [3, 30, *places]:
        flip(path, place)
        with pytest.raises(ValueError, match=r"shard-00001\.h5 is (damaged|not an HDF5 file)"):
            make(SMALL, copy)
        flip(path, place)
    assert make(SMALL, copy)["shards_kept"] == 3


@pytest.mark.parametrize("kind", ["text", "truncated", "empty", "foreign", "version", "swapped", "stray"])
def test_damaged_and_foreign_files_are_named_and_left(kind, copy):
    path = copy / SHARDS[1]
    if kind == "text":
        path.write_text("not a shard")
    elif kind == "truncated":
        path.write_bytes(path.read_bytes()[:-1000])
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "foreign":
        with h5py.File(path, "w") as file:
            file["data"] = 1
    elif kind == "version":
        with h5py.File(path, "r+") as file:
            file.attrs["version"] = layout.VERSION + 1
    elif kind == "swapped":
        path.write_bytes((copy / SHARDS[0]).read_bytes())
    else:
        path = copy / "shard-00009.h5"
        path.write_bytes((copy / SHARDS[0]).read_bytes())
    before = contents(copy)
    with pytest.raises(ValueError, match=path.name):
        make(SMALL, copy)
    assert contents(copy) == before


# ---------------------------------------------------------------------- growth, and other writers


def test_a_data_set_grows(whole, tmp_path):
    """Whole shards are kept, the last one is made again; the bits are those of a data set made at once."""
    make(changed(SMALL, worlds=3), tmp_path)
    kept, part = ((tmp_path / name).stat().st_ino for name in SHARDS[:2])
    summary = make(SMALL, tmp_path)
    assert (summary["shards_kept"], summary["worlds_made"], summary["complete"]) == (1, 3, True)
    assert (tmp_path / SHARDS[0]).stat().st_ino == kept and (tmp_path / SHARDS[1]).stat().st_ino != part
    for name in (*SHARDS, layout.INDEX):
        assert (tmp_path / name).read_bytes() == (whole / name).read_bytes(), name


def test_codecs_hold_the_same_values_and_mix(whole, tmp_path):
    """A data set that was begun with gzip grows with zstd: its index, which has no codec of the shards, is the same."""
    make(changed(SMALL, worlds=2), tmp_path, compression="gzip")
    assert make(SMALL, tmp_path)["shards_kept"] == 1
    assert (tmp_path / layout.INDEX).read_bytes() == (whole / layout.INDEX).read_bytes()
    for name, codec in zip(SHARDS, ("gzip", "zstd", "zstd")):
        with h5py.File(tmp_path / name) as file, h5py.File(whole / name) as other:
            assert filters(file["contact/impulse"]) == FILTERS[codec]
            for path, data in shards.datasets(file):
                assert data[...].tobytes() == other[path][...].tobytes(), path
    with pytest.raises(ValueError, match=r"compression is 'lzf'; it must be one of \('zstd', 'gzip'\)"):
        make(SMALL, tmp_path, compression="lzf")


def test_idle_threads_compress_and_change_no_bit(whole, tmp_path, monkeypatch):
    shared = []
    real = generation._shared
    monkeypatch.setattr(generation, "_shared", lambda *given: shared.append(1) or real(*given))
    make(SMALL, tmp_path, threads=4)
    assert shared and contents(tmp_path) == contents(whole)


def test_growth_that_is_cut_short_keeps_the_old_index(tmp_path, monkeypatch):
    dataset = pytest.importorskip("pipeline.data.dataset")
    make(changed(SMALL, worlds=3), tmp_path)
    before = dataset.States(tmp_path, min_contacts=0)
    first = before[0], before[len(before) - 1]

    def fail(recipe, number, *rest, **options):
        if number == 2:
            raise OSError("no more")
        return make_shard(recipe, number, *rest, **options)

    monkeypatch.setattr(generation, "make_shard", fail)
    with pytest.raises(OSError, match="no more"):
        make(SMALL, tmp_path)
    after = dataset.States(tmp_path, min_contacts=0)  # the second shard has grown
    assert len(after) == len(before) == 3 * 70 and dataset.describe(tmp_path)["worlds"] == 3
    for one, other in zip(first, (after[0], after[len(after) - 1])):
        np.testing.assert_array_equal(one.label, other.label)
    monkeypatch.undo()
    assert make(SMALL, tmp_path)["states"] == 5 * 70


def test_the_index_of_the_same_data_has_the_same_bytes(whole, copy):
    time.sleep(1.1)  # HDF5's times are in seconds
    make(SMALL, copy)
    assert (copy / layout.INDEX).read_bytes() == (whole / layout.INDEX).read_bytes()


def test_only_one_writes_into_a_folder(tmp_path):
    with sole_writer(tmp_path):
        with pytest.raises(OSError, match=rf"process {os.getpid()} on .* is writing into it"):
            make(SMALL, tmp_path)
        (tmp_path / ".shard-00000.1.partial.h5").write_bytes(b"what the other one is writing")
    assert make(SMALL, tmp_path)["complete"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [layout.INDEX, *SHARDS]


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_a_killed_writer_holds_no_lock(tmp_path):
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom pipeline.files import sole_writer\n"
        "with sole_writer(Path(sys.argv[1])):\n    os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False).returncode == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]
    with sole_writer(tmp_path) as alone:
        assert alone
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------------- a shard is missing


@pytest.fixture
def moved(whole, tmp_path) -> Path:
    """A data set without its second shard."""
    folder = tmp_path / "data"
    folder.mkdir()
    for name in (*SHARDS, layout.INDEX):
        (folder / name).write_bytes((whole / name).read_bytes())
    (folder / SHARDS[1]).unlink()
    return folder


def test_a_missing_shard_is_not_zero_in_any_reader(moved, whole):
    with h5py.File(whole / layout.INDEX) as index, h5py.File(moved / layout.INDEX) as file:
        a, b = index["step/contact_start"][[2 * 70, 4 * 70]]  # contacts of the second shard
        c, d = index["step/motion_start"][[2 * 70, 4 * 70]]
        assert b > a
        for name in ("contact/impulse", "contact/gap", "contact/normal", "contact/bias"):
            rows = file[name][:, a:b] if name == "contact/impulse" else file[name][a:b]
            assert np.isnan(rows).all(), name
        assert np.isnan(file["motion/position"][c:d]).all() and (file["contact/body_a"][a:b] == -1).all()
        assert file["world/seed"][...].tolist() == [7, 8, -1, -1, 11]
        assert (file["contact/color"][a:b] == 255).all() and (file["step/label_reached"][140:280] == 255).all()
        np.testing.assert_array_equal(file["contact/gap"][:a], index["contact/gap"][:a])


def test_a_missing_shard_is_named(moved, whole, tmp_path, monkeypatch):
    dataset = pytest.importorskip("pipeline.data.dataset")
    for read in (dataset.States, dataset.describe):
        with pytest.raises(ValueError, match=r"data lacks shard-00001.h5, one of 1 missing among the 3 shards"):
            read(moved)
    monkeypatch.chdir(whole)  # where HDF5 would look, too
    alone = tmp_path / layout.INDEX
    alone.write_bytes((whole / layout.INDEX).read_bytes())
    with pytest.raises(ValueError, match=r"lacks shard-00000.h5, one of 3 missing among the 3"):
        dataset.States(alone)


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("../shard-00001.h5", "shard/name has '../shard-00001.h5', which is no file beside the index"),
        ("/etc/shard-1.h5", "which is no file beside the index"),
        ("shard-00000.h5", "seed 7 is there twice"),
    ],
)
def test_an_index_leads_nowhere_else(moved, whole, name, match):
    dataset = pytest.importorskip("pipeline.data.dataset")
    (moved / SHARDS[1]).write_bytes((whole / SHARDS[1]).read_bytes())
    with h5py.File(moved / layout.INDEX, "r+") as file:
        names = file["shard/name"][...].astype("S20")
        names[1] = name
        del file["shard/name"]
        file["shard/name"] = names
    with pytest.raises(ValueError, match=match):
        dataset.States(moved)


def test_a_shard_of_another_size_or_recipe_is_named(moved, whole, tmp_path):
    dataset = pytest.importorskip("pipeline.data.dataset")
    path = moved / SHARDS[1]
    path.write_bytes((whole / SHARDS[2]).read_bytes())
    with pytest.raises(ValueError, match=r"shard-00001.h5 holds 1 worlds, of which index.h5 shows 2"):
        dataset.States(moved)
    path.write_bytes(bytes(make_shard(changed(SMALL, dt=0.01), 1)))
    with pytest.raises(ValueError, match=r"shard-00001.h5 was made with dt = 0.01, not 0.02 as in index.h5"):
        dataset.States(moved)
    path.write_bytes((whole / SHARDS[1]).read_bytes())
    with h5py.File(path, "r+") as file:
        del file["contact/gap"]
        file["contact/gap"] = np.zeros(3, np.float32)
    with pytest.raises(ValueError, match=r"shard-00001.h5 is damaged: contact/"):
        dataset.States(moved)


# ---------------------------------------------------------------------- several folders


def test_folders_are_read_as_one(whole, tmp_path):
    dataset = pytest.importorskip("pipeline.data.dataset")
    one, two = tmp_path / "one", tmp_path / "two"
    make(changed(SMALL, worlds=3, shard_worlds=3), one)
    make(changed(SMALL, worlds=2, seed=10), two)
    joined, states = dataset.States([one, two / layout.INDEX], min_contacts=0), dataset.States(whole, min_contacts=0)
    assert len(joined) == len(states) and joined.seeds.tolist() == states.seeds.tolist()
    found, wanted = joined.batch(range(len(joined))), states.batch(range(len(states)))
    for field in dataclasses.fields(found):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(wanted, field.name), field.name)
    a, b = dataset.describe([one, two]), dataset.describe(whole)
    assert {**a, "config": 0, "slop": 0} == {**b, "config": 0, "slop": 0} and a["slop"] == pytest.approx(b["slop"])
    assert len(dataset.loader([one, two], batch_size=10, split=None)) == len(
        dataset.loader(whole, batch_size=10, split=None)
    )
    with pytest.raises(ValueError, match="seed 10 is there twice"):
        dataset.States([whole, two])
    make(changed(SMALL, worlds=1, seed=20, steps=5), tmp_path / "three")
    with pytest.raises(ValueError, match=r"three was made with steps = 5, not 70 as in .*one"):
        dataset.States([one, tmp_path / "three"])
    with pytest.raises(ValueError, match="no folder to read"):
        dataset.States([])


# ---------------------------------------------------------------------- recipes and the command line

TOML = """
worlds = 3
steps = 30
dt = 0.02
grid_size = [4.0, 4.0]
[scene]
name = "mixed"
bodies = 5
radius = 1
[ranges]
friction = [0.2, 0.8]
[solver]
max_sweeps = 300
"""


def test_a_toml_file_is_a_recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(TOML)
    recipe = load_recipe(path)
    assert recipe.scene == Mixed(bodies=5, radius=1.0) and recipe.solver == dc.SolverConfig(
        max_sweeps=300, min_sweeps=1, stop="change", tolerance=1e-4, relative_tolerance=1.3e-3
    )
    options = GenerateOptions(worlds=3, steps=30, dt=0.02, grid_size=(4.0, 4.0), ranges=(("friction", 0.2, 0.8),))
    assert recipe.options == options
    assert parse_recipe(recipe.config()) == recipe


@pytest.mark.parametrize(
    "text, match",
    [
        ("world = 3", r"recipe.toml: world is unknown; there are \('worlds'"),
        ("worlds = 3.5", "worlds is 3.5; it must be an integer"),
        ("[scene]\nname = 'box'", "scene is 'box'"),
        ("[scene]\nname = 'thesis'\nweight = 1.0", "scene.weight is unknown"),
        ("[scene]\nbodies = 8", r"scene.name is missing; it must say whose \('bodies',\) are"),
        ("[solver]\nmethod = 'newton'", "solver.method is 'newton'"),
        ("[solver]\nhistory = true", "solver.history is True"),
        ("[solver]\nstop = 'motion'", "solver.stop is 'motion'"),
        ("[solver]\nmethod = 'tgs_soft'", "solver.method is 'tgs_soft'"),
        ("[solver]\nsubsteps = 2", "solver.substeps is 2; a data set holds every step"),
        ("[ranges]\nradius = 0.5", r"ranges.radius is 0.5; it must be \[low, high\]"),
        ("worlds = ", "recipe.toml"),
    ],
)
def test_bad_toml_is_named(text, match, tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=match):
        load_recipe(path)


def test_options_take_the_place_of_the_files(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(TOML)
    command = parse(["generate", f"--config={path}", "--steps", "7"])
    assert (command.options.steps, command.options.worlds, command.scene) == (7, 3, Mixed(bodies=5, radius=1.0))
    command = parse(["generate", "mixed", "--config", str(path), "--bodies", "4", "--ranges", "radius", "0.3", "0.4"])
    assert (command.scene.bodies, command.options.ranges) == (4, (("radius", 0.3, 0.4),))
    assert parse(["generate", "stack"]).scene == Stack()


def test_command_makes_and_reports(tmp_path, capsys):
    arguments = ["generate", "thesis", "--bodies", "4", "--worlds", "2", "--steps", "50", "--dt", "0.02"]
    arguments += ["--out", str(tmp_path / "data"), "--threads", "1"]
    assert main(arguments) == 0
    assert "100 states" in capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["shards_kept"] == 1 and summary["config"]["scene"]["bodies"] == 4
    with pytest.raises(SystemExit):
        main([*arguments, "--steps", "51"])
    assert "steps = 50, not 51" in capsys.readouterr().err
