"""Run a scene and write what happened: ``trajectory.h5``, ``summary.json``, ``summary.png``, a video.

Every file is written under a temporary name and renamed when it is whole; the trajectory grows with the run, and a run
that fails leaves its steps so far.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import dc_kernels as dc
from dc_kernels.model.settings import Count, Settings, Whole
from pipeline.files import atomic_path, check_writable, write_json
from pipeline.options import RunOptions, SolverOptions
from pipeline.plots.style import save_figure
from pipeline.plots.trajectory import animate, summary_figure
from pipeline.process import interruptible, progress_bar, torch_threads
from pipeline.run.summary import summarize
from pipeline.run.trajectory import Recording, TrajectoryWriter, measure
from pipeline.scenes import Scene
from pipeline.starts.registry import is_network
from pipeline.starts.start import Start, step
from pipeline.stepper.choice import StepperOptions
from pipeline.stepper.registry import DEFAULT_START, PRETRAINED, solve_maker

TRAJECTORY, SUMMARY, PICTURE = "trajectory.h5", "summary.json", "summary.png"


@dataclass(frozen=True, kw_only=True)
class Output(Settings):
    """Options of a run and its files."""

    steps: Whole = 250
    """Steps of each world [1]."""
    start: str = DEFAULT_START
    """Start of the contact solver: none, builtin, random, bad, copy, or copyN, rounded to N decimals; grid or
    grid-bilinear, copy sent to a grid and back; the pretrained network: cnn, cnn-start (not in mid-solve); the file of
    a trained one, .safetensors."""
    out: Path = Path("out/simulate")
    """Output folder, made if missing; files of an earlier run are replaced."""
    record_every: Count = 1
    """Steps between two records of the bodies [1]."""
    history: bool = False
    """Record the impulse change of every sweep."""
    video: Literal["none", "gif", "mp4"] = "none"
    """Also write a video of world 0."""


def simulate(
    scene: Scene,
    run: RunOptions | None = None,
    solver: SolverOptions | None = None,
    output: Output | None = None,
    progress: bool = True,
    *,
    stepping: StepperOptions | None = None,
) -> tuple[dict[str, Any], dc.Simulation]:
    """Run a scene and write its files; Ctrl-C ends it early, with whole files of what was done.

    Args:
        scene: what is run.
        run: worlds, time step, threads, dtype.
        solver: settings of the solver.
        output: steps, start, files.
        progress: show bars on stderr.
        stepping: who makes the velocities of a step; None: the solver.

    Returns:
        The content of ``summary.json``, and the simulation at its end.

    Raises:
        ValueError: for an option out of its range, or a network that cannot read the simulation.
        OSError: a network's file cannot be read, or a file cannot be written: known before the run, unless the disk
            fills up in it; the trajectory then keeps the steps so far.
        ImportError: naming the extra, without h5py, tqdm or matplotlib.
    """
    run, solver, output = run or RunOptions(), solver or SolverOptions(), output or Output()
    stepping = stepping or StepperOptions()
    options = {**asdict(run), **solver.named(), **asdict(output), "out": str(output.out)}
    config = {"scene": {"name": scene.name, **asdict(scene)}, "options": options}
    if stepping.stepper == "network":
        weights = None if stepping.weights is None else str(stepping.weights)
        options.update(stepper="network", weights=weights, project=stepping.project, energy=stepping.energy)
    make = solve_maker(stepping, output.start, run.seed)
    sim = run.simulation(scene, solver.config(output.history))
    video = [] if output.video == "none" else [f"video.{output.video}"]
    check_writable(output.out, TRAJECTORY, SUMMARY, PICTURE, *video)
    sim.warmup()
    start = make(sim)
    began = time.perf_counter()
    recording = record(start, run, output, config, progress)
    summary = summarize(start, recording, config)
    draw(sim, recording, config, output, progress)
    summary.update(files=[TRAJECTORY, SUMMARY, PICTURE, *video], wall_s=time.perf_counter() - began)
    write_json(output.out / SUMMARY, summary)
    return summary, sim


def record(start: Start, run: RunOptions, output: Output, config: dict[str, Any], progress: bool) -> Recording:
    """Step a simulation and write its trajectory, until all steps are done or Ctrl-C ends it.

    A step that then takes longer than ``process.PATIENCE`` is broken off, and not recorded.

    Args:
        start: of the simulation that is stepped.
        run: time step and threads.
        output: steps, and what is recorded.
        config: scene and options, for the file.
        progress: show a bar on stderr.

    Raises:
        OSError: the disk does not take the trajectory; the steps so far are in it.
    """
    sim, done, spent = start.sim, 0, 0.0
    name = config["scene"]["name"]
    with (
        TrajectoryWriter(output.out / TRAJECTORY, sim, config) as writer,
        torch_threads(run.threads),
        interruptible() as stop,
        progress_bar(total=output.steps, desc=f"simulate {name}", unit="step", show=progress) as bar,
    ):
        while done < output.steps and not stop.is_set():
            before = time.perf_counter()
            try:
                with stop.urgent():
                    step(start, run.dt)
            except KeyboardInterrupt:
                if not stop.is_set():
                    raise
                break  # the step is not recorded
            spent += time.perf_counter() - before
            done += 1
            measured = measure(sim)
            writer.add_step(measured, dc.to_numpy(sim.stats.history) if output.history else None)
            if done % output.record_every == 0 or done == output.steps or stop.is_set():
                writer.add_record(done, done * run.dt, sim.state)
            writer.commit_if_due()
            pressing = int(measured["pressing_count"].sum())
            bar.set_postfix_str(f"{pressing} contacts press", refresh=False)
            bar.update()
        complete = done == output.steps
        series = writer.finish(complete)
    return Recording(steps=done, complete=complete, seconds=spent, series=series)


def draw(sim: dc.Simulation, recording: Recording, config: dict[str, Any], output: Output, progress: bool) -> None:
    """Draw the picture of the summary and, on request, the animation of the trajectory that has been written."""
    options, worlds = config["options"], config["options"]["worlds"]
    start = f"start {Path(output.start).stem if is_network(output.start) else output.start}"
    if "stepper" in options:
        start = f"stepped by {Path(options['weights'] or PRETRAINED).stem}, project {options['project']}"
    title = (
        f"{config['scene']['name']}: {worlds} world{'s' if worlds > 1 else ''}, {options['method']}, "
        f"{options['acceleration']}, {start}"
    )
    save_figure(summary_figure(sim, recording.series, options["dt"], title), output.out / PICTURE)
    if output.video != "none":
        with atomic_path(output.out / f"video.{output.video}") as partial:
            animate(
                output.out / TRAJECTORY,
                partial,
                progress=lambda frames: progress_bar(frames, desc="video", show=progress),
            )
