"""Pictures of the training of a ContactNet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dc_kernels.runtime.imports import require
from pipeline.plots.style import CYCLE, INK, LINES, MARKERS, MUTED, SKY, VERMILION, figure, legend_below

COLORS = tuple(color for color in CYCLE if color not in (SKY, MUTED))
"""Colours of what is validated: sky blue is the training, grey the reference."""
SHOWN = 0.995
"""Quantile of the true corrections to which the axes reach [1]."""


def curve_label(name: str) -> str:
    """Say a name of validation in words: "validation/after_20", "validation/aitken_100", "validation/gain"."""
    kind, _, number = name.removeprefix("validation/").partition("_")
    if kind == "after":
        return f"all, {number} sweeps after the call"
    if not number:
        return "all"
    return f"{'plain' if kind == 'none' else kind.capitalize()}, {number} discs"


def contact_curves_figure(rows: Sequence[Mapping[str, float]], title: str) -> Any:
    """Draw the error left over that of an even share of Aitken's step, by step.

    Args:
        rows: of ``training.Log``.
        title: of the figure.
    """
    with figure(11.0, 4.4, title) as fig:
        left, right = fig.subplots(1, 2, width_ratios=(2.0, 1.0))
        names = dict.fromkeys(name for row in rows for name in row if name.startswith("validation/"))
        points = [(row["step"], row["train/gain"]) for row in rows if "train/gain" in row]
        if points:
            left.plot(*zip(*points), color=SKY, linewidth=0.8, label="training")
        for i, name in enumerate(names):
            points = [(row["step"], row[name]) for row in rows if name in row]
            turn, color = divmod(i, len(COLORS))
            style = {"color": COLORS[color], "marker": MARKERS[i % len(MARKERS)], "linestyle": LINES[turn % len(LINES)]}
            left.plot(*zip(*points), markersize=4, label=curve_label(name), **style)
        left.axhline(0.0, color=MUTED, linewidth=1.0)
        left.set(xlabel="step", title="gain of the network")
        left.set_ylabel("log of the error left / that of an even share,\nmean over the calls")
        legend_below(left, fontsize=8)
        points = [(row["step"], row["train/rate"]) for row in rows if "train/rate" in row]
        if points:
            right.plot(*zip(*points), color=INK)
        right.set(xlabel="step", title="learning rate")
    return fig


def contact_predictions_figure(before: np.ndarray, after: np.ndarray, label: np.ndarray, title: str) -> Any:
    """Draw corrections of one call against the true ones; a perfect answer lies on the diagonal.

    Args:
        before: impulses before the call, (M, 2) [N s].
        after: after it.
        label: true ones.
        title: of the figure.
    """
    colors = require("matplotlib.colors", "pipeline")
    with figure(11.0, 5.2, title) as fig:
        for i, (axes, name) in enumerate(zip(fig.subplots(1, 2), ("normal", "tangential"))):
            true, found = label[:, i] - before[:, i], after[:, i] - before[:, i]
            most = max(float(np.quantile(np.abs(true), SHOWN)), 1e-12)
            edges = np.linspace(-most, most, 101)
            count, _, _ = np.histogram2d(np.clip(true, -most, most), np.clip(found, -most, most), bins=(edges, edges))
            norm = colors.LogNorm(1.0, max(float(count.max()), 2.0))
            mesh = axes.pcolormesh(edges, edges, np.ma.masked_equal(count.T, 0.0), cmap="viridis", norm=norm)
            axes.plot((-most, most), (-most, most), color=VERMILION, linewidth=1.0)
            left = float(((true - found) ** 2).sum() / max((true**2).sum(), 1e-30))
            axes.set_title(f"{name}, {len(true):,} contacts\nsquared error {left:.2f} of that before")
            axes.set(xlabel="true correction [N s]", ylabel="correction by the network [N s]")
            axes.set_box_aspect(1.0)
            bar = fig.colorbar(mesh, ax=axes, pad=0.01, aspect=28)
            bar.set_label("contacts")
            bar.outline.set_visible(False)
    return fig
