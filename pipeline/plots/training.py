"""Pictures of a training: its curves, and what the network predicts against what is true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.grid.channels import IMPULSES
from dc_kernels.grid.grid import Grid
from dc_kernels.runtime.imports import require
from pipeline.plots.grids import LINEAR, POSITIVE_MAP, SIGNED_MAP, ticks
from pipeline.plots.style import BLUE, COMPONENTS, INK, MUTED, SKY, VERMILION, figure, legend_below

if TYPE_CHECKING:
    from pipeline.training.rate import RateSearch

NAMES = {"impulse_n": "normal", "impulse_t": "tangential"}
BINS = 90
"""Bins of a histogram along each axis [1]."""
KNEE = 0.02
"""Share of the largest impulse up to which the axes are about linear, logarithmic beyond [1]."""
FAINT = 0.01
"""Share of the largest impulse below which a node is left white [1]."""
TINY = 1e-12
MARKED: dict[str, Any] = {"marker": "o", "markersize": 3.5}
# what a network's figures are compared with
REFERENCES: dict[str, dict[str, Any]] = {
    "zero": {"color": MUTED, "linestyle": "-", "linewidth": 1.0, "label": "zero impulses"},
    "cache": {"color": MUTED, "linestyle": "--", "linewidth": 1.2, "label": "cached impulses"},
    "grid": {"color": MUTED, "linestyle": ":", "linewidth": 1.4, "label": "solution through the grid"},
}
DENSITY_MAP = "viridis"


@dataclass(frozen=True)
class Prediction:
    """What a network answers at the contacts of a batch, and on the grid of one world."""

    impulse: np.ndarray
    """Predicted impulses, (M, 2) [N s]."""
    label: np.ndarray
    """True impulses, (M, 2) [N s]."""
    floor: np.ndarray
    """True impulses sent to the grid and back, (M, 2) [N s]."""
    grid: Grid
    """Where the nodes lie."""
    answer: np.ndarray
    """Predicted image of one world, its bins summed, (2, rows, columns) [N s]."""
    target: np.ndarray
    """Image of the labels of that world, (2, rows, columns) [N s]."""
    points: np.ndarray
    """Contact points of that world, (m, 2) [m]."""
    title: str
    """Seed and step of that world, in words."""


def curves_figure(rows: Sequence[Mapping[str, float]], title: str) -> Any:
    """Draw loss, error at the contacts, and rate over the steps.

    Args:
        rows: of ``training.Log``: "step" and the names "train/loss", "train/rate", "validation/...".
        title: of the figure.
    """

    def draw(axes: Any, name: str, **style: Any) -> None:
        points = [(row["step"], row[name]) for row in rows if name in row]
        if points:
            axes.plot(*zip(*points), **style)

    with figure(13.0, 4.6, title) as fig:
        loss, error, rate = fig.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
        draw(loss, "train/loss", color=SKY, linewidth=1.0, label="training, mean of the steps")
        draw(loss, "validation/loss", color=BLUE, **MARKED, label="validation")
        for kind, style in REFERENCES.items():
            draw(loss, f"validation/loss_{kind}", **style)
        for name in NAMES.values():
            own = COMPONENTS[name]
            draw(error, f"validation/{name}", **{**own, "markersize": 4}, label=name)
            for kind, style in REFERENCES.items():
                draw(error, f"validation/{name}_{kind}", **{**style, "color": own["color"], "label": None})
        error.axhline(1.0, **REFERENCES["zero"])
        for kind in ("cache", "grid"):
            error.plot([], [], **REFERENCES[kind])
        draw(rate, "train/rate", color=INK, **({} if any("train/rate" in row for row in rows[3:]) else MARKED))
        panels = (
            (loss, "loss", "mean over the states [1]"),
            (error, "squared error at the contacts / that of zero", "sum over the contacts / sum of zero's [1]"),
            (rate, "learning rate", "rate [1]"),
        )
        for axes, name, unit in panels:
            axes.set(title=name, yscale="log", xlabel="step", ylabel=unit)
            legend_below(axes, columns=2)
    return fig


def rates_figure(search: RateSearch) -> Any:
    """Draw the smoothed loss of the rate finder over the rate, and the rate that it chose."""
    with figure(6.5, 4.2) as fig:
        axes = fig.subplots()
        axes.plot(search.rates, search.losses, color=SKY, label="training")
        axes.axvline(search.rate, color=VERMILION, linestyle="--", linewidth=1.2, label=f"chosen: {search.rate:.2g}")
        axes.set(xscale="log", xlabel="rate", ylabel="smoothed loss / that before", title="rate finder (Smith 2017)")
        legend_below(axes)
    return fig


def predictions_figure(shown: Prediction, title: str) -> Any:
    """Draw predicted over true impulses at the contacts, and the grids of one world, true and predicted."""
    top = float(shown.points[:, 1].max(initial=shown.grid.origin[1])) + 4.0 * shown.grid.spacing
    with figure(14.0, 8.2, title) as fig:
        axes = fig.subplots(2, 3, width_ratios=(1.1, 1.0, 1.0))
        for i, name in enumerate(IMPULSES):
            draw_density(axes[i, 0], shown, i)
            most = max(float(np.abs(shown.target[i]).max()), TINY)
            for panel, image, what in zip(axes[i, 1:], (shown.target[i], shown.answer[i]), ("true", "predicted")):
                drawn = draw_image(panel, image, shown.grid, most, signed=i == 1)
                panel.scatter(*shown.points.T, s=4.0, c=INK, linewidths=0, alpha=0.7)
                panel.set_title(f"{what} {NAMES[name]} impulses" + (f", {shown.title}" if what == "true" else ""))
                panel.set_ylim(top=min(top, panel.get_ylim()[1]))
                panel.tick_params(labelleft=what == "true")
                panel.set(xlabel="x [m]", ylabel="y [m]" if what == "true" else "")
            bar = fig.colorbar(drawn, ax=list(axes[i, 1:]), pad=0.01, aspect=28)
            set_ticks(bar, bar.ax.yaxis, most, signed=i == 1)
            bar.set_label("[N s]")
            bar.outline.set_visible(False)
    return fig


def draw_density(axes: Any, shown: Prediction, i: int) -> None:
    """Draw how many contacts have which true and predicted impulse; a perfect answer lies on the diagonal."""
    colors = require("matplotlib.colors", "pipeline")
    true, found = shown.label[:, i], shown.impulse[:, i]
    both = np.concatenate([true, found, [0.0]])
    most = max(float(np.abs(true).max(initial=0.0)), TINY)
    knee = KNEE * most
    low, high = float(max(both.min(), -most)), float(min(both.max(), most))
    low, high = min(low, -knee), max(high, knee)
    edges = knee * np.sinh(np.linspace(np.arcsinh(low / knee), np.arcsinh(high / knee), BINS + 1))
    edges[0], edges[-1] = low, high
    count, _, _ = np.histogram2d(np.clip(true, low, high), np.clip(found, low, high), bins=(edges, edges))
    norm = colors.LogNorm(1.0, max(float(count.max()), 2.0))
    mesh = axes.pcolormesh(edges, edges, np.ma.masked_equal(count.T, 0.0), cmap=DENSITY_MAP, norm=norm)
    for setter, axis in ((axes.set_xscale, axes.xaxis), (axes.set_yscale, axes.yaxis)):
        setter("asinh", linear_width=knee)
        set_ticks(axis, axis, most, signed=low < -2.0 * knee)
    axes.plot((low, high), (low, high), color=VERMILION, linewidth=1.0)
    axes.set(xlim=(low, high), ylim=(low, high), xlabel="true [N s]", ylabel="predicted [N s]")
    axes.set_box_aspect(1.0)
    square = max(float(np.square(true).sum()), TINY)
    left, least = (float(np.square(x - true).sum()) / square for x in (found, shown.floor[:, i]))
    name = NAMES[IMPULSES[i]]
    axes.set_title(
        f"{name}, {len(true):,} contacts: squared error {left:.2g} of zero's\n(solution through the grid {least:.1g})"
    )
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01, aspect=28)
    bar.set_label("contacts")
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.outline.set_visible(False)


def set_ticks(where: Any, axis: Any, most: float, signed: bool) -> None:
    """Set a few ticks, with short labels, on an axis that is logarithmic away from zero."""
    positive = ticks(most)
    where.set_ticks([*(-positive[::-1] if signed else ()), 0.0, *positive])
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_locator(require("matplotlib.ticker", "pipeline").NullLocator())


def draw_image(axes: Any, image: np.ndarray, grid: Grid, most: float, signed: bool) -> Any:
    """Draw an impulse image, white where it is near zero, in colours up to ``most``."""
    colors = require("matplotlib.colors", "pipeline")
    half = 0.5 * grid.spacing
    (left, low), (right, top) = grid.origin, grid.upper
    axes.grid(False)
    return axes.imshow(
        np.ma.masked_where(np.abs(image) < FAINT * most, image),
        origin="lower",
        extent=(left - half, right + half, low - half, top + half),
        cmap=SIGNED_MAP if signed else POSITIVE_MAP,
        norm=colors.AsinhNorm(LINEAR * most, -most if signed else 0.0, most),
        interpolation="nearest",
    )
