"""The figure of the backends: how their times compare with Warp's, row by row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

ENGINES = {"taichi": "Taichi", "quadrants": "Quadrants", "peer": "torch, SciPy"}


def label(row: dict[str, Any]) -> str:
    """Name a row of the table for the figure."""
    return row["row"] if row["threads"] == 1 else f"{row['row']}, {row['threads']} threads"


def draw(record: dict[str, Any], path: Path) -> None:
    """Draw each engine's time over Warp's on a logarithmic axis; the oracle is left out, which is never fast."""
    from pipeline.plots import style

    rows = [row for row in record["rows"] if any(engine in row["over_warp"] for engine in ENGINES)]
    looks = {"taichi": (style.VERMILION, "o"), "quadrants": (style.BLUE, "s"), "peer": (style.MUTED, "^")}
    with style.figure(9.6, 1.4 + 0.22 * max(len(rows), 4)) as figure:
        axes = figure.subplots()
        for engine, name in ENGINES.items():
            places = [i for i, row in enumerate(rows) if engine in row["over_warp"]]
            if not places:
                continue  # not in the quick form, or not installed
            color, marker = looks[engine]
            ratios = [rows[i]["over_warp"][engine] for i in places]
            axes.plot(ratios, places, marker, color=color, label=name, linestyle="none", markersize=5.5)
        axes.axvline(1.0, color=style.INK, linewidth=1.0)
        axes.set_xscale("log", base=2)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_yticks(range(len(rows)), [label(row) for row in rows], fontsize=8)
        axes.invert_yaxis()
        axes.set_title("time over Warp's, the line (less is better)")
        axes.set_xlabel(record["machine"]["cpu"], fontsize=8, color=style.MUTED)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        style.save_figure(figure, path, dpi=130)
