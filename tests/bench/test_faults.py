"""The bench of faults: that a crash and a hang are counted, and that what is wrong is found, beside what is right."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from bench.faults import changes, common, faults, files, kills, originals, scenarios, threads

h5py = pytest.importorskip("h5py")
from bench.faults import loaders  # noqa: E402


def test_a_child_that_crashes_or_hangs_is_counted_and_started_anew():
    child = common.Child("tests.bench.answers", 60.0)
    (one, first), crashed, (two, second) = (child.ask(question) for question in (1, "crash", 2))
    child.seconds = 0.2
    hung = child.ask("hang")
    child.close()
    assert (one, crashed, two, hung) == (1, "crashed", 2, "hung")
    assert first != second


def test_all_questions_are_answered_by_several_children():
    found = common.ask_all("tests.bench.answers", [*range(5), "crash"], 20.0, lambda: None)
    assert sorted(str(question) for question, _ in found) == ["0", "1", "2", "3", "4", "crash"]
    assert all(reply == "crashed" if question == "crash" else reply[0] == question for question, reply in found)


def test_a_process_that_is_late_is_killed():
    assert common.run(["-c", "print(3)"], 60.0) == common.Ended(0, "3\n", "")
    assert common.run(["-c", "import time; time.sleep(60)"], 0.5).code is None


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A snapshot and a network, as the bench makes them."""
    folder = tmp_path_factory.mktemp("originals")
    (folder / "snapshot").mkdir()
    sim = originals.scene()
    sim.run(60, 0.01)
    sim.save(folder / "snapshot" / "file.h5")
    pytest.importorskip("torch")
    originals.make_networks(folder)
    return folder


@pytest.mark.parametrize("kind", ["snapshot", "checkpoint"])
def test_changes_are_of_every_dataset_and_differ(made, tmp_path, kind):
    every = changes.hostile_files(made, kind)
    assert len(every) > 500 and len({file.name for file in every}) == len(every)
    if kind == "snapshot":
        with h5py.File(made / "snapshot" / "file.h5") as file:
            names = [name for group in ("model", "state", "joints", "contacts") for name in file[group]]
        assert all(any(f"/{name} " in file.name for file in every) for name in names)
    original = (made / kind / originals.NAMES[kind]).read_bytes()
    for i, file in enumerate(common.thinned(every, 25)):
        target = tmp_path / f"{i}"
        file.write(made / kind / originals.NAMES[kind], target)
        assert target.is_dir() or target.read_bytes() != original, file.name


def test_what_is_wrong_in_a_simulation_is_found():
    sim = originals.scene()
    sim.run(60, 0.01)
    assert loaders.wrong_in_simulation(sim) == []
    edits = {
        ("model", "inv_mass"): -1.0,
        ("model", "cell_size"): 0.0,
        ("model", "shape_type"): 7,
        ("model", "shape_body"): 0,
        ("model", "vertices"): np.nan,
        ("state", "position"): np.nan,
        ("joints", "joint_body_a"): 0,
        ("cache", "key"): 0,
        ("cache", "color"): 100,
        ("cache", "impulse"): np.inf,
    }
    for (group, name), value in edits.items():
        array = getattr(sim, group).array(name).numpy()
        kept = array.copy()
        array.reshape(-1)[-1 if group != "cache" else slice(None)] = value
        assert loaders.wrong_in_simulation(sim), name
        array[...] = kept
    assert loaders.wrong_in_simulation(sim) == []


def test_a_file_that_is_accepted_is_told_from_one_that_is_refused(made, tmp_path):
    good, bad = (tmp_path / name / "file.h5" for name in ("good", "bad"))
    for path in (good, bad):
        path.parent.mkdir()
        shutil.copyfile(made / "snapshot" / "file.h5", path)
    bad.write_bytes(bad.read_bytes()[:1000])
    assert loaders.load({"kind": "snapshot", "path": str(good)}) == {
        "digest": files.load_original(made, "snapshot"),
        "wrong": [],
    }
    refused = loaders.load({"kind": "snapshot", "path": str(bad)})
    assert refused["clear"] and "file.h5" in refused["refused"]


def test_what_a_kill_lost_is_told():
    reference = {"trajectory.h5": {"record/step": np.arange(5), "complete": np.array(True)}}
    left = {"record/step": np.arange(3), "complete": np.array(False)}
    assert kills.frames_differ({".trajectory.1.h5": left}, reference) == []
    left["record/step"] = np.array([0, 2, 1])
    assert len(kills.frames_differ({".trajectory.1.h5": left}, reference)) == 1
    assert kills.never_less([1, 2, 3], [1, 2]) and not kills.never_less([1, 3], [1, 2]) and not kills.never_less(2, 3)
    assert kills.equal({"a": np.arange(3)}, {"a": np.arange(3)}) and not kills.equal(
        {"a": np.zeros(1)}, {"a": -np.zeros(1)}
    )


def test_a_scenario_runs_and_a_failure_is_told(monkeypatch):
    assert set(threads.NAMES) == set(scenarios.SCENARIOS) and set(threads.QUICK) < set(threads.NAMES)
    scenarios.SCENARIOS["shards"](np.random.default_rng(0))
    assert threads.fault(threads.Run("no such scenario", 0)).startswith(
        "no such scenario, seed 0: ended with 1 KeyError"
    )


def test_parts_that_are_there_are_measured_and_their_faults_told(monkeypatch):
    found = {"hostile_files": 3, "crashed": 1, "file_faults": {"crashed": ["snapshot: a"]}, "kill_faults": ["lost b"]}
    monkeypatch.setattr(faults, "PARTS", ("files", "none such"))
    monkeypatch.setattr(files, "measure", lambda quick: found)
    values = faults.measure(quick=True)
    assert set(faults.KEYS) <= set(values) and values["crashed"] == 1 and values["kills"] is None
    text = faults.report(values)
    assert "crashed: snapshot: a" in text and "kill_faults: lost b" in text
