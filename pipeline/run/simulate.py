"""Run a scene and write what happened: ``trajectory.h5``, ``summary.json``, ``summary.png``, a video.

Every file is written under a temporary name and renamed when it is whole.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.runtime.optional import require
from pipeline.files import atomic_path, plain, versions, write_json
from pipeline.options import RunOptions, SolverOptions
from pipeline.process import interruptible, torch_threads
from pipeline.run.trajectory import TrajectoryWriter, measure
from pipeline.scenes import Scene
from pipeline.starts import warmstart


@dataclass(frozen=True, kw_only=True)
class Output:
    """What a run writes."""

    steps: int = 250
    """Steps [1]."""
    start: str = "builtin"
    """Start of the contact solver: none, builtin, random, bad, copy, or copyN, rounded to N decimals; the pretrained
    network: cnn, cnn-start (not in mid-solve); the file of a trained one, .safetensors."""
    out: Path = Path("out/simulate")
    """Folder of the files, made if missing; files of an earlier run are replaced."""
    record_every: int = 1
    """Steps between two records of the bodies [1]."""
    history: bool = False
    """Record the impulse change of every sweep."""
    video: Literal["none", "gif", "mp4"] = "none"
    """Also write an animation of world 0."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        for name, low in (("steps", 0), ("record_every", 1)):
            if getattr(self, name) < low:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be >= {low}")


def simulate(
    scene: Scene,
    run: RunOptions | None = None,
    solver: SolverOptions | None = None,
    output: Output | None = None,
    progress: bool = True,
) -> tuple[dict[str, Any], dc.Simulation]:
    """Run a scene and write its files; Ctrl-C ends it early, with whole files of what was done.

    Args:
        scene: of ``scenes.SCENES``.
        run: worlds, time step, threads, dtype.
        solver: settings of the solver.
        output: steps, start strategy, files.
        progress: show bars on stderr.

    Returns:
        The content of ``summary.json``, and the simulation at its end.

    Raises:
        ValueError: for an option out of its range, or a network that cannot read the simulation.
        OSError: a network's file cannot be read.
        ImportError: naming the extra, without h5py, tqdm or matplotlib.
    """
    run, solver, output = run or RunOptions(), solver or SolverOptions(), output or Output()
    output.check()
    h5py, tqdm = require("h5py", "pipeline"), require("tqdm", "pipeline").tqdm
    from pipeline.plots import plots

    options = {**asdict(run), **asdict(solver), **asdict(output), "out": str(output.out)}
    config = {"scene": {"name": scene.name, **asdict(scene)}, "options": options}
    make = warmstart.maker(output.start, run.seed)
    sim = run.simulation(scene, solver.config(output.history))
    sim.warmup()
    made: Any = make(sim)
    began = time.perf_counter()
    spent = 0.0  # in the simulation itself [s]
    done = 0
    files = ["trajectory.h5", "summary.json", "summary.png"]
    with (
        atomic_path(output.out / files[0]) as partial,
        h5py.File(partial, "w") as file,
        torch_threads(run.threads),
        interruptible() as stop,
    ):
        writer = TrajectoryWriter(file, sim, config)
        writer.add_record(0, 0.0, sim.state)
        bar = tqdm(total=output.steps, desc=f"simulate {scene.name}", unit="step", disable=not progress)
        while done < output.steps and not stop.is_set():
            before = time.perf_counter()
            warmstart.step(sim, run.dt, made)
            spent += time.perf_counter() - before
            done += 1
            measured = measure(sim)
            history = dc.to_numpy(sim.stats.history) if output.history else None
            writer.add_step(measured, history)
            if done % output.record_every == 0 or done == output.steps or stop.is_set():
                writer.add_record(done, done * run.dt, sim.state)
            bar.set_postfix(contacts=int(measured["contact_count"].sum()), refresh=False)
            bar.update()
        bar.close()
        complete = done == output.steps
        series = writer.finish(done, complete)
    busy = (series["pressing_count"] > 0) | (np.diff(sim.model.numpy("joint_start")) > 0)
    solved = series["sweeps"][busy]
    flags = series["flags"][-1] if done else np.zeros(run.worlds, np.int32)
    summary = {
        "scene": scene.name,
        "complete": complete,
        "steps": done,
        "worlds": run.worlds,
        "bodies": sim.model.body_count,
        "mean_sweeps": float(solved.mean()) if len(solved) else 0.0,
        "median_sweeps": float(np.median(solved)) if len(solved) else 0.0,
        "unconverged_share": float((solved >= solver.max_sweeps).mean()) if len(solved) else 0.0,
        "contacts_mean": float(series["pressing_count"].mean()) if done else 0.0,
        "contacts_last": float(series["pressing_count"][-1].mean()) if done else 0.0,
        "penetration_max_mm": 1e3 * float(series["penetration_max"].max(initial=0.0)),
        "penetration_last_mean_mm": 1e3 * float(series["penetration_mean"][-1].mean()) if done else 0.0,
        "flagged_worlds": {str(w): str(dc.Flag(int(flags[w]))) for w in np.flatnonzero(flags)},
        "simulation_s": spent,
        "worlds_per_s": run.worlds / spent if spent and complete else 0.0,
        "capacity": plain(sim.capacity()),
        "memory": plain(sim.memory()),
        "versions": versions(),
        "config": config,
        "out": str(output.out),
    }
    if hasattr(made, "stats"):
        summary["network"] = {**plain(made.stats.totals()), "explain": made.explain()}
    start = Path(output.start).stem if warmstart.is_network(output.start) else output.start
    title = f"{scene.name}: {run.worlds} world{'s' if run.worlds > 1 else ''}, {solver.method}, {solver.acceleration}"
    with atomic_path(output.out / files[2]) as partial:
        plots.save(plots.summary_figure(sim, series, run.dt, f"{title}, start {start}"), partial)
    if output.video != "none":
        files.append(f"video.{output.video}")
        with atomic_path(output.out / files[-1]) as partial:
            plots.animate(
                output.out / files[0], partial, progress=lambda f: tqdm(f, desc="video", disable=not progress)
            )
    summary.update(files=files, wall_s=time.perf_counter() - began)
    write_json(output.out / files[1], summary)
    return summary, sim
