"""The command line ``deep-contact``: simulate, demo, protocol, evaluate, explain, figures, generate, train, fclib.

Options are the fields of the dataclasses below, which tyro turns into flags.
"""

from __future__ import annotations

import functools
import itertools
import json
import operator
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

from dc_kernels.grid.grid import Grid
from dc_kernels.model.config import SolverConfig
from dc_kernels.runtime.optional import require
from pipeline.contactnet.options import ContactTrainOptions
from pipeline.data import generate
from pipeline.data.recipe import GenerateOptions, Recipe, load_recipe
from pipeline.evaluate import evaluate
from pipeline.fclib.runs import ExportOptions, SolveOptions, describe_export, describe_solve, export, solve_files
from pipeline.files import atomic_path, write_json
from pipeline.options import RunOptions, SolverOptions
from pipeline.plots import grids as grid_plots
from pipeline.plots import kernels as figures
from pipeline.plots import plots
from pipeline.plots import runs as run_plots
from pipeline.process import torch_threads
from pipeline.run.simulate import Output, simulate
from pipeline.scenes import AnyScene, Thesis
from pipeline.starts import warmstart
from pipeline.training.train import NetworkName, TrainOptions, describe_training, train

try:
    from tyro.conf import Positional
except ImportError:  # parse() says what is missing
    Positional = Annotated  # type: ignore[assignment,misc]


@dataclass(frozen=True, kw_only=True)
class Common:
    """What every command takes."""

    json: bool = False
    """Print one line of JSON last, and no progress bar."""


@dataclass(frozen=True, kw_only=True)
class Simulate(Common):
    """Run a scene; write trajectory.h5, summary.json, summary.png and, on request, a video."""

    scene: AnyScene
    """What to run; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    output: Output = field(default_factory=Output)

    def __call__(self) -> dict[str, Any]:
        summary, _ = simulate(self.scene, self.run, self.solver, self.output, progress=not self.json)
        if not self.json:
            print(describe(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """The thesis protocol: None, Builtin, Copy and ContactNet, then accelerated; a table, its plots, and a world."""

    out: Path = Path("out/demo")
    """Folder of demo.png, protocol.png, protocol.json, grids.png and, in world/, the files of the world shown."""
    worlds: int = 10
    """Worlds of the protocol [1]."""
    bodies: int = 100
    """Discs in each world [1]."""
    steps: int = 250
    """Steps [1]."""
    threads: int = 1
    """Threads that share the worlds [1]."""

    def __call__(self) -> dict[str, Any]:
        began = time.perf_counter()
        options = evaluate.ProtocolOptions(
            worlds=self.worlds, bodies=self.bodies, steps=self.steps, threads=self.threads
        )
        pairs: list[tuple[str, evaluate.Acceleration]] = [(start, "none") for start in options.starts]
        pairs += [("cnn", "none"), ("none", "aitken"), ("builtin", "aitken"), ("cnn", "aitken")]
        runs, result = run_protocol(options, pairs, self.out, self.json)
        summary, sim = simulate(
            Thesis(bodies=self.bodies),
            RunOptions(seed=options.seed),
            output=Output(out=self.out / "world", steps=self.steps),
            progress=not self.json,
        )
        title = f"{self.bodies} discs fall into a box: {self.worlds} worlds, {self.steps} steps of {options.dt:g} s"
        with atomic_path(self.out / "demo.png") as partial:
            plots.save(run_plots.demo_figure(sim, runs, title), partial)
        side = Thesis(bodies=self.bodies).side
        grid = Grid.from_box((0.0, 0.0), (side, side), Grid.thesis().spacing)
        with atomic_path(self.out / "grids.png") as partial:
            plots.save(grid_plots.grids_figure(sim, grid), partial)
        result.update(world=summary, wall_s=time.perf_counter() - began)
        if not self.json:
            print(f"{self.out / 'grids.png'}: what a network reads of that world's end, and what it is to answer")
            print(f"{self.out / 'demo.png'}: the picture of it all; {result['wall_s']:.0f} s")
        return result


@dataclass(frozen=True, kw_only=True)
class Protocol(Common):
    """Run the thesis protocol: compare start strategies, print the table, draw the theses' plots."""

    protocol: evaluate.ProtocolOptions = field(default_factory=evaluate.ProtocolOptions)
    out: Path = Path("out/protocol")
    """Folder of protocol.json and protocol.png."""

    def __call__(self) -> dict[str, Any]:
        return run_protocol(self.protocol, None, self.out, self.json)[1]


@dataclass(frozen=True, kw_only=True)
class Evaluate(Common):
    """Compare start strategies and trained networks on held-out worlds: tables, all plots of the theses."""

    evaluation: evaluate.EvaluationOptions = field(default_factory=evaluate.EvaluationOptions)
    out: Path = Path("out/evaluate")
    """Folder of evaluate.json and a figure for each loop and solver."""

    def __call__(self) -> dict[str, Any]:
        return run_evaluation(self.evaluation, self.out, self.json)


@dataclass(frozen=True, kw_only=True)
class Explain(Common):
    """Say what runs for a scene, what is skipped, and why."""

    scene: AnyScene
    """What to explain; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    start: str = "builtin"
    """Start of the contact solver, as for simulate; a network says how often it is called, and why not."""
    steps: int = 100
    """Steps that are run first where a network is the start: its calls depend on them [1]."""

    def __call__(self) -> dict[str, Any]:
        text = explain(self.scene, self.run, self.solver, self.start, self.steps)
        if not self.json:
            print(text)
        return {"scene": self.scene.name, "explain": text}


@dataclass(frozen=True, kw_only=True)
class Figures(Common):
    """Draw a figure of the seed again: "kernels" compares the smoothing kernels (figures 3.3 and 3.4)."""

    figure: Positional[Literal["kernels"]]
    """Which figure."""
    out: Path = Path("out/figures")
    """Folder of the PNG."""

    def __call__(self) -> dict[str, Any]:
        path = figures.draw(self.figure, self.out)
        if not self.json:
            print(path)
        return {"figure": self.figure, "path": str(path)}


@dataclass(frozen=True, kw_only=True)
class Generate(Common):
    """Make a data set: worlds on all cores, each state with its label; or go on with one that was cut short."""

    scene: AnyScene = field(default_factory=Thesis)
    """What stands in the worlds; each scene has options of its own."""
    options: GenerateOptions = field(default_factory=GenerateOptions)
    solver: SolverConfig = field(default_factory=SolverConfig)
    config: Path | None = None
    """TOML file of options, with tables scene, ranges and solver: its values take the place of the defaults here."""
    out: Path = Path("out/data")
    """Folder of the shards and of index.h5."""
    threads: int = 0
    """Shards made at once; 0: one for each core [1]."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://..., whose workers make the shards instead."""

    def __call__(self) -> dict[str, Any]:
        recipe = Recipe(scene=self.scene, options=self.options, solver=self.solver)
        summary = generate.generate(recipe, self.out, self.threads, self.scheduler, progress=not self.json)
        if not self.json:
            print(generate.report(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class Train(Common):
    """Train a network of the theses on a data set; write network, state to resume from, curves and predictions."""

    network: Positional[NetworkName]
    """Which network."""
    training: TrainOptions = field(default_factory=TrainOptions)

    def __call__(self) -> dict[str, Any]:
        summary = train(self.network, self.training, progress=not self.json)
        if not self.json and "files" in summary:  # the first of several processes
            print(describe_training(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class TrainContactnet(Common):
    """Train ContactNet, which corrects solves in flight, on the calls that it makes itself; no data set is needed."""

    training: ContactTrainOptions = field(default_factory=ContactTrainOptions)

    def __call__(self) -> dict[str, Any]:
        from pipeline.contactnet.training import describe_contact_training, train_contactnet

        summary = train_contactnet(self.training, progress=not self.json)
        if not self.json and summary:
            print(describe_contact_training(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class Export:
    """Simulate a scene and write contact problems of some steps as FCLIB files."""

    scene: AnyScene
    """What to run; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    export: ExportOptions = field(default_factory=ExportOptions)

    def __call__(self, progress: bool) -> tuple[dict[str, Any], str]:
        result = export(self.scene, self.run, self.solver, self.export, progress)
        return result, describe_export(result)


@dataclass(frozen=True, kw_only=True)
class Solve:
    """Solve the contact problem of an FCLIB file, or those of all files of a folder."""

    path: Positional[Path]
    """File or folder."""
    options: SolveOptions = field(default_factory=SolveOptions)

    def __call__(self, progress: bool) -> tuple[dict[str, Any], str]:
        result = solve_files(self.path, self.options, progress)
        return result, describe_solve(result)


@dataclass(frozen=True, kw_only=True)
class Fclib(Common):
    """Contact problems in FCLIB's HDF5 layout: export those of a scene, solve those of others."""

    action: Export | Solve
    """What to do."""

    def __call__(self) -> dict[str, Any]:
        result, text = self.action(not self.json)
        if not self.json:
            print(text)
        return result


Command = Simulate | Demo | Protocol | Evaluate | Explain | Figures | Generate | Train | TrainContactnet | Fclib


def run_protocol(
    options: evaluate.ProtocolOptions,
    pairs: Sequence[tuple[str, evaluate.Acceleration]] | None,
    out: Path,
    quiet: bool,
) -> tuple[list[evaluate.Run], dict[str, Any]]:
    """Run the protocol, write protocol.json and protocol.png, and print the table unless ``quiet``."""
    runs = evaluate.protocol(options, pairs, progress=not quiet)
    result = {**evaluate.report(options, runs), "out": str(out)}
    write_json(out / "protocol.json", result)
    title = f"thesis protocol: {options.worlds} worlds of {options.bodies} discs, start and solver"
    with atomic_path(out / "protocol.png") as partial:
        plots.save(run_plots.protocol_figure(runs, title), partial)
    if not quiet:
        print(f"\n{evaluate.table(runs)}\n\n{out / 'protocol.png'}: the plots of the theses")
    return runs, result


def run_evaluation(options: evaluate.EvaluationOptions, out: Path, quiet: bool) -> dict[str, Any]:
    """Evaluate, write evaluate.json and the figures, and print the tables unless ``quiet``."""
    runs = evaluate.evaluation(options, progress=not quiet)
    result = {**evaluate.report(options, runs), "out": str(out), "figures": []}
    for loop in dict.fromkeys(run.loop for run in runs):
        for solver in dict.fromkeys(run.solver for run in runs):
            chosen = [run for run in runs if (run.loop, run.solver) == (loop, solver)]
            path = out / f"{loop}-{solver.lower().replace(' + ', '-')}.png"
            worlds = f"{options.worlds} worlds of {options.bodies} discs, {options.steps} steps of {options.dt:g} s"
            with atomic_path(path) as partial:
                plots.save(run_plots.evaluation_figure(chosen, f"{solver}, {loop} loop: {worlds}"), partial)
            result["figures"].append(path.name)
            if not quiet:
                print(f"\n{loop} loop, {run_plots.PATHS[loop]}\n{evaluate.table(chosen, evaluate.EVALUATION)}\n{path}")
    write_json(out / "evaluate.json", result)
    return result


def describe(summary: dict[str, Any]) -> str:
    """What a run did, in a few lines."""
    lines = [
        f"{summary['scene']}: {summary['steps']} steps of {summary['worlds']} world(s), {summary['bodies']} bodies, "
        f"{summary['simulation_s']:.2f} s in the simulation" + ("" if summary["complete"] else "; interrupted"),
        f"sweeps: mean {summary['mean_sweeps']:.1f}, median {summary['median_sweeps']:.0f}, "
        f"unconverged {100.0 * summary['unconverged_share']:.1f} %, of the steps with contacts or joints",
        f"contacts of a world at the end: {summary['contacts_last']:.1f}; "
        f"overlap: largest {summary['penetration_max_mm']:.3g} mm, mean at the end "
        f"{summary['penetration_last_mean_mm']:.3g} mm",
        *(f"world {world} stopped: {flag}" for world, flag in summary["flagged_worlds"].items()),
        *describe_network(summary.get("network", {})),
        f"{summary['out']}: {', '.join(summary['files'])}",
    ]
    return "\n".join(lines)


def describe_network(network: dict[str, Any]) -> list[str]:
    """What a network in the loop of the solve did, and the wall time of its parts; nothing without one."""
    if not network:
        return []
    seconds = ", ".join(f"{part} {value:.2f} s" for part, value in network["seconds"].items())
    return [network["explain"], f"  wall time: {seconds}"]


def explain(scene: AnyScene, run: RunOptions, solver: SolverOptions, start: str, steps: int) -> str:
    """What runs for a scene as it stands; with a network as start, what it did in the first steps.

    Raises:
        ValueError: for an option out of its range, or an unknown start.
        OSError: a network's file cannot be read.
    """
    if steps < 0:
        raise ValueError(f"steps is {steps}; it must be >= 0")
    make = warmstart.maker(start, run.seed)
    sim = run.simulation(scene, solver.config())
    made: Any = make(sim)
    if not hasattr(made, "explain"):
        return sim.explain()
    with torch_threads(run.threads):
        for _ in range(steps):
            warmstart.step(sim, run.dt, made)
    return f"{sim.explain()}\n{made.explain()}"


def parse(arguments: Sequence[str] | None = None) -> Any:
    """The command that a command line describes; calling it runs it. Exits with 2 where it is not understood."""
    tyro = require("tyro", "pipeline")
    conf = tyro.conf
    config = (
        conf.OmitArgPrefixes,
        conf.OmitSubcommandPrefixes,
        conf.CascadeSubcommandArgs,
        conf.FlagCreatePairsOff,
    )
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    return tyro.cli(_commands(conf, arguments), prog="deep-contact", args=arguments, config=config)


def _commands(conf: Any, arguments: Sequence[str]) -> Any:
    """The commands, that of data sets with the values of the TOML file it is given as defaults."""
    given = [*arguments, ""]
    files = [a.partition("=")[2] or b for a, b in itertools.pairwise(given) if a.partition("=")[0] == "--config"]
    if given[0] != "generate" or not any(files):
        return Command
    recipe = load_recipe(Path(files[-1]))
    default = Generate(
        scene=cast(Any, recipe.scene), options=recipe.options, solver=recipe.solver, config=Path(files[-1])
    )
    own = Annotated[Generate, conf.subcommand(default=default)]
    return functools.reduce(operator.or_, [own if command is Generate else command for command in get_args(Command)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, or exit with 2 (130 if interrupted) after one line on stderr."""
    try:
        command = parse(arguments)
        result = command()
    except (ValueError, ImportError, OSError) as error:
        print(f"deep-contact: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("deep-contact: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    if command.json:
        print(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
