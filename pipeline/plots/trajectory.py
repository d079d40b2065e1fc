"""Pictures of a run: its summary over time, and an animation of its trajectory."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.model.rules import FINITE, refuse
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.hdf5 import reading
from dc_kernels.runtime.imports import require
from pipeline.plots.style import QUANTITIES, figure, legend_below
from pipeline.plots.world import WorldDrawing, WorldShapes, draw_world
from pipeline.run.model import read_model


def _over_worlds(axes: Any, time: np.ndarray, values: np.ndarray, quantity: str, label: str | None = None) -> None:
    """Draw the median over the worlds of values (steps, worlds), with the band that holds 80 % of them."""
    style = QUANTITIES[quantity]
    if values.shape[1] > 1:
        axes.fill_between(time, *np.percentile(values, (10, 90), axis=1), color=style["color"], alpha=0.15, linewidth=0)
    axes.plot(time, np.median(values, axis=1), label=label, linewidth=1.4, **style)


def summary_figure(sim: Any, series: Mapping[str, np.ndarray], dt: float, title: str) -> Any:
    """Draw the final state of world 0 beside sweeps, contacts, energy and overlap over time.

    Args:
        sim: the simulation at its end.
        series: the per-step arrays of ``pipeline.run.trajectory.STEP_FIELDS``, (steps, worlds).
        dt: time step [s].
        title: of the figure.
    """
    worlds = series["sweeps"].shape[1]
    time = dt * np.arange(1, len(series["sweeps"]) + 1)
    with figure(14.0, 8.6, title) as fig:
        grid = fig.add_gridspec(3, 2, width_ratios=(1.25, 1.0))
        axes = fig.add_subplot(grid[:2, 0])
        draw_world(axes, sim)
        axes.set_title(f"world 0 after {len(time)} steps, {time[-1] if len(time) else 0.0:.2f} s")
        if not len(time):
            return fig
        sweeps, contacts, energy, overlap = (fig.add_subplot(grid[place]) for place in ((2, 0), (0, 1), (1, 1), (2, 1)))
        _over_worlds(sweeps, time, series["sweeps"], "sweeps")
        _over_worlds(contacts, time, series["contact_count"], "contacts", "within reach")
        _over_worlds(contacts, time, series["pressing_count"], "pressing", "that press or overlap")
        kinetic, potential = series["kinetic_energy"], series["potential_energy"]
        _over_worlds(energy, time, kinetic + potential, "total", "total")
        _over_worlds(energy, time, potential, "potential", "potential")
        _over_worlds(energy, time, kinetic, "kinetic", "kinetic")
        _over_worlds(overlap, time, 1e3 * series["penetration_max"], "largest", "largest")
        _over_worlds(overlap, time, 1e3 * series["penetration_mean"], "mean", "mean of the contacts that press")
        panels = {
            "sweeps of the solver": (sweeps, "sweeps of a step"),
            "contacts": (contacts, "number in a world"),
            "energy": (energy, "sum over the bodies [J]"),
            "overlap": (overlap, "depth [mm]"),
        }
        for name, (panel, unit) in panels.items():
            panel.set_title(name + (f" (median and 10-90 % of {worlds} worlds)" if worlds > 1 else ""))
            panel.set(xlim=(0.0, time[-1]), xlabel="time [s]", ylabel=unit)
            legend_below(panel, fontsize=8)
        for panel in (sweeps, contacts, overlap):
            panel.set_ylim(bottom=0.0)
    return fig


def animate(trajectory: Path, target: Path, world: int = 0, rate: float = 25.0, progress: Any = None) -> None:
    """Draw one world of a trajectory, in real time as far as its records allow.

    Args:
        trajectory: file written by ``simulate``.
        target: .gif or .mp4.
        world: index of the world.
        rate: most pictures per second [1/s].
        progress: wraps the list of pictures, as tqdm does.

    Raises:
        ValueError: naming file, dataset and place: damaged, or a model, place or angle that none may have.
        ImportError: naming the extra, without ffmpeg for .mp4.
        OSError: the disk does not take it.
    """
    animation = require("matplotlib.animation", "pipeline")
    with reading(trajectory) as file:
        shapes = WorldShapes.of(read_model(file), world)
        time = file["record/time"][...]
        check_rule("record/time", time, FINITE)
        refuse("record/time", time[1:], ~(np.diff(time) > 0), "later than the one before it", 1)
        every = max(1, round(1.0 / (rate * float(np.diff(time[:2])[0])))) if len(time) > 1 else 1
        records = {len(file[f"record/{name}"]) for name in ("time", "position", "angle")}
        if records != {len(time)} or not len(time):
            raise ValueError(f"record/ has {len(time)} times; there must be as many positions and angles, one at least")
        position, angle = (file[f"record/{name}"][::every, shapes.bodies] for name in ("position", "angle"))
        for name, values in (("position", position), ("angle", angle)):
            check_rule(f"record/{name}", values, FINITE)
    frames = np.arange(len(angle))
    spacing = float(time[every] - time[0]) if len(time) > every else 1.0 / rate
    with figure(7.0, 7.0) as fig:
        axes = fig.add_subplot()

        def state(frame: int) -> tuple[np.ndarray, np.ndarray]:
            return position[frame], angle[frame]

        drawing = WorldDrawing(axes, shapes, *state(0))
        drawing.fit([state(0), state(len(frames) // 2), state(-1)])
        axes.set_title("0.00 s")
        fig.canvas.draw()
        fig.set_layout_engine("none")  # once is enough
        if target.suffix == ".mp4":
            ffmpeg = require("imageio_ffmpeg", "pipeline").get_ffmpeg_exe()
            require("matplotlib", "pipeline").rcParams["animation.ffmpeg_path"] = (
                ffmpeg  # until the figure's block ends
            )
            writer = animation.FFMpegWriter(fps=min(rate, 1.0 / spacing))
        else:
            writer = animation.PillowWriter(fps=min(rate, 1.0 / spacing))
        try:
            with writer.saving(fig, str(target), dpi=90):
                for frame in progress(frames) if progress else frames:
                    drawing.update(*state(int(frame)))
                    axes.set_title(f"{time[frame * every]:.2f} s")
                    writer.grab_frame()
        except subprocess.CalledProcessError as error:
            raise OSError(f"ffmpeg ended with status {error.returncode}, as it does on a full disk") from error
