"""The style of all pictures: colours, fonts, figures and how they are written.

Figures are made without pyplot, so nothing global changes and no display is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dc_kernels.runtime.optional import require
from pipeline.files import atomic_path

INK = "#1f2933"
MUTED = "#66788a"
FILL = "#dce4ec"
EDGE = "#9fb0c0"
CYCLE = ("#c2410c", "#1d4ed8", "#0f766e", "#7c3aed", "#b45309", "#475569", "#be185d", "#4d7c0f")
LINES = ("-", "--", ":", "-.")
STYLE = {
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6ebf0",
    "grid.linewidth": 0.8,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}


@contextmanager
def figure(width: float, height: float, title: str | None = None) -> Iterator[Any]:
    """Make a figure of a size [inch] in the project's style, which holds inside the block, with a title at its left."""
    matplotlib = require("matplotlib", "pipeline")
    with matplotlib.rc_context(STYLE):
        made = require("matplotlib.figure", "pipeline").Figure(figsize=(width, height), layout="constrained")
        if title is not None:
            made.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        yield made


def save_figure(fig: Any, path: Path, dpi: int = 130) -> None:
    """Write a figure in one go (``atomic_path``); the suffix of the path says as what."""
    matplotlib = require("matplotlib", "pipeline")
    with matplotlib.rc_context(STYLE), atomic_path(path) as partial:
        fig.savefig(partial, dpi=dpi)
