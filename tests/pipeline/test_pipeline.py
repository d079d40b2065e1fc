"""Runs, their files, the thesis protocol and the command line, on small scenes."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.cli import main
from pipeline.evaluate.comparison import protocol
from pipeline.evaluate.options import ProtocolOptions
from pipeline.evaluate.runs import Run
from pipeline.evaluate.worlds import filled
from pipeline.files import atomic_path, write_json
from pipeline.options import RunOptions, SolverOptions
from pipeline.plots import style
from pipeline.plots import world as drawing
from pipeline.run.simulate import Output, simulate
from pipeline.run.trajectory import STEP_FIELDS, pressing
from pipeline.scenes import SCENES, Mixed, Settled, Stack, Thesis, scene
from pipeline.seeds import HELD_OUT_SEED
from pipeline.starts import registry
from pipeline.starts.impulses import ImpulseStart, Zero

ROOT = Path(__file__).resolve().parents[2]
PNG = b"\x89PNG"
SMALL = ProtocolOptions(worlds=2, bodies=8, steps=120)


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


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_steps_and_is_drawn(name, tmp_path):
    sizes = {"rows": 3} if name == "pyramid" else {} if name == "incline" else {"bodies": 12}
    sim = dc.Simulation(*scene(name, **sizes).build(2).finalize())
    energy = dc.kinetic_energy(sim) + dc.potential_energy(sim)
    sim.run(30, 0.01)
    assert not sim.state.numpy("flags").any()
    assert (dc.kinetic_energy(sim) + dc.potential_energy(sim) <= energy + 1e-3 * np.abs(energy) + 1e-6).all()
    with style.figure(4.0, 4.0) as fig:
        axes = fig.add_subplot()
        drawing.draw_world(axes, sim, 1)
        style.save_figure(fig, tmp_path / "world.png", dpi=60)
    assert (tmp_path / "world.png").read_bytes()[:4] == PNG
    # what is drawn holds every body of the world
    left, right, (bottom, top) = *axes.get_xlim(), axes.get_ylim()
    bodies = slice(*sim.model.numpy("body_start")[1:3])
    moving = sim.state.numpy("position")[bodies][sim.model.numpy("body_type")[bodies] == dc.BodyType.DYNAMIC]
    assert ((moving > [left, bottom]) & (moving < [right, top])).all()


def test_settled_piles_are_near_rest():
    sim = dc.Simulation(*Settled(bodies=100).build(2).finalize())
    for _ in range(20):
        sim.step(0.01)
        assert np.abs(sim.state.numpy("velocity")).max() < 0.5
    assert (sim.contacts.numpy("contact_count") > 150).all()


def test_outlines_have_the_bodies_area():
    """Discs, capsules and rounded boxes are drawn as what they weigh (density 1)."""
    builder = Mixed(bodies=24).build(1, 2)
    builder.add_box(builder.add_body((20.0, 20.0), 0.3), 0.4, 0.2, radius=0.1)
    model, *rest = builder.finalize("float64")
    shapes = drawing.WorldShapes.of(drawing.arrays(dc.Simulation(model, *rest)), 0)
    area = np.zeros(model.body_count)
    for owner, points in shapes.outlines:
        x, y = points[..., 0], points[..., 1]
        area[owner] += 0.5 * (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)
    np.testing.assert_allclose(area[1:], model.numpy("mass")[1:], rtol=0.02)
    assert shapes.segments[1].shape == (3, 2, 2)


def test_forces_are_impulses_over_dt():
    sim = dc.Simulation(*Stack(bodies=1, jitter=0.0).build(2).finalize("float64"))
    sim.run(3, 0.02)
    for world in range(2):
        forces = drawing.Forces.of(sim, world)
        assert forces.normal.sum() == pytest.approx(9.8, rel=1e-3)
        np.testing.assert_allclose(forces.lines[:, 0], sim.state.numpy("position")[[2 * world + 1] * 2])
        np.testing.assert_allclose(np.sort(forces.points[:, 0]), [-0.5, 0.5], atol=1e-6)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return protocol(SMALL, progress=False)


def test_protocol_compares_the_starts(runs):
    assert [run.start for run in runs] == ["none", "builtin", "copy"]
    none, builtin, copy = (run.summary() for run in runs)
    assert none["states"] > 40
    assert copy["median_sweeps"] <= 2 < builtin["median_sweeps"]
    assert copy["mean_sweeps"] < builtin["mean_sweeps"] < none["mean_sweeps"]
    assert copy["done_in"]["10"] > 0.7
    assert none["start_error_normal"] > copy["start_error_normal"]
    for run in runs:
        shares = list(run.summary()["done_in"].values())
        assert shares == sorted(shares)
        assert run.sweeps.shape == (SMALL.steps, SMALL.worlds)
        assert run.decay.shape == (1000,)


def test_protocol_is_its_worlds_own_closed_loop(runs):
    """Builtin equals plain stepping, and the error of None is the mean square of its own impulses."""
    settings = {"acceleration": "none", "min_sweeps": 1, "slop": 5e-3, "speculative": 0.0, "speculative_max": 0.0}
    config = dc.SolverConfig(**settings)
    sim = dc.Simulation(*Thesis(bodies=8).build(2, HELD_OUT_SEED).finalize(), config=config)
    sweeps, contacts = [], []
    for _ in range(SMALL.steps):
        sim.step(0.01)
        sweeps.append(dc.to_numpy(sim.stats.sweeps).copy())
        contacts.append(pressing(sim))
    np.testing.assert_array_equal(runs[1].sweeps, sweeps)
    np.testing.assert_array_equal(runs[1].contacts, contacts)
    sim = dc.Simulation(*Thesis(bodies=8).build(2, HELD_OUT_SEED).finalize(), config=config)
    squares, none = [], Zero(sim)
    for _ in range(SMALL.steps):
        sim.step(0.01, start=none)
        squares.append(sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]].astype(float) ** 2)
    np.testing.assert_allclose(runs[0].start_error, np.concatenate(squares).mean(axis=0), rtol=1e-6)


def test_statistics_count_states_with_contacts():
    run = Run(
        start="none",
        solver="PGS",
        max_sweeps=100,
        tolerance=1e-4,
        sweeps=np.array([[0, 7], [40, 100], [100, 60]]),
        change=np.array([[0.0, 5e-5], [9e-5, 2e-4], [1e-5, 3e-5]]),
        contacts=np.array([[0, 2], [3, 4], [5, 6]]),
        start_error=(0.0, 0.0),
        wall_s=1.0,
        strategy_s=0.0,
    )
    row = run.summary()
    assert row["states"] == 5
    assert row["mean_sweeps"] == pytest.approx((7 + 40 + 100 + 100 + 60) / 5)
    assert row["median_sweeps"] == 60
    assert row["contacts"] == 4.0
    # of the two at the cap one has converged
    assert row["done_in"] == {"10": 0.2, "50": 0.4, "100": 0.8, "200": 0.8, "1000": 0.8}


def test_history_is_filled_with_its_last_change():
    history = np.array([[3.0, 2.0, 0.0, 0.0], [5.0, 4.0, 3.0, 2.0], [0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(filled(history, np.array([2, 4, 0])), [[3, 2, 2, 2], [5, 4, 3, 2], [0, 0, 0, 0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": ()}, "starts and accelerations"),
        ({"starts": ("none", "best")}, "start is 'best'"),
        ({"steps": 0}, "steps is 0"),
        ({"max_sweeps": 0}, "max_sweeps is 0"),
        ({"worlds": 0}, "worlds is 0"),
        ({"dt": -1.0}, "dt is -1.0"),
    ],
)
def test_wrong_protocol_options_raise(options, message):
    with pytest.raises(ValueError, match=message):
        protocol(ProtocolOptions(**options), progress=False)


def last_json(text: str) -> dict:
    return json.loads(text.strip().splitlines()[-1])


def test_command_simulate(tmp_path, capsys):
    options = "--worlds 2 --steps 5 --start copy2 --acceleration sor --dtype float64 --bodies 6"
    assert main(["simulate", "settled", *options.split(), "--out", str(tmp_path), "--json"]) == 0
    summary = last_json(capsys.readouterr().out)
    assert (summary["scene"], summary["worlds"], summary["steps"]) == ("settled", 2, 5)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["config"]["options"]["start"] == "copy2"
    assert summary["config"]["options"]["acceleration"] == "sor"
    assert summary["config"]["scene"]["bodies"] == 6
    main(["simulate", "stack", "--steps", "2", "--out", str(tmp_path)])
    assert "stack: 2 steps of 1 world(s)" in capsys.readouterr().out


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """The file of an untrained ContactNet."""
    torch = pytest.importorskip("torch")
    from pipeline.networks.checkpoint import save_checkpoint
    from pipeline.networks.models import build

    torch.set_num_threads(1)
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("network") / "untrained.safetensors"
    save_checkpoint(path, build("contactnet"), {})
    return path


def test_command_simulate_with_a_network(tmp_path, network, capsys):
    options = ["settled", "--worlds", "2", "--steps", "5", "--bodies", "12", "--start", str(network)]
    assert main(["simulate", *options, "--out", str(tmp_path), "--json"]) == 0
    summary = last_json(capsys.readouterr().out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    found = summary["network"]
    assert found["solves"] == 10 and found["calls"] >= 10
    assert set(found["seconds"]) == {"solve", "splat", "network", "gather", "start"}
    assert 0.0 < sum(found["seconds"].values()) < summary["simulation_s"]
    main(["simulate", *options, "--out", str(tmp_path)])
    text = capsys.readouterr().out
    assert found["explain"] in text  # the run is the same
    assert re.search(r"wall time: solve [0-9.]+ s, splat [0-9.]+ s, network [0-9.]+ s, gather [0-9.]+ s", text)
    main(["simulate", "settled", "--steps", "1", "--bodies", "12", "--out", str(tmp_path), "--json"])
    assert "network" not in last_json(capsys.readouterr().out)


def test_networks_have_the_threads_of_the_run(tmp_path, network, monkeypatch, capsys):
    from pipeline.starts.learned import LearnedSolve

    torch, seen, solve = sys.modules["torch"], [], LearnedSolve.solve
    monkeypatch.setattr(LearnedSolve, "solve", lambda *given: (seen.append(torch.get_num_threads()), solve(*given)))
    torch.set_num_threads(2)
    try:
        for command in (["simulate", "--out", str(tmp_path)], ["explain"]):
            main([command[0], "settled", "--bodies", "5", "--steps", "1", "--start", str(network), *command[1:]])
        assert seen == [1, 1] and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    capsys.readouterr()


def test_a_recorded_run_with_a_network_is_its_own_loop(tmp_path, network):
    summary, sim = simulate(
        Thesis(bodies=8),
        RunOptions(worlds=2),
        output=Output(steps=60, out=tmp_path, start=str(network)),
        progress=False,
    )
    own = dc.Simulation(*Thesis(bodies=8).build(2).finalize())
    solve = registry.maker(str(network))(own)
    for _ in range(60):
        own.collide(0.01)
        solve.solve()
        own.advance()
    np.testing.assert_array_equal(sim.state.numpy("position"), own.state.numpy("position"))
    assert solve.report().text == summary["network"]["explain"]


def test_command_protocol(tmp_path, capsys):
    options = "--worlds 2 --steps 60 --bodies 5 --starts none bad --accelerations none aitken"
    assert main(["protocol", *options.split(), "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    for label in ("None, PGS", "Bad, PGS", "None, PGS + aitken", "Bad, PGS + aitken", "median", "<=1000"):
        assert label in text
    assert (tmp_path / "protocol.png").read_bytes()[:4] == PNG
    rows = json.loads((tmp_path / "protocol.json").read_text())["runs"]
    assert [row["start"] for row in rows] == ["none", "bad", "none", "bad"]
    assert main(["protocol", *options.split(), "--no-history", "--json", "--out", str(tmp_path)]) == 0
    assert [row["mean_sweeps"] for row in last_json(capsys.readouterr().out)["runs"]] == [
        row["mean_sweeps"] for row in rows
    ]


def test_command_demo(tmp_path, capsys):
    assert main(["demo", "--worlds", "2", "--bodies", "6", "--steps", "70", "--out", str(tmp_path)]) == 0
    assert "Copy, PGS" in capsys.readouterr().out
    for name in ("demo.png", "protocol.png", "grids.png", "world/summary.png"):
        assert (tmp_path / name).read_bytes()[:4] == PNG
    assert (tmp_path / "world" / "trajectory.h5").exists()


def test_command_explain(capsys):
    assert main(["explain", "chain", "--bodies", "3"]) == 0
    text = capsys.readouterr().out
    assert text.strip()
    main(["explain", "chain", "--bodies", "3", "--json"])
    assert last_json(capsys.readouterr().out)["explain"].strip() == text.strip()


def test_command_explain_with_a_network(capsys, network):
    for steps in (0, 20):
        main(["explain", "settled", "--bodies", "12", "--start", str(network), "--steps", str(steps), "--json"])
        text = last_json(capsys.readouterr().out)["explain"]
        assert "broadphase" in text and f"calls a solve, of {steps} solves" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("simulate thesis --bodies 0", "thesis.bodies is 0"),
        ("simulate thesis --steps -1", "steps is -1"),
        ("simulate thesis --record-every 0", "record_every is 0"),
        ("simulate thesis --dt nan", "dt is nan"),
        ("simulate thesis --threads 0", "threads is 0"),
        ("simulate thesis --worlds 0", "worlds is 0"),
        ("simulate thesis --start best", "start is 'best'"),
        ("simulate thesis --start none.safetensors", "none.safetensors"),
        ("explain thesis --start best", "start is 'best'"),
        ("explain thesis --steps -1", "steps is -1"),
        ("simulate thesis --tolerance -1", "SolverConfig.tolerance is -1.0"),
        ("simulate thesis --bodies 4 --steps 1 --out /dev/null/x", "Not a directory"),
        ("protocol --steps 0", "steps is 0"),
        ("explain incline --angle 2", "incline.angle is 2.0"),
    ],
)
def test_wrong_values_are_one_line_and_exit_2(arguments, message, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    assert caught.value.code == 2
    output = capsys.readouterr()
    assert not output.out
    lines = [line for line in output.err.splitlines() if line.startswith("deep-contact: ")]
    assert len(lines) == 1
    assert message in lines[0]
    assert "Traceback" not in output.err


def test_interrupted_protocol_is_one_line(monkeypatch, capsys, tmp_path):
    class Interrupted(ImpulseStart):
        def write(self):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setitem(registry.STARTS, "none", lambda sim, seed: Interrupted(sim))
    with pytest.raises(SystemExit) as caught:
        main(["protocol", "--worlds", "1", "--bodies", "3", "--json", "--out", str(tmp_path)])
    assert caught.value.code == 130
    assert capsys.readouterr().err.splitlines()[-1] == "deep-contact: interrupted"


def test_missing_dependency_names_the_extra(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "tyro", None)
    with pytest.raises(SystemExit) as caught:
        main(["explain", "stack"])
    assert caught.value.code == 2
    assert "this needs tyro: install it with pip install 'deep-contact[pipeline]'" in capsys.readouterr().err


def test_help_names_units_and_defaults():
    def text(*arguments: str) -> str:
        command = [sys.executable, "-m", "pipeline.cli", *arguments, "--help"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env={"COLUMNS": "200", "PATH": ""})
        assert done.returncode == 0, done.stderr
        return done.stdout

    overview = text()
    for command in ("simulate", "demo", "protocol", "explain"):
        assert command in overview
    options = text("simulate", "thesis")
    for wanted in (
        "[s]. (default: 0.01)",
        "--bodies INT",
        "(default: builtin)",
        "--max-sweeps",
        "--video",
        "[N s or 1]",
    ):
        assert wanted in options
    assert options.count("(default:") == len(re.findall("^│ --", options, re.MULTILINE)) > 20


def test_scene_commands_have_the_scenes_names(capsys):
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    text = capsys.readouterr().out
    for name in SCENES:
        assert f"• {name}" in text
