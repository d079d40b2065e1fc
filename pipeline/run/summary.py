"""What a run did, in numbers (``summary.json``) and in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.enums import flag_names
from pipeline.files import plain, versions
from pipeline.run.trajectory import Recording
from pipeline.starts.start import Start


def summarize(start: Start, recording: Recording, config: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers of a run by name; those of sweeps count worlds and steps with joints or pressing contacts.

    Args:
        start: of the simulation at its end.
        recording: what the run has put into its trajectory.
        config: scene and options.
    """
    sim, report, series, done = start.sim, start.report(), recording.series, recording.steps
    worlds, options = sim.model.world_count, config["options"]
    busy = (series["pressing_count"] > 0) | (np.diff(sim.model.numpy("joint_start")) > 0)
    solved = series["sweeps"][busy]
    flags = series["flags"][-1] if done else np.zeros(worlds, np.int32)
    summary = {
        "scene": config["scene"]["name"],
        "complete": recording.complete,
        "steps": done,
        "worlds": worlds,
        "bodies": sim.model.body_count,
        "mean_sweeps": float(solved.mean()) if len(solved) else 0.0,
        "median_sweeps": float(np.median(solved)) if len(solved) else 0.0,
        "unconverged_share": float((solved >= options["max_sweeps"]).mean()) if len(solved) else 0.0,
        "contacts_mean": float(series["pressing_count"].mean()) if done else 0.0,
        "contacts_last": float(series["pressing_count"][-1].mean()) if done else 0.0,
        "penetration_max_mm": 1e3 * float(series["penetration_max"].max(initial=0.0)),
        "penetration_last_mean_mm": 1e3 * float(series["penetration_mean"][-1].mean()) if done else 0.0,
        "flagged_worlds": {str(w): flag_names(flags[w]) for w in np.flatnonzero(flags)},
        "simulation_s": recording.seconds,
        "worlds_per_s": worlds / recording.seconds if recording.seconds and recording.complete else 0.0,
        "capacity": plain(sim.capacity()),
        "memory": plain(sim.memory()),
        "versions": versions(),
        "config": config,
        "out": options["out"],
    }
    if report.is_network:
        summary["network"] = plain(report.to_dict())
    return summary


def describe(summary: dict[str, Any]) -> str:
    """Say what a run did, in a few lines."""
    lines = [
        f"{summary['scene']}: {summary['steps']} steps of {summary['worlds']} world(s), {summary['bodies']} bodies, "
        f"{_seconds(summary['simulation_s'])} of wall time in the simulation"
        + ("" if summary["complete"] else "; interrupted"),
        f"sweeps: mean {summary['mean_sweeps']:.1f}, median {summary['median_sweeps']:.0f}, "
        f"unconverged {100.0 * summary['unconverged_share']:.1f} %, of the steps with contacts or joints",
        f"contacts with an impulse, per world at the end: {summary['contacts_last']:.1f}; "
        f"overlap: largest {summary['penetration_max_mm']:.3g} mm, mean at the end "
        f"{summary['penetration_last_mean_mm']:.3g} mm",
        *(f"world {world} stopped: {flag}" for world, flag in summary["flagged_worlds"].items()),
        *_describe_network(summary.get("network", {})),
        f"{summary['out']}: {', '.join(summary['files'])}",
    ]
    return "\n".join(lines)


def _seconds(value: float) -> str:
    """Show a time with three digits at least, and no digit beyond 0.01 s for longer ones: 0.00123 s, 12.35 s."""
    return f"{value:.3g} s" if value < 1.0 else f"{value:.2f} s"


def _describe_network(network: dict[str, Any]) -> list[str]:
    """Say what a network did, and the wall time of its parts; nothing where there was none."""
    if not network:
        return []
    seconds = ", ".join(f"{part} {_seconds(value)}" for part, value in network["seconds"].items())
    return [network["explain"], f"  wall time: {seconds}"]
