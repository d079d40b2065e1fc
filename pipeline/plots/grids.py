"""A picture of the input and the target of a network: grids of bodies, contacts, impulses (Engedal, figures 8, 9)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS, IMPULSES
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.images import Images
from dc_kernels.model.arrays import to_numpy
from dc_kernels.runtime.imports import require
from pipeline.plots.style import INK, figure
from pipeline.plots.world import Forces, WorldDrawing, WorldShapes, arrays

POSITIVE_MAP, SIGNED_MAP = "Oranges", "RdBu_r"
LINEAR = 0.1
"""Share of the largest value up to which the colours are about linear, logarithmic beyond [1]."""
TICKS = (1.0, 3.0)
"""Values of ticks, in units of powers of ten [1]."""
BODIES = ("mass", "omega", "velocity_x", "velocity_y")
CONTACTS = ("normal_x", "normal_y")
CHANNELS = {**BODY_CHANNELS, **CONTACT_CHANNELS}
TITLES = {
    "mass": "mass of the bodies",
    "omega": "angular velocity of the bodies",
    "velocity_x": "horizontal velocity of the bodies",
    "velocity_y": "vertical velocity of the bodies",
    "normal_x": "horizontal part of the contacts' normals",
    "normal_y": "vertical part of the contacts' normals",
    "impulse_n": "the answer: normal impulse of the contacts",
    "impulse_t": "the answer: tangential impulse of the contacts",
}
POSITIVE = ("mass", "impulse_n")
"""Channels without negative values."""
EVEN = ("mass", "normal_x", "normal_y")
"""Channels without a few large values that would leave all others pale."""
PANEL = 6.6
"""Width of a panel [inch]."""


def draw_grid(axes: Any, name: str, image: np.ndarray, grid: Grid) -> None:
    """Draw a channel (rows, columns) as a square for each node, white where it is zero, with its colour bar.

    The colours of a channel with signs are symmetric about zero; those of one with a few large values follow the
    inverse hyperbolic sine.
    """
    colors = require("matplotlib.colors", "pipeline")
    half = 0.5 * grid.spacing
    (left, low), (right, top) = grid.origin, grid.upper
    signed, most = name not in POSITIVE, max(float(np.abs(image).max()), 1e-12)
    least = -most if signed else 0.0
    shown = axes.imshow(
        np.ma.masked_equal(image, 0.0),
        origin="lower",
        extent=(left - half, right + half, low - half, top + half),
        cmap=SIGNED_MAP if signed else POSITIVE_MAP,
        norm=colors.Normalize(least, most) if name in EVEN else colors.AsinhNorm(LINEAR * most, least, most),
        interpolation="nearest",
        zorder=0,
    )
    bar = axes.figure.colorbar(shown, ax=axes, pad=0.01, aspect=22)
    if name not in EVEN:
        positive = ticks(most)
        bar.set_ticks([*(-positive[::-1] if signed else ()), 0.0, *positive])
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1g}")
        bar.ax.minorticks_off()
    channel = CHANNELS[name]
    bar.set_label(f"[{channel.unit}]")
    bar.outline.set_visible(False)


def ticks(most: float) -> np.ndarray:
    """Return the last three of 1, 3, 10, 30, ... up to a value."""
    exponents = np.floor(np.log10(most)) + np.arange(-2.0, 1.0)
    values = np.outer(10.0**exponents, TICKS).ravel()
    return values[values <= most][-3:]


def outline_bodies(axes: Any, shapes: WorldShapes, position: np.ndarray, angle: np.ndarray) -> None:
    """Draw the outlines of a world's bodies and its walls, nothing filled."""
    drawing = WorldDrawing(axes, shapes, position, angle)
    for fill in drawing.fills:
        fill.set(facecolor="none", edgecolor=INK, alpha=0.45, linewidth=0.6)
    drawing.marks.set_visible(False)
    drawing.walls.set_linewidth(1.5)


def grids_figure(sim: Any, grid: Grid, world: int = 0) -> Any:
    """Draw the six input grids and the two of the impulses of one world, bodies as outlines and contacts as dots.

    Args:
        sim: the simulation after a step.
        grid: of the images.
        world: which world.
    """
    images = Images(sim, ImageSpec(grid, body_channels=BODIES, contact_channels=CONTACTS, walls=None))
    images.splat()
    channels = dict(zip(images.channels, images.numpy()[world], strict=True))
    channels.update(zip(IMPULSES, to_numpy(images.impulse_image())[world], strict=True))
    shapes, forces = WorldShapes.of(arrays(sim), world), Forces.of(sim, world)
    position, angle = sim.state.numpy("position")[shapes.bodies], sim.state.numpy("angle")[shapes.bodies]
    left, right = grid.origin[0] - grid.spacing, grid.upper[0] + grid.spacing
    low, top = grid.origin[1] - grid.spacing, _top(images, grid) + 2.0 * grid.spacing
    shape = min(max((top - low) / (right - left), 0.25), 1.0)
    title = (
        "Input of a network from bodies (outlines) and contacts (dots), and its target\n"
        f"{grid.columns} x {grid.rows} nodes, {grid.spacing:g} m apart; poly6, h = {2.0 * grid.spacing:g} m"
    )
    with figure(2.0 * PANEL, 4.0 * (0.84 * PANEL * shape + 0.45), title) as fig:
        for axes, (name, image) in zip(
            fig.subplots(4, 2, sharex=True, sharey=True).flat, channels.items(), strict=True
        ):
            draw_grid(axes, name, image, grid)
            outline_bodies(axes, shapes, position, angle)
            if name not in BODIES:
                axes.scatter(*forces.points.T, s=5.0, c=INK, linewidths=0, zorder=6)
            axes.set_title(TITLES[name])
            axes.set(xlim=(left, right), ylim=(low, top))
            axes.label_outer()
    return fig


def _top(images: Images, grid: Grid) -> float:
    """Find the height of the highest node that anything reaches [m]."""
    rows = np.flatnonzero(images.numpy().any(axis=(0, 1, 3)))
    return grid.origin[1] + grid.spacing * float(rows[-1] if len(rows) else grid.rows - 1)
