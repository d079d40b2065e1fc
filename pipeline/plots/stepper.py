"""Pictures of steppers: the curves of a training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.plots.style import CYCLE, INK, MARKERS, SKY, figure, legend_below

COLORS = tuple(color for color in CYCLE if color != SKY)
"""Colours of the time steps; sky blue is the training."""


def stepper_curves_figure(rows: Sequence[Mapping[str, float]], title: str) -> Any:
    """Draw loss, error of the velocities for each time step, and rate over the steps of a training.

    Args:
        rows: of ``training.Log``.
        title: of the figure.
    """

    def points(name: str) -> list[tuple[float, float]]:
        return [(row["step"], row[name]) for row in rows if name in row]

    with figure(12.0, 4.4, title) as fig:
        loss, error, rate = fig.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
        for name, style in (
            ("train/loss", {"color": SKY, "linewidth": 0.8, "label": "training"}),
            ("validation/loss", {"color": INK, "marker": "o", "markersize": 4, "label": "validation"}),
        ):
            if found := points(name):
                loss.plot(*zip(*found), **style)
        loss.set(xlabel="step", title="loss", yscale="log")
        legend_below(loss, fontsize=8)
        names = dict.fromkeys(name for row in rows for name in row if name.startswith("validation/velocity_"))
        for i, name in enumerate(names):
            style = {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)], "markersize": 4}
            error.plot(*zip(*points(name)), label=f"dt {name.removeprefix('validation/velocity_')}", **style)
        error.set(xlabel="step", title="error of the velocities /\nthat of no contacts at all", yscale="log")
        if names:
            legend_below(error, fontsize=8)
        if found := points("train/rate"):
            rate.plot(*zip(*found), color=INK)
        rate.set(xlabel="step", title="learning rate")
    return fig
