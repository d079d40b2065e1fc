"""Figures of Wu (2018), drawn again: the comparison of smoothing kernels (figures 3.3 and 3.4)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.sph.smoothing import KERNELS, smoothing, smoothing_gradient, smoothing_laplacian
from pipeline.plots.style import BLUE, GREEN, MUTED, PURPLE, VERMILION, figure, save_figure

LABELS = {
    "poly6": "poly6",
    "spiky": "spiky",
    "gaussian": "Gaussian, sigma = h / 4",
    "cubic": "cubic spline",
    "wendland": "Wendland C2",
}
COLORS = {"poly6": VERMILION, "spiky": BLUE, "gaussian": MUTED, "cubic": GREEN, "wendland": PURPLE}
DASHES = {
    "poly6": "-",
    "spiky": "-.",
    "gaussian": (0, (1, 1.2)),
    "cubic": (0, (7, 1.5, 1, 1.5)),
    "wendland": (0, (4, 1.5)),
}
SAMPLES = 1001
"""Points of a curve; the number is odd, so that one of them is r = 0 [1]."""


def kernel_curves(kernel: str, dim: int, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return W, the component of grad W along an axis, and lap W at r on it, for h = 1 m; NaN where singular."""
    offset = np.zeros((len(r), dim))
    offset[:, 0] = r
    value = smoothing(kernel, r, 1.0, dim)
    slope = smoothing_gradient(kernel, offset, 1.0)[:, 0]
    laplacian = smoothing_laplacian(kernel, r, 1.0, dim)
    if kernel == "spiky":
        slope, laplacian = (np.where(r == 0.0, np.nan, curve) for curve in (slope, laplacian))
    return value, slope, laplacian


def kernels_figure() -> Any:
    """Draw all smoothing kernels with h = 1 m along a line through the centre: W, slope, Laplacian, in 2D and 3D."""
    r = np.linspace(-1.0, 1.0, SAMPLES)
    with figure(14.0, 8.4, "Smoothing kernels, support radius h = 1 m") as fig:
        axes = fig.subplots(2, 3, sharex=True)
        for dim, row in zip((2, 3), axes):
            lowest, highest = 0.0, 0.0
            for name in KERNELS:
                style = {"color": COLORS[name], "linestyle": DASHES[name], "label": LABELS[name]}
                curves = kernel_curves(name, dim, r)
                for panel, curve in zip(row, curves):
                    panel.plot(r, curve, **style)
                if name != "spiky":
                    lowest, highest = min(lowest, curves[2].min()), max(highest, curves[2].max())
            titles = ("$W$", "$\\partial W / \\partial x$ on the $x$ axis", "$\\nabla^2 W$")
            for order, (panel, title) in enumerate(zip(row, titles)):
                panel.set_title(f"{dim}D: {title}  [1/m$^{dim + order}$]")
                panel.set_xlim(-1.0, 1.0)
            # spiky's Laplacian has no bottom
            row[2].set_ylim(lowest - 0.3 * (highest - lowest), highest + 0.1 * (highest - lowest))
            row[2].annotate(
                "spiky: to $-\\infty$ at $x = 0$",
                (0.13, 0.03),
                xycoords=("data", "axes fraction"),
                color=COLORS["spiky"],
                fontsize=8.5,
            )
        for panel in axes[1]:
            panel.set_xlabel("x [m]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return fig


FIGURES = {"kernels": kernels_figure}


def draw(name: str, out: Path) -> Path:
    """Write the figure of a name as a PNG into a folder, in one go; return its path.

    Raises:
        ValueError: for a name not in FIGURES.
    """
    if name not in FIGURES:
        raise ValueError(f"figure is {name!r}; it must be one of {tuple(FIGURES)}")
    path = out / f"{name}.png"
    save_figure(FIGURES[name](), path)
    return path
