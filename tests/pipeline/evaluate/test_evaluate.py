"""Strategies and networks on held-out worlds: closed and open loop, what is counted, tables, files."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.grid.transfer import gather, splat
from dc_kernels.measure import contact_slots
from pipeline.cli import main
from pipeline.evaluate import comparison, runs, tables
from pipeline.evaluate.comparison import evaluation
from pipeline.evaluate.options import EvaluationOptions
from pipeline.evaluate.worlds import run_worlds, split_label
from pipeline.plots import protocol as run_plots
from pipeline.plots import style
from pipeline.starts import registry
from pipeline.starts import start as starting
from pipeline.starts.impulses import ImpulseStart, Zero
from pipeline.starts.solution import thesis_grid
from pipeline.starts.start import Report, Started

torch = pytest.importorskip("torch")
from pipeline.networks import models  # noqa: E402
from pipeline.networks.checkpoint import save_checkpoint  # noqa: E402
from pipeline.starts.grid_network import GridNetworkStart  # noqa: E402

torch.set_num_threads(1)
SMALL: dict[str, Any] = {"worlds": 2, "bodies": 10, "steps": 90}
PNG = b"\x89PNG"


def options(**changed: Any) -> EvaluationOptions:
    return EvaluationOptions(**{**SMALL, **changed})


@pytest.fixture(scope="module")
def open_runs() -> list[runs.Run]:
    chosen = options(starts=("none", "builtin", "copy", "bad"), accelerations=("none", "aitken"), loops=("open",))
    return evaluation(chosen, progress=False)


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """A small network with random weights, and what it reads."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("network") / "small.safetensors"
    images = dc.ImageSpec(dc.Grid.thesis(), stencil=dc.Stencil(h=0.5))
    manifest = {"images": images.to_dict(), "decode": {"reverse": False}}
    save_checkpoint(path, models.build("pressure", models.GridConfig(width=0.25)), manifest)
    return path


# ---------------------------------------------------------------------- loops


def test_open_loop_gives_all_the_states_of_builtins_trajectory(open_runs):
    closed = run_worlds(options(), "builtin", "none")
    for run in open_runs:
        np.testing.assert_array_equal(run.contacts, closed.contacts)
        assert run.loop == "open"
    builtin = open_runs[1]
    for name in ("sweeps", "change", "decay", "errors"):
        np.testing.assert_array_equal(getattr(builtin, name), getattr(closed, name))
    means = {run.label: run.summary()["mean_sweeps"] for run in open_runs}
    assert means["Copy, PGS"] < means["Builtin, PGS"] < means["None, PGS"] < means["Bad, PGS"]
    assert means["Builtin, PGS + aitken"] < means["Builtin, PGS"]


def test_open_loop_solves_are_those_of_the_state(open_runs):
    """By hand: each state solved from zero, then from the cache."""
    sim = options().simulation("none")
    for step in range(SMALL["steps"]):
        sim.collide(0.01)
        cache = sim.contacts.numpy("impulse").copy()
        Zero(sim).write()
        sim.solve()
        np.testing.assert_array_equal(open_runs[0].sweeps[step], sim.stats.numpy("sweeps"))
        slots, world = contact_slots(sim.contacts)
        for w in np.unique(world):
            square = sim.contacts.numpy("impulse")[slots[world == w]].astype(float) ** 2
            np.testing.assert_allclose(open_runs[0].errors[step, w], square.mean(axis=0), rtol=1e-12)
        assert np.isnan(np.delete(open_runs[0].errors[step], np.unique(world), axis=0)).all()
        sim.contacts.numpy("impulse")[...] = cache
        sim.solve()
        sim.advance()


def test_closed_loop_is_a_trajectory_of_its_own():
    none, builtin = evaluation(options(starts=("none", "builtin"), loops=("closed",)), progress=False)
    assert (none.contacts != builtin.contacts).any()


# ---------------------------------------------------------------------- what the transfer costs


@pytest.mark.parametrize("reverse", [True, False])
def test_grid_is_copy_through_the_theses_grid(reverse):
    sim = options(bodies=100, worlds=1).simulation("none")
    sim.run(150, 0.01)
    sim.collide(0.01)
    cache = sim.contacts.numpy("impulse").copy()
    start = registry.maker("grid" if reverse else "grid-bilinear")(sim)
    start.write()
    assert start.images.spec.grid == dc.Grid.thesis()
    slots, _ = contact_slots(sim.contacts)
    found = sim.contacts.numpy("impulse")[slots].copy()
    sim.contacts.numpy("impulse")[...] = cache
    sim.solve()
    solved = sim.contacts.numpy("impulse")[slots].copy()
    points = sim.state.numpy("position")[sim.contacts.numpy("body_a")[slots]] + sim.contacts.numpy("arm_a")[slots]
    label = splat(points, solved, dc.Grid.thesis(), dc.Stencil(h=0.5))
    way: dict[str, Any] = {"stencil": dc.Stencil(h=0.5), "reverse": True} if reverse else {}
    np.testing.assert_array_equal(found, gather(label, points, dc.Grid.thesis(), **way))
    kept = found[:, 0].sum() / solved[:, 0].sum()
    assert 0.9 < kept < 1.1 if reverse else kept < 0.3  # the shrinking that Tirca saw


def test_grid_covers_what_there_is():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs([(2.0, 1.0), (5.1, 4.0)], radius=0.5)
    sim = dc.Simulation(*builder.finalize())
    grid = thesis_grid(sim)
    assert grid.origin == (2.0, 1.0) and grid.spacing == 0.25 and grid.upper == pytest.approx((5.25, 4.0))
    sim.step(0.01, start=registry.maker("grid")(sim))


# ---------------------------------------------------------------------- networks


def test_a_networks_time_is_split_and_counted(network):
    run = run_worlds(options(), f"tiny={network}", "none")
    assert run.label == "Tiny, PGS" and run.converged.mean() > 0.9
    for part in ("collide", "splat", "network", "gather", "solve", "advance"):
        assert run.parts[part] > 0.0
    assert run.wall_s == pytest.approx(sum(run.parts.values()))
    assert run.strategy_s < run.wall_s
    assert run.counts["calls"] + run.counts["skipped"] == run.sweeps.size
    assert 0 < run.counts["skipped"] < run.sweeps.size
    oracle = run_worlds(options(), "copy", "none")
    assert oracle.wall_s == pytest.approx(sum(oracle.parts.values()) - oracle.strategy_s) and not oracle.counts


def test_a_file_without_a_label_is_called_by_its_stem(network):
    assert split_label(str(network)) == ("small", str(network))
    assert split_label("copy2") == ("copy2", "copy2")
    assert split_label(f"a=b={network}") == ("a=b", str(network))


def test_what_cannot_run_is_said_before_anything_runs(network, tmp_path, monkeypatch):
    monkeypatch.setattr(comparison, "run_worlds", lambda *arguments, **others: pytest.fail("something ran"))
    foreign = tmp_path / "foreign.safetensors"
    foreign.write_bytes(b"no network")
    for changed, error, message in (
        ({"starts": ("none", "best")}, ValueError, "start is 'best'"),
        ({"starts": ("none", str(tmp_path / "missing.safetensors"))}, OSError, "missing.safetensors is not there"),
        ({"starts": ("none", str(foreign))}, ValueError, "foreign.safetensors is damaged"),
        ({"starts": ("none", str(network)), "dtype": "float64"}, ValueError, "answers in float32"),
        ({"loops": ()}, ValueError, "loops must name at least one"),
        ({"steps": 0}, ValueError, "steps is 0"),
    ):
        with pytest.raises(error, match=message):
            evaluation(options(**changed), progress=False)


def test_threads_of_torch_are_the_options_and_come_back(network, monkeypatch):
    seen = []
    monkeypatch.setattr(
        comparison, "run_worlds", lambda *arguments, **others: seen.append(torch.get_num_threads()) or made()
    )
    torch.set_num_threads(2)
    try:
        evaluation(options(starts=(str(network),), loops=("open",), threads=1), progress=False)
        assert seen == [1] and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)


class Halved:
    """A network that halves the cache before the first sweep, and pauses in between."""

    def __init__(self, sim: dc.Simulation, early: bool) -> None:
        self.sim, self.early = sim, early
        self.seconds = {"solve": 0.0, "network": 0.0}

    def report(self) -> Report:
        return Report(seconds=self.seconds, is_network=True, counts={"calls": 7, "skipped": 5, "dropped": 4})

    def solve(self, started: Started = lambda: None) -> None:
        impulse = self.sim.contacts.numpy("impulse")
        if self.early:
            impulse *= 0.5
            started()
            self.sim.solve(pause=2)
        else:
            self.sim.solve(pause=0)
            impulse *= 0.5
            self.sim.stats.numpy("replaced")[...] = 1
            started()
        self.seconds["network"] += 0.25
        if self.sim.running.any():
            self.sim.resume(pause=3)
            self.sim.resume()


@pytest.mark.parametrize("early", [True, False])
@pytest.mark.parametrize("loop", ["closed", "open"])
def test_a_start_may_run_the_whole_solve(loop, early):
    """Its start is what the first sweep saw, whether it paused before that or not."""

    class Half(ImpulseStart):
        def write(self) -> None:
            self.sim.contacts.numpy("impulse")[...] *= 0.5

    driven = run_worlds(options(), "half", "none", loop=loop, make=lambda sim: Halved(sim, early))
    plain = run_worlds(options(), "half", "none", loop=loop, make=Half)
    for name in ("sweeps", "change", "contacts", "errors", "decay"):
        np.testing.assert_array_equal(getattr(driven, name), getattr(plain, name))
    assert driven.parts["network"] == 0.25 * SMALL["steps"] and driven.parts["start"] == 0.0 < driven.parts["collide"]
    assert driven.wall_s == pytest.approx(sum(driven.parts.values()))
    assert plain.wall_s == pytest.approx(sum(plain.parts.values()) - plain.strategy_s) and plain.parts["start"] > 0.0
    assert driven.counts == {"calls": 7, "skipped": 5, "dropped": 4} and not plain.counts


def test_names_of_networks(network, monkeypatch, tmp_path):
    """A ContactNet runs the solve, other networks start it; without its weights cnn says so."""
    made = []

    class Learned:
        def __init__(self, sim: Any, model: Any, options: Any) -> None:
            made.append((sim, model, options.middle))

    class Model:
        trunk = head = None  # what corrects a solve in flight has

    read = []
    module = types.SimpleNamespace(LearnedSolve=Learned, CallOptions=types.SimpleNamespace)
    monkeypatch.setitem(sys.modules, "pipeline.starts.learned", module)
    monkeypatch.setattr(registry, "PRETRAINED", tmp_path / "none.safetensors")
    with pytest.raises(OSError, match=r"none\.safetensors is not there"):
        registry.maker("cnn")
    assert isinstance(registry.maker(str(network))(options().simulation("none")), GridNetworkStart)
    monkeypatch.setattr("pipeline.networks.checkpoint.load_checkpoint", lambda path: read.append(path) or (Model(), {}))
    for name in ("cnn", "CNN-start", "x.safetensors"):
        assert registry.is_network(name)
        registry.maker(name)("sim")
    assert [(sim, middle) for sim, _, middle in made] == [("sim", True), ("sim", False), ("sim", True)]
    assert read == [registry.PRETRAINED, registry.PRETRAINED, "x.safetensors"]
    assert not registry.is_network("copy2")


def test_a_step_solves_from_its_start():
    ends = []
    for start in (True, False):
        sim = options().simulation("none")
        for _ in range(SMALL["steps"]):
            if start:
                starting.step(Halved(sim, True), 0.01)
            else:
                sim.step(0.01, start=lambda sim: sim.contacts.numpy("impulse").__imul__(0.5))
        ends.append(sim.state.numpy("position").copy())
    np.testing.assert_array_equal(*ends)


# ---------------------------------------------------------------------- tables and files


def made(start: str = "builtin", sweeps: Any = ((0, 7), (40, 100), (100, 60)), **changed: Any) -> runs.Run:
    values: dict[str, Any] = {
        "start": start,
        "solver": "PGS",
        "max_sweeps": 100,
        "tolerance": 1e-4,
        "sweeps": np.array(sweeps),
        "change": np.full((3, 2), 1e-5),
        "contacts": np.array([[0, 2], [3, 4], [5, 6]]),
        "start_error": (0.5, 0.25),
        "wall_s": 2.0,
        "strategy_s": 0.0,
    }
    return runs.Run(**{**values, **changed})


def test_runs_are_compared_with_builtin_of_their_solver_and_loop():
    base, other = made(), made("copy", ((9, 3), (10, 20), (20, 110)), wall_s=1.0)
    np.testing.assert_array_equal(base.world_means, [70, (7 + 100 + 60) / 3])
    np.testing.assert_array_equal(other.world_means, [15, (3 + 20 + 110) / 3])
    alone, elsewhere = made("bad", solver="PGS + aitken"), made("bad", loop="open")
    rows = runs.summaries([base, other, alone, elsewhere])
    assert rows[0]["over_builtin"] == {
        "sweeps_ratio": 1.0,
        "median_ratio": 1.0,
        "worlds_better": 0,
        "wall_ratio": 1.0,
    }
    found = rows[1]["over_builtin"]
    assert found["sweeps_ratio"] == pytest.approx((3 + 10 + 20 + 20 + 110) / (7 + 40 + 100 + 100 + 60))
    assert found["median_ratio"] == pytest.approx(20 / 60)
    assert found["worlds_better"] == 2 and found["wall_ratio"] == 0.5
    assert rows[2]["over_builtin"] is None and rows[3]["over_builtin"] is None
    assert tables.cells([base, other], tables.EVALUATION_COLUMNS)[1][3:5] == ["15-44", f"{found['sweeps_ratio']:.2f}"]


def test_nothing_to_compare_is_no_error():
    """No contacts at all: no sweeps, no ratio."""
    still = made(sweeps=np.zeros((3, 2), int), contacts=np.zeros((3, 2), int))
    row = runs.summaries([still])[0]
    assert row["over_builtin"]["sweeps_ratio"] is None and row["mean_sweeps"] == 0
    assert json.loads(json.dumps(row)) == row
    assert "Builtin" in tables.table([still], tables.EVALUATION_COLUMNS)


def test_command_evaluate(tmp_path, capsys, network):
    small = ["evaluate", "--worlds", "2", "--bodies", "8", "--steps", "70", "--out", str(tmp_path)]
    starts = ["--starts", "none", "builtin", "grid", f"net={network}"]
    assert main([*small, *starts, "--accelerations", "none", "aitken", "--loops", "closed"]) == 0
    text = capsys.readouterr().out
    for label in ("None, PGS", "Grid, PGS + aitken", "Net, PGS", "closed loop", "/builtin", "MSE normal"):
        assert label in text
    assert main([*small, "--starts", f"net={network}", "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["figures"] == ["closed-pgs.png", "open-pgs.png"]
    assert [(row["start"], row["loop"]) for row in result["runs"]] == [("net", "closed"), ("net", "open")]
    assert json.loads((tmp_path / "evaluate.json").read_text())["runs"] == result["runs"]
    for name in ("closed-pgs.png", "closed-pgs-aitken.png", "open-pgs.png"):
        assert (tmp_path / name).read_bytes()[:4] == PNG


def test_figure_shows_every_run():
    """Without histories, with more starts than colours, one of them without contacts."""
    many = [made(f"start{i}", errors=np.full((3, 2, 2), 0.1)) for i in range(2 * len(style.CYCLE) + 1)]
    many.append(made("still", contacts=np.zeros((3, 2), int), errors=np.full((3, 2, 2), np.nan)))
    styles = {(line["color"], line["marker"]) for line in run_plots.line_styles(many)}
    assert len(styles) == len(many)
    fig = run_plots.evaluation_figure(many, "all")
    texts = {text.get_text() for axes in fig.axes for text in axes.get_yticklabels()}
    assert {"Start0", "Still"} <= texts
