"""Runs and their files: whole, documented, and the simulation itself."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from pipeline.files import atomic_path, write_json
from pipeline.options import RunOptions, SolverOptions
from pipeline.run.simulate import Output, simulate
from pipeline.run.trajectory import STEP_FIELDS
from pipeline.scenes import Settled, Stack, Thesis
from pipeline.starts import registry
from pipeline.starts.impulses import ImpulseStart

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def settled(tmp_path_factory) -> tuple[Path, dict, dc.Simulation]:
    """A short run of two worlds and its files."""
    out = tmp_path_factory.mktemp("settled")
    run, output = RunOptions(worlds=2, seed=3), Output(steps=7, out=out, record_every=3, history=True)
    summary, sim = simulate(Settled(bodies=12), run, SolverOptions(max_sweeps=50), output, progress=False)
    return out, summary, sim


def test_files_are_whole_and_nothing_else_is_left(settled):
    out, summary, _ = settled
    assert sorted(path.name for path in out.iterdir()) == ["summary.json", "summary.png", "trajectory.h5"]
    assert json.loads((out / "summary.json").read_text()) == summary
    assert (out / "summary.png").read_bytes()[:4] == PNG
    assert summary["complete"] is True
    assert summary["config"]["scene"] == {"name": "settled", **vars(Settled(bodies=12))}
    assert summary["config"]["options"]["max_sweeps"] == 50


def test_trajectory_has_its_documented_layout(settled):
    out, _, sim = settled
    with h5py.File(out / "trajectory.h5") as file:
        assert (file.attrs["schema"], file.attrs["version"]) == ("deep-contact.trajectory", 1)
        assert file.attrs["complete"]
        assert file.attrs["steps"] == 7
        assert json.loads(file.attrs["config"])["options"]["worlds"] == 2
        np.testing.assert_array_equal(file["record/step"], [0, 3, 6, 7])
        np.testing.assert_allclose(file["record/time"], [0.0, 0.03, 0.06, 0.07])
        assert file["record/position"].shape == (4, sim.model.body_count, 2)
        assert file["record/angular_velocity"].shape == (4, sim.model.body_count)
        for name in ("position", "angle", "velocity", "angular_velocity"):
            np.testing.assert_array_equal(file[f"record/{name}"][-1], sim.state.numpy(name))
        start = Settled(bodies=12).build(2, 3).finalize()[1]
        np.testing.assert_array_equal(file["record/position"][0], start.numpy("position"))
        for name in STEP_FIELDS:
            assert file[f"step/{name}"].shape == (7, 2)
        sweeps, history = file["step/sweeps"][...], file["history/change"][...]
        assert history.shape == (7, 2, 50)
        np.testing.assert_array_equal(np.isfinite(history).sum(axis=2), sweeps)
        last = np.take_along_axis(history, np.maximum(sweeps - 1, 0)[..., None], axis=2)[..., 0]
        np.testing.assert_array_equal(last[sweeps > 0], file["step/change"][...][sweeps > 0])
        for name in sim.model.table:
            np.testing.assert_array_equal(file[f"model/{name}"], sim.model.numpy(name))

        def check(name: str, item: h5py.Dataset | h5py.Group) -> None:
            if isinstance(item, h5py.Dataset):
                assert {"unit", "meaning"} <= set(item.attrs), name
                assert name.startswith("model/") or (item.compression, item.shuffle) == ("gzip", True), name

        file.visititems(check)


def test_summary_is_that_of_the_trajectory(settled):
    out, summary, sim = settled
    with h5py.File(out / "trajectory.h5") as file:
        sweeps, contacts = file["step/sweeps"][...], file["step/pressing_count"][...]
        assert (contacts <= file["step/contact_count"]).all()
        energy = file["step/kinetic_energy"][-1] + file["step/potential_energy"][-1]
        overlap = file["step/penetration_max"][...]
    assert (contacts > 0).any()
    assert summary["mean_sweeps"] == pytest.approx(sweeps[contacts > 0].mean())
    assert summary["median_sweeps"] == np.median(sweeps[contacts > 0])
    assert summary["contacts_last"] == contacts[-1].mean()
    assert summary["penetration_max_mm"] == pytest.approx(1e3 * overlap.max())
    np.testing.assert_allclose(energy, dc.kinetic_energy(sim) + dc.potential_energy(sim))


def test_a_recorded_run_is_the_simulation_itself(tmp_path):
    """Recording changes nothing, and neither does the number of threads."""
    output = Output(steps=20, out=tmp_path)
    simulate(Thesis(bodies=5), RunOptions(worlds=3, threads=2), output=output, progress=False)
    sim = dc.Simulation(*Thesis(bodies=5).build(3).finalize())
    sim.run(20, 0.01)
    with h5py.File(tmp_path / "trajectory.h5") as file:
        np.testing.assert_array_equal(file["record/position"][-1], sim.state.numpy("position"))


def test_interrupted_run_leaves_whole_files(tmp_path, monkeypatch):
    class Interrupt(ImpulseStart):
        """As if Ctrl-C was pressed in the fourth step."""

        calls = 0

        def write(self):
            self.calls += 1
            if self.calls == 4:
                signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setitem(registry.STARTS, "none", lambda sim, seed: Interrupt(sim))
    output = Output(steps=1000, out=tmp_path, record_every=3, start="none")
    summary, _ = simulate(Settled(bodies=5), output=output, progress=False)
    assert signal.getsignal(signal.SIGINT) is before
    assert summary["complete"] is False
    assert summary["steps"] == 4
    with h5py.File(tmp_path / "trajectory.h5") as file:
        assert not file.attrs["complete"]
        np.testing.assert_array_equal(file["record/step"], [0, 3, 4])
        assert file["step/sweeps"].shape == (4, 1)
    assert json.loads((tmp_path / "summary.json").read_text())["complete"] is False
    assert (tmp_path / "summary.png").read_bytes()[:4] == PNG


def test_failed_run_leaves_the_old_file(tmp_path, monkeypatch):
    class Broken(ImpulseStart):
        def write(self):
            raise RuntimeError("broken")

    monkeypatch.setitem(registry.STARTS, "none", lambda sim, seed: Broken(sim))
    (tmp_path / "trajectory.h5").write_text("old")
    with pytest.raises(RuntimeError, match="broken"):
        simulate(Settled(bodies=5), output=Output(out=tmp_path, start="none"), progress=False)
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.h5"]
    assert (tmp_path / "trajectory.h5").read_text() == "old"


def test_atomic_path_replaces_or_leaves(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    with atomic_path(path) as partial:
        partial.write_text("one")
        assert not path.exists()
        assert partial.suffix == ".txt"
    assert path.read_text() == "one"
    with pytest.raises(RuntimeError), atomic_path(path) as partial:
        partial.write_text("two")
        raise RuntimeError
    assert path.read_text() == "one"
    assert list(path.parent.iterdir()) == [path]
    write_json(tmp_path / "deep" / "file.json", {"a": [1, 2]})
    assert json.loads((tmp_path / "deep" / "file.json").read_text()) == {"a": [1, 2]}


@pytest.mark.parametrize("steps", [0, 1])
def test_runs_without_contacts_or_steps(tmp_path, steps):
    output = Output(steps=steps, out=tmp_path)
    summary, _ = simulate(Thesis(bodies=1, gravity=0.0), output=output, progress=False)
    assert (summary["steps"], summary["mean_sweeps"], summary["contacts_last"]) == (steps, 0.0, 0.0)
    assert (tmp_path / "summary.png").exists()


@pytest.mark.parametrize(("kind", "first"), [("gif", b"GIF8"), ("mp4", b"\x00\x00\x00")])
def test_video(tmp_path, kind, first):
    output = Output(steps=12, out=tmp_path, video=kind)
    summary, _ = simulate(Stack(bodies=2), output=output, progress=False)
    assert summary["files"][-1] == f"video.{kind}"
    assert (tmp_path / f"video.{kind}").read_bytes()[: len(first)] == first


def test_a_recorded_run_with_a_network_is_its_own_loop(tmp_path, contactnet):
    summary, sim = simulate(
        Thesis(bodies=8),
        RunOptions(worlds=2),
        output=Output(steps=60, out=tmp_path, start=str(contactnet)),
        progress=False,
    )
    own = dc.Simulation(*Thesis(bodies=8).build(2).finalize())
    solve = registry.maker(str(contactnet))(own)
    for _ in range(60):
        own.collide(0.01)
        solve.solve()
        own.advance()
    np.testing.assert_array_equal(sim.state.numpy("position"), own.state.numpy("position"))
    assert solve.report().text == summary["network"]["explain"]
