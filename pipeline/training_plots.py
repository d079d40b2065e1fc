"""Pictures of a training: its curves, and what the network predicts against what is true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.arrays import require
from dc_kernels.channels import IMPULSES
from dc_kernels.grid import Grid

from .grid_plots import LINEAR, POSITIVE_MAP, SIGNED_MAP
from .plots import CYCLE, INK, MUTED, figure

NAMES = {"impulse_n": "normal", "impulse_t": "tangential"}
BINS = 90  # of the histograms, along each axis
KNEE = 0.02  # share of the largest impulse up to which the axes are about linear, logarithmic beyond
DENSITY_MAP = "viridis"


@dataclass(frozen=True)
class Prediction:
    """What a network answers to a batch, at the contacts, and the grids of one world."""

    impulse: np.ndarray
    """Predicted, (M, 2) [N s]."""
    label: np.ndarray
    """True, (M, 2) [N s]."""
    floor: np.ndarray
    """The true ones sent to the grid and back, (M, 2) [N s]."""
    grid: Grid
    answer: np.ndarray
    """Predicted image of one world, (2, rows, columns)."""
    target: np.ndarray
    """Image of its labels, (2, rows, columns)."""
    points: np.ndarray
    """Its contacts, (m, 2) [m]."""
    title: str
    """Which world this is."""


def curves_figure(rows: Sequence[Mapping[str, float]], title: str) -> Any:
    """Loss, error at the contacts, and rate over the steps.

    Args:
        rows: of ``training.Log``: "step" and the names "train/loss", "train/rate", "validation/...".
        title: of the figure.
    """

    def draw(axes: Any, name: str, **style: Any) -> None:
        points = [(row["step"], row[name]) for row in rows if name in row]
        if points:
            axes.plot(*zip(*points), **style)

    with figure(13.0, 4.4) as fig:
        fig.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        loss, error, rate = fig.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
        draw(loss, "train/loss", color=CYCLE[1], linewidth=1.0, alpha=0.55, label="training, without dropped values")
        draw(loss, "validation/loss", color=CYCLE[0], marker="o", markersize=3.5, label="validation")
        loss.set(title="loss", yscale="log", xlabel="step")
        for i, name in enumerate(NAMES.values()):
            draw(error, f"validation/{name}", color=CYCLE[i], marker="o", markersize=3.5, label=name)
            draw(error, f"validation/{name}_cache", color=CYCLE[i], linestyle="--", linewidth=1.2)
            draw(error, f"validation/{name}_grid", color=CYCLE[i], linestyle=":", linewidth=1.2)
        error.axhline(1.0, color=MUTED, linewidth=1.0)
        error.set(title="squared error at the contacts / that of zero", yscale="log", xlabel="step")
        styles = [("--", "cached impulses"), (":", "the truth through the grid")]
        for line, label in styles:
            error.plot([], [], color=MUTED, linestyle=line, linewidth=1.2, label=label)
        draw(rate, "train/rate", color=CYCLE[2])
        rate.set(title="rate", yscale="log", xlabel="step")
        for axes in (loss, error):
            if axes.get_legend_handles_labels()[0]:
                axes.legend(fontsize=8.5)
    return fig


def rates_figure(rates: Sequence[float], losses: Sequence[float], chosen: float) -> Any:
    """The smoothed loss of the rate finder over the rate, and the one it chose."""
    with figure(6.5, 4.2) as fig:
        axes = fig.subplots()
        axes.plot(rates, losses, color=CYCLE[1])
        axes.axvline(chosen, color=CYCLE[0], linestyle="--", linewidth=1.2, label=f"chosen: {chosen:.2g}")
        axes.set(xscale="log", yscale="log", xlabel="rate", ylabel="smoothed loss", title="rate finder (Smith 2017)")
        axes.legend()
    return fig


def predictions_figure(shown: Prediction, title: str) -> Any:
    """Predicted over true impulses at the contacts, and the grids of one world, true and predicted."""
    with figure(14.0, 8.6) as fig:
        fig.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        axes = fig.subplots(2, 3, width_ratios=(1.0, 1.15, 1.15))
        for i, name in enumerate(IMPULSES):
            draw_density(axes[i, 0], shown, i)
            pair = shown.target[i], shown.answer[i]
            most = max(float(np.abs(pair[0]).max()), 1e-12)
            for panel, image, what in zip(axes[i, 1:], pair, ("true", "predicted")):
                draw_image(panel, image, shown.grid, most, signed=i == 1)
                panel.scatter(*shown.points.T, s=3.0, c=INK, linewidths=0, alpha=0.6)
                panel.set_title(f"{what} {NAMES[name]} impulses of {shown.title}")
    return fig


def draw_density(axes: Any, shown: Prediction, i: int) -> None:
    """How many contacts have which true and predicted impulse; a perfect answer lies on the diagonal."""
    colors = require("matplotlib.colors", "pipeline")
    true, found = shown.label[:, i], shown.impulse[:, i]
    most = max(float(np.abs(true).max(initial=0.0)), 1e-9)
    knee = KNEE * most
    low, high = min(float(true.min(initial=0.0)), float(found.min(initial=0.0))), max(most, float(found.max(initial=0)))
    edges = knee * np.sinh(np.linspace(np.arcsinh(low / knee), np.arcsinh(high / knee), BINS + 1))
    edges[0], edges[-1] = low, high
    count, _, _ = np.histogram2d(true, found, bins=(edges, edges))
    mesh = axes.pcolormesh(
        edges,
        edges,
        np.ma.masked_equal(count.T, 0.0),
        cmap=DENSITY_MAP,
        norm=colors.LogNorm(1.0, max(count.max(), 2.0)),
    )
    for setter in (axes.set_xscale, axes.set_yscale):
        setter("asinh", linear_width=knee)
    axes.plot((low, high), (low, high), color=CYCLE[0], linewidth=1.0)
    axes.set(xlim=(low, high), ylim=(low, high), xlabel="true [N s]", ylabel="predicted [N s]")
    axes.set_aspect("equal")
    square = max(float(np.square(true).sum()), 1e-30)
    left, least = (float(np.square(x - true).sum()) / square for x in (found, shown.floor[:, i]))
    name = NAMES[IMPULSES[i]]
    axes.set_title(f"{name}: squared error {left:.2f} of zero's\n(the truth through the grid: {least:.2g})")
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01, aspect=28)
    bar.set_label("contacts")
    bar.outline.set_visible(False)


def draw_image(axes: Any, image: np.ndarray, grid: Grid, most: float, signed: bool) -> None:
    """An impulse image, on the colours of another one's range."""
    colors = require("matplotlib.colors", "pipeline")
    half = 0.5 * grid.spacing
    (left, low), (right, top) = grid.origin, grid.upper
    drawn = axes.imshow(
        image,
        origin="lower",
        extent=(left - half, right + half, low - half, top + half),
        cmap=SIGNED_MAP if signed else POSITIVE_MAP,
        norm=colors.AsinhNorm(LINEAR * most, -most if signed else 0.0, most),
        interpolation="nearest",
    )
    axes.grid(False)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    bar = axes.figure.colorbar(drawn, ax=axes, pad=0.01, aspect=28)
    bar.set_label("[N s]")
    bar.outline.set_visible(False)
