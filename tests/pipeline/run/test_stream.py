"""A trajectory that grows on the disk: whole at every commit, kept when the disk is full or the run fails."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dc_kernels.runtime.hdf5 import reading
from pipeline.run import stream
from pipeline.run.simulate import Output, simulate
from pipeline.run.stream import Pages, Stream
from pipeline.scenes import Settled
from pipeline.starts import registry
from pipeline.starts.impulses import ImpulseStart

posix = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
OPERATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("write"), st.integers(0, 60), st.binary(min_size=1, max_size=40)),
        st.tuples(st.just("truncate"), st.integers(0, 90), st.just(b"")),
        st.tuples(st.just("commit"), st.just(0), st.just(b"")),
    ),
    max_size=12,
)


@given(OPERATIONS)
@settings(max_examples=50, deadline=None)
def test_pages_are_a_file(tmp_path_factory, operations):
    """What is read is what was written; the disk has what was there at the last commit."""
    before, stream.PAGE = stream.PAGE, 16
    descriptor = os.open(tmp_path_factory.mktemp("pages") / "file", os.O_RDWR | os.O_CREAT)
    try:
        pages, model = Pages(descriptor), bytearray()
        for kind, place, content in operations:
            if kind == "write":
                pages.seek(place)
                pages.write(content)
                model.extend(bytes(max(place + len(content) - len(model), 0)))
                model[place : place + len(content)] = content
            elif kind == "truncate":
                pages.truncate(place)
                model = model[:place] + bytes(max(place - len(model), 0))
            else:
                pages.commit()
                assert os.pread(descriptor, 1000, 0) == model and not pages.waiting
            pages.seek(0)
            assert pages.read() == model and pages.tell() == len(model) == pages.seek(0, os.SEEK_END)
        pages.commit()
        assert os.pread(descriptor, 1000, 0) == model
    finally:
        stream.PAGE = before
        os.close(descriptor)


def test_the_disk_has_a_whole_file_after_each_commit(tmp_path):
    growing = Stream(tmp_path / "run.h5")
    data = growing.file.create_dataset("rows", (0, 1000), "f8", maxshape=(None, 1000), chunks=(64, 1000), compression=1)
    for count in (1, 10, 100, 1000):
        data.resize(count, axis=0)
        data[...] = np.random.default_rng(count).random((count, 1000))
        growing.commit()
        data.resize(count + 1, axis=0)  # not committed
        with reading(growing.partial) as file:
            assert file["rows"].shape[0] == count
            np.testing.assert_array_equal(file["rows"], np.random.default_rng(count).random((count, 1000)))
    assert not (tmp_path / "run.h5").exists()
    growing.finish()
    growing.close()
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


CHILD = """
import resource, signal, sys
from pathlib import Path
from pipeline.cli import main
from pipeline.run import stream
stream.Stream.due = lambda self: True  # a disk that is busy must not put the first commit off
if int(sys.argv[1]):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # the system refuses larger files, as a full disk does
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
main(["simulate", "settled", "--bodies", "40", "--steps", sys.argv[3], "--out", sys.argv[2], "--json"])
"""


KILL = """
import os
due, asked = stream.Stream.due, []
def killed(self):
    asked.append(self)
    if len(asked) == 200:
        os.kill(os.getpid(), signal.SIGKILL)
    return len(asked) <= 150
stream.Stream.due = killed
"""


def child(limit: int, out, steps: int, before: str = "") -> subprocess.Popen:
    """A run in a process of its own, which cannot write files larger than ``limit``."""
    command = [sys.executable, "-c", CHILD.replace("if int", before + "if int"), str(limit), str(out), str(steps)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@posix
def test_a_full_disk_keeps_the_steps_so_far(tmp_path):
    process = child(400_000, tmp_path, 100_000)
    _, text = process.communicate(timeout=280)
    assert process.returncode == 2
    assert "Traceback" not in text and "trajectory.h5 holds the first " in text and "File too large" in text
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.h5"]
    with reading(tmp_path / "trajectory.h5") as file:
        steps = int(file.attrs["steps"])
        assert f"holds the first {steps} steps" in text and steps > 10 and not file.attrs["complete"]
        assert {len(data) for data in file["step"].values()} == {steps}
        assert {len(data) for data in file["record"].values()} == {steps + 1}
        assert np.isfinite(file["record/position"][...]).all() and file["record/step"][-1] == steps


@posix
def test_a_disk_without_room_leaves_the_old_file(tmp_path):
    (tmp_path / "trajectory.h5").write_text("old")
    process = child(2_000, tmp_path, 100)
    _, text = process.communicate(timeout=280)
    assert process.returncode == 2 and "Traceback" not in text
    assert "trajectory.h5 was not written: File too large; what was there before is whole" in text
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.h5"]
    assert (tmp_path / "trajectory.h5").read_text() == "old"


@posix
def test_a_kill_leaves_a_file_that_can_be_read(tmp_path):
    """Killed between two commits; the few changes of a commit within what is there take some 0.2 ms."""
    process = child(0, tmp_path, 10_000_000, KILL)
    process.communicate(timeout=280)
    assert process.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert re.fullmatch(r"\.trajectory\.\d+\.[0-9a-f]+\.partial\.h5", left.name)
    with reading(left) as file:
        assert (int(file.attrs["steps"]), bool(file.attrs["complete"])) == (150, False)
        assert {len(data) for data in file["step"].values()} == {150}
        assert len(file["record/position"]) == 151
        assert np.isfinite(file["record/position"][...]).all()


def test_a_run_that_fails_keeps_its_steps(tmp_path, monkeypatch):
    class Broken(ImpulseStart):
        """Fails in the sixth step."""

        calls = 0

        def write(self):
            self.calls += 1
            if self.calls == 6:
                raise RuntimeError("broken")

    monkeypatch.setitem(registry.STARTS, "none", lambda sim, seed: Broken(sim))
    with pytest.raises(RuntimeError, match="broken"):
        simulate(Settled(bodies=5), output=Output(out=tmp_path, start="none", record_every=2), progress=False)
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.h5"]
    with h5py.File(tmp_path / "trajectory.h5") as file:
        assert (int(file.attrs["steps"]), bool(file.attrs["complete"])) == (5, False)
        assert file["record/step"][...].tolist() == [0, 2, 4] and file["step/sweeps"].shape == (5, 1)
