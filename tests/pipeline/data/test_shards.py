"""Shards of a data set: nothing is lost or doubled by kills, full disks, damage, growth, other writers."""

from __future__ import annotations

import dataclasses
import errno
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

from pipeline.data import generate as generation
from pipeline.data import layout, shards
from pipeline.data.recorder import make_shard
from pipeline.files import LOCK, sole_writer, write_bytes
from pipeline.scenes import Stack, Thesis
from tests.pipeline.data.making import FILTERS, SHARDS, SMALL, changed, contents, filters, make


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
def test_an_interrupt_after_the_last_shard_does_not_lose_the_index(tmp_path, monkeypatch):
    write = generation.write_index

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        write(*arguments)

    monkeypatch.setattr(generation, "write_index", interrupted)
    assert make(changed(SMALL, worlds=1, steps=2), tmp_path)["complete"]
    assert (tmp_path / layout.INDEX).exists()


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


@pytest.mark.parametrize("kind", ["text", "foreign", "shard", "link"])
def test_a_foreign_index_is_named_and_left(kind, whole, tmp_path):
    path = kept = tmp_path / "out" / layout.INDEX
    path.parent.mkdir()
    if kind == "foreign":
        with h5py.File(path, "w") as file:
            file["data"] = 1
    elif kind == "shard":
        path.write_bytes((whole / SHARDS[0]).read_bytes())
    else:
        kept = tmp_path / "kept.txt" if kind == "link" else path
        kept.write_text("no index")
        if kind == "link":
            path.symlink_to(kept)
    before = kept.read_bytes()
    with pytest.raises(ValueError, match=f"{layout.INDEX} is .*take it out of the folder"):
        make(changed(SMALL, worlds=1, steps=2), path.parent)
    assert kept.read_bytes() == before and not list(path.parent.glob("shard-*"))


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
    with h5py.File(tmp_path / layout.INDEX) as file:
        contacts = len(file["contact/gap"][...])

    def fail(recipe, number, *rest, **options):
        if number == 2:
            raise OSError("no more")
        return make_shard(recipe, number, *rest, **options)

    monkeypatch.setattr(generation, "make_shard", fail)
    with pytest.raises(OSError, match="no more"):
        make(SMALL, tmp_path)
    with h5py.File(tmp_path / layout.INDEX) as file:  # as anybody reads it
        assert file["world/seed"][...].tolist() == [7, 8, 9] and len(file["contact/gap"][...]) == contacts
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
