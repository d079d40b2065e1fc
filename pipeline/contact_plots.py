"""Pictures of the training of a ContactNet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .plots import CYCLE, MUTED, figure


def contact_curves_figure(rows: Sequence[Mapping[str, float]], title: str) -> Any:
    """Error left over that of an even share of Aitken's step, by step.

    Args:
        rows: of ``training.Log``.
        title: of the figure.
    """
    with figure(11.0, 4.4) as fig:
        fig.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        left, right = fig.subplots(1, 2, width_ratios=(2.0, 1.0))
        names = dict.fromkeys(name for row in rows for name in row if name.startswith("validation/"))
        points = [(row["step"], row["train/gain"]) for row in rows if "train/gain" in row]
        if points:
            left.plot(*zip(*points), color=MUTED, linewidth=0.6, label="training")
        for i, name in enumerate(names):
            points = [(row["step"], row[name]) for row in rows if name in row]
            label = name.removeprefix("validation/").replace("_", " ")
            left.plot(*zip(*points), marker="o", markersize=3, color=CYCLE[i % len(CYCLE)], label=label)
        left.axhline(0.0, color=MUTED, linewidth=1.0)
        left.set(xlabel="step", ylabel="log of the error left / that of an even share", title="gain of the network")
        left.legend(fontsize=8)
        points = [(row["step"], row["train/rate"]) for row in rows if "train/rate" in row]
        if points:
            right.plot(*zip(*points), color=CYCLE[2])
        right.set(xlabel="step", title="learning rate")
    return fig
