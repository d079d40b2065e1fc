"""Commands that compare starts and networks on the thesis worlds: ``protocol``, ``evaluate`` and ``demo``."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dc_kernels.grid.grid import Grid
from dc_kernels.model.settings import Count
from pipeline.commands.common import Common
from pipeline.evaluate.comparison import evaluation, protocol, report
from pipeline.evaluate.options import Acceleration, EvaluationOptions, ProtocolOptions
from pipeline.evaluate.runs import PATHS, Run
from pipeline.evaluate.tables import EVALUATION_COLUMNS, table
from pipeline.files import check_writable, write_json
from pipeline.options import RunOptions
from pipeline.plots.grids import grids_figure
from pipeline.plots.protocol import demo_figure, evaluation_figure, protocol_figure
from pipeline.plots.style import save_figure
from pipeline.run.simulate import Output, simulate
from pipeline.scenes import Thesis


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Run the thesis protocol, plain and accelerated, and one of its worlds; print the table and draw the plots."""

    out: Path = Path("out/demo")
    """Folder of demo.png, protocol.png, protocol.json, grids.png and, in world/, the files of the world shown."""
    worlds: Count = 10
    """Worlds of the protocol [1]."""
    bodies: Count = 100
    """Discs in each world [1]."""
    steps: Count = 250
    """Steps of each world [1]."""
    threads: Count = 1
    """Number of threads that share the worlds [1]."""

    def __call__(self) -> dict[str, Any]:
        began = time.perf_counter()
        options = ProtocolOptions(worlds=self.worlds, bodies=self.bodies, steps=self.steps, threads=self.threads)
        pairs: list[tuple[str, Acceleration]] = [(start, "none") for start in options.starts]
        pairs += [("cnn", "none"), ("none", "aitken"), ("builtin", "aitken"), ("cnn", "aitken")]
        runs, result = run_protocol(options, pairs, self.out, self.json)
        if not result["complete"]:
            return result
        summary, sim = simulate(
            Thesis(bodies=self.bodies),
            RunOptions(seed=options.seed),
            output=Output(out=self.out / "world", steps=self.steps),
            progress=not self.json,
        )
        title = f"{self.bodies} discs fall into a box: {self.worlds} worlds, {self.steps} steps of {options.dt:g} s"
        save_figure(demo_figure(sim, runs, title), self.out / "demo.png")
        side = Thesis(bodies=self.bodies).side
        grid = Grid.from_box((0.0, 0.0), (side, side), Grid.thesis().spacing)
        save_figure(grids_figure(sim, grid), self.out / "grids.png")
        result.update(world=summary, complete=summary["complete"], wall_s=time.perf_counter() - began)
        if not self.json:
            print(f"{self.out / 'grids.png'}: input and target of a network at the end of that world")
            print(f"{self.out / 'demo.png'}: all results in one picture; {result['wall_s']:.0f} s")
        return result


@dataclass(frozen=True, kw_only=True)
class Protocol(Common):
    """Run the thesis protocol: compare starts, print the table, draw the theses' plots."""

    protocol: ProtocolOptions = field(default_factory=ProtocolOptions)
    out: Path = Path("out/protocol")
    """Folder of protocol.json and protocol.png."""

    def __call__(self) -> dict[str, Any]:
        return run_protocol(self.protocol, None, self.out, self.json)[1]


@dataclass(frozen=True, kw_only=True)
class Evaluate(Common):
    """Compare starts and trained networks on held-out worlds; write tables and all plots of the theses."""

    evaluation: EvaluationOptions = field(default_factory=EvaluationOptions)
    out: Path = Path("out/evaluate")
    """Folder of evaluate.json and a figure for each loop and solver."""

    def __call__(self) -> dict[str, Any]:
        return run_evaluation(self.evaluation, self.out, self.json)


class Runs(list[Run]):
    """Runs that are done.

    Attributes:
        complete: whether these are all.
    """

    complete = False


@contextlib.contextmanager
def several() -> Iterator[Runs]:
    """Give a list for runs; Ctrl-C ends the block, unless none is done."""
    runs = Runs()
    try:
        yield runs
    except KeyboardInterrupt:
        if not runs:
            raise


def run_protocol(
    options: ProtocolOptions,
    pairs: Sequence[tuple[str, Acceleration]] | None,
    out: Path,
    quiet: bool,
) -> tuple[list[Run], dict[str, Any]]:
    """Run the protocol, write protocol.json and protocol.png, and print the table unless ``quiet``."""
    check_writable(out, "protocol.json", "protocol.png")
    with several() as runs:
        protocol(options, pairs, not quiet, runs)
        runs.complete = True
    result = {**report(options, runs, runs.complete), "out": str(out)}
    write_json(out / "protocol.json", result)
    title = f"thesis protocol: {options.worlds} worlds of {options.bodies} discs, start and solver"
    save_figure(protocol_figure(runs, title), out / "protocol.png")
    if not quiet:
        print(f"\n{table(runs)}\n\n{out / 'protocol.png'}: the plots of the theses")
    return runs, result


def run_evaluation(options: EvaluationOptions, out: Path, quiet: bool) -> dict[str, Any]:
    """Evaluate, write evaluate.json and the figures, and print the tables unless ``quiet``."""
    check_writable(out, "evaluate.json")
    with several() as runs:
        evaluation(options, None, not quiet, runs)
        runs.complete = True
    result = {**report(options, runs, runs.complete), "out": str(out), "figures": []}
    for loop in dict.fromkeys(run.loop for run in runs):
        for solver in dict.fromkeys(run.solver for run in runs):
            chosen = [run for run in runs if (run.loop, run.solver) == (loop, solver)]
            if not chosen:
                continue
            path = out / f"{loop}-{solver.lower().replace(' + ', '-')}.png"
            worlds = f"{options.worlds} worlds of {options.bodies} discs, {options.steps} steps of {options.dt:g} s"
            save_figure(evaluation_figure(chosen, f"{solver}, {loop} loop: {worlds}"), path)
            result["figures"].append(path.name)
            if not quiet:
                print(f"\n{loop} loop, {PATHS[loop]}\n{table(chosen, EVALUATION_COLUMNS)}\n{path}")
    write_json(out / "evaluate.json", result)
    return result
