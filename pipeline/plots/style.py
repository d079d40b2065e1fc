"""The style of all pictures: colours, fonts, figures and how they are written.

All colours of lines are those of Okabe and Ito (2008) with a dark and a middle grey: each two of them differ by more
than 15 in CIE Lab for readers of all kinds of colour vision (Machado et al. 2009), which a test holds. Among things of
a kind (starts, solvers, parts of an impulse, quantities of a run) a colour has one meaning in all figures, which the
tables below say: of starts and solvers black has no help (no start, plain sweeps), vermilion is the default of this
package, blue a network, green the solution, grey what is shown for comparison. What has a colour has a marker or a dash
of its own too.

Figures are made without pyplot, so nothing global changes and no display is needed.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dc_kernels.runtime.imports import require
from pipeline.files import write_bytes

INK = "#1f2933"
MUTED = "#525c66"
FILL = "#dce4ec"
EDGE = "#9fb0c0"
VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY = "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
CYCLE = (VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY, INK, MUTED)
"""All colours of lines, for things that no table below names."""
MARKERS = ("o", "s", "^", "D", "v", "X", "P", "*")
LINES = ("-", "--", ":", "-.")
STARTS = {
    "none": {"color": INK, "marker": "o"},
    "builtin": {"color": VERMILION, "marker": "s"},
    "copy": {"color": GREEN, "marker": "^"},
    "cnn": {"color": BLUE, "marker": "D"},
    "cnn-start": {"color": SKY, "marker": "v"},
    "grid": {"color": ORANGE, "marker": "X"},
    "grid-bilinear": {"color": PURPLE, "marker": "P"},
    "random": {"color": MUTED, "marker": "*"},
}
"""Colour and marker of the starts by name."""
SOLVERS = {
    **{name: {"color": INK, "marker": "o", "linestyle": "-"} for name in ("plain", "pgs")},
    **{name: {"color": VERMILION, "marker": "s", "linestyle": "-"} for name in ("adaptive", "auto")},
    "aitken": {"color": BLUE, "marker": "^", "linestyle": "--"},
    "nncg": {"color": GREEN, "marker": "D", "linestyle": "-."},
    "sor": {"color": MUTED, "marker": "v", "linestyle": ":"},
    "anderson": {"color": PURPLE, "marker": "X", "linestyle": "--"},
    "hybrid": {"color": ORANGE, "marker": "P", "linestyle": "-."},
    "newton": {"color": SKY, "marker": "*", "linestyle": ":"},
}
"""Colour, marker and dash of methods and accelerations of the solver by name."""
COMPONENTS = {
    "normal": {"color": PURPLE, "marker": "o", "linestyle": "-"},
    "tangential": {"color": ORANGE, "marker": "s", "linestyle": "-"},
}
"""Colour, marker and dash of the two parts of an impulse."""
QUANTITIES = {
    "sweeps": {"color": BLUE, "linestyle": "-"},
    "contacts": {"color": MUTED, "linestyle": "--"},
    "pressing": {"color": GREEN, "linestyle": "-"},
    "total": {"color": INK, "linestyle": "-"},
    "potential": {"color": SKY, "linestyle": "--"},
    "kinetic": {"color": VERMILION, "linestyle": "-."},
    "largest": {"color": PURPLE, "linestyle": "-"},
    "mean": {"color": ORANGE, "linestyle": "--"},
}
"""Colour and dash of the quantities of a run by name."""
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


def start_styles(labels: Sequence[str]) -> dict[str, dict[str, str]]:
    """Choose colour and marker of starts by their labels: those of ``STARTS``, and for others the next that are free.

    No two labels have both in common; colours come again, with other markers, where they do not last.
    """
    named = {label: STARTS[label.lower()] for label in labels if label.lower() in STARTS}
    pairs = [
        {"color": color, "marker": MARKERS[(i + turn) % len(MARKERS)]}
        for turn in range(len(MARKERS))
        for i, color in enumerate(CYCLE)
    ]
    used = [style["color"] for style in named.values()]
    free = [pair for pair in pairs if pair not in STARTS.values()]
    free.sort(key=lambda pair: pair["color"] in used)  # stable: colours that nobody has come first
    others = [label for label in dict.fromkeys(labels) if label not in named]
    return {**named, **{label: free[i % len(free)] for i, label in enumerate(others)}}


def legend_below(axes: Any, columns: int = 3, **options: Any) -> None:
    """Put the legend of an axes below it, where no data lie; an axes that shows nothing with a label has none."""
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    moved = require("matplotlib.transforms", "pipeline").ScaledTranslation(
        0.0, -34.0 / 72.0, axes.figure.dpi_scale_trans
    )
    options = {"fontsize": 8.5, "ncols": columns, "loc": "upper center", "borderaxespad": 0.0, **options}
    axes.legend(handles, labels, bbox_to_anchor=(0.5, 0.0), bbox_transform=axes.transAxes + moved, **options)


def save_figure(fig: Any, path: Path, dpi: int = 130) -> None:
    """Write a figure in one go (``write_bytes``); the suffix of the path says as what."""
    matplotlib = require("matplotlib", "pipeline")
    picture = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        fig.savefig(picture, dpi=dpi, format=path.suffix.removeprefix(".") or None)
    write_bytes(path, picture.getbuffer())
