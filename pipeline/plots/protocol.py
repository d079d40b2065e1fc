"""Pictures of what starts did on the thesis worlds: the plots of the theses, the table, where the time went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dc_kernels.runtime.imports import require
from pipeline.evaluate.runs import PARTS, PATHS, Run
from pipeline.evaluate.tables import EVALUATION_COLUMNS, PROTOCOL_COLUMNS, Column, cells
from pipeline.plots.style import BLUE, GREEN, INK, LINES, MUTED, ORANGE, PURPLE, SKY, figure, legend_below, start_styles
from pipeline.plots.world import draw_world

WINDOW = 9
"""Steps over which the noise of many lines is averaged [1]."""
ERROR_FLOOR = 1e-10
"""Squared error below which a start is as good as the solution [N^2 s^2]."""
PART_COLORS = dict(zip(PARTS, ("#dce4ec", INK, PURPLE, GREEN, BLUE, SKY, ORANGE, MUTED), strict=True))
"""Colours of the parts of a step."""
EVERY = 0.16
"""Distance of the markers along a line, in units of the diagonal of its axes [1]."""
MARKS = 8
"""Markers of a line over the steps [1]."""


def line_styles(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Choose colour and marker for each start, a dash for each solver, and the label, for each run.

    Markers of accelerated runs are hollow; each run has them at other places of its line.
    """
    solvers = list(dict.fromkeys(run.solver for run in runs))
    of_start = start_styles([run.start for run in runs])
    styles: list[dict[str, Any]] = []
    for i, run in enumerate(runs):
        solver = solvers.index(run.solver)
        styles.append(
            {
                **of_start[run.start],
                "linestyle": LINES[solver % len(LINES)],
                "label": run.label,
                "markersize": 5.0,
                "markerfacecolor": "white" if solver else of_start[run.start]["color"],
                "markevery": (EVERY * (i + 0.5) / len(runs), EVERY),
            }
        )
    return styles


def _over_steps(axes: Any, steps: np.ndarray, values: np.ndarray, style: dict[str, Any]) -> None:
    """Draw a noisy line over the steps, its markers at equal distances of steps."""
    every = max(len(steps) // MARKS, 1)
    marks = (int(style["markevery"][0] / EVERY * every), every)
    axes.plot(steps, values, linewidth=1.2, **{**style, "markevery": marks})


def _count_axis(axes: Any, runs: Sequence[Run]) -> None:
    """Show sweeps on a logarithmic x axis."""
    axes.set_xscale("log")
    axes.set_xlim(1, max(run.max_sweeps for run in runs))
    axes.xaxis.set_major_formatter(require("matplotlib.ticker", "pipeline").FormatStrFormatter("%d"))


def draw_steps_left(axes: Any, runs: Sequence[Run]) -> None:
    """Draw the share of steps still iterating after n sweeps, one line for each run."""
    for run, style in zip(runs, line_styles(runs), strict=True):
        sweeps = np.arange(1, run.max_sweeps + 1)
        taken = np.sort(np.where(run.converged, run.sweeps, run.max_sweeps + 1)[run.with_contacts])
        left = 1.0 - np.searchsorted(taken, sweeps, side="right") / max(len(taken), 1)
        axes.plot(sweeps, 100.0 * left, **style)
    _count_axis(axes, runs)
    worlds = runs[0].sweeps.shape[1]
    axes.set(ylim=(0, 100), xlabel="sweeps n", title="steps still iterating after n sweeps")
    axes.set_ylabel(f"share of the steps of all {worlds} worlds [%]")


def draw_change(axes: Any, runs: Sequence[Run]) -> None:
    """Draw the largest impulse change of sweep n, its median over the steps with contacts."""
    for run, style in zip(runs, line_styles(runs), strict=True):
        if run.decay is not None:
            axes.plot(np.arange(1, len(run.decay) + 1), run.decay, **style)
    _count_axis(axes, runs)
    axes.set_yscale("log")
    axes.axhline(runs[0].tolerance, color=MUTED, linewidth=1.0, linestyle="--")
    axes.set(xlabel="sweep n", ylabel="median over all steps [N s]", title="largest impulse change of sweep n")


def draw_over_steps(axes: Any, runs: Sequence[Run], name: str, title: str, window: int = 1) -> None:
    """Draw a quantity (steps, worlds) of each run over the steps: median over worlds, mean over a window of steps."""
    for run, style in zip(runs, line_styles(runs), strict=True):
        values = np.median(getattr(run, name), axis=1)
        steps = np.arange(1, len(values) + 1)
        if 1 < window <= len(values):
            steps, values = (np.convolve(x, np.full(window, 1.0 / window), mode="valid") for x in (steps, values))
        _over_steps(axes, steps, values, style)
    how = f"median of {runs[0].sweeps.shape[1]} worlds" + (f",\nmean over {window} steps" if window > 1 else "")
    axes.set(xlabel="step", ylabel=how, title=title)
    axes.set_xlim(1, len(runs[0].sweeps))
    axes.set_ylim(bottom=0)


def protocol_figure(runs: Sequence[Run], title: str) -> Any:
    """Draw the theses' plots: steps left and impulse change per sweep, contacts and sweeps per step."""
    with figure(12.0, 8.0, title) as fig:
        axes = fig.subplots(2, 2)
        draw_steps_left(axes[0, 0], runs)
        if any(run.decay is not None for run in runs):
            draw_change(axes[0, 1], runs)
        else:
            axes[0, 1].axis("off")
            draw_table(axes[0, 1], runs)
        _legend(fig, axes[0, 0])
        draw_over_steps(axes[1, 0], runs, "contacts", "contacts per step")
        draw_over_steps(axes[1, 1], runs, "sweeps", "sweeps per step")
    return fig


def _legend(fig: Any, axes: Any, columns: int = 4) -> None:
    """Put the legend of an axes below all of a figure's."""
    handles, labels = axes.get_legend_handles_labels()
    fig.legend(
        handles, labels, loc="outside lower center", ncols=min(columns, len(labels)), fontsize=9.0, handlelength=3.5
    )


def draw_table(axes: Any, runs: Sequence[Run], columns: Sequence[Column] = PROTOCOL_COLUMNS) -> None:
    """Draw the table of ``tables.table`` as text, the label of each row in the colour of its line."""
    axes.axis("off")
    rows, styles = cells(runs, columns), line_styles(runs)
    table = axes.table(rows, colLabels=[c.title for c in columns], cellLoc="right", loc="center", bbox=(0, 0, 1, 1))
    table.auto_set_font_size(False)
    table.set_fontsize(8.5)
    table.auto_set_column_width(list(range(len(columns))))
    for (row, column), cell in table.get_celld().items():
        cell.visible_edges = "B"
        cell.set_edgecolor("#e6ebf0")
        cell.get_text().set_color(MUTED if row == 0 else INK)
        if column == 0:
            cell.get_text().set_horizontalalignment("left")
            if row:
                cell.get_text().set_color(styles[row - 1]["color"])


def demo_figure(sim: Any, runs: Sequence[Run], title: str) -> Any:
    """Draw a world at its end with its forces, sweeps per step, steps left per sweep, and the table, as one picture."""
    with figure(15.0, 8.4, title) as fig:
        grid = fig.add_gridspec(2, 2, height_ratios=(1.75, 1.0))
        axes = fig.add_subplot(grid[0, 0])
        draw_world(axes, sim)
        axes.set_title(f"one world after {float(sim.state.numpy('time')[0]):.2f} s: how its bodies press on each other")
        draw_over_steps(fig.add_subplot(grid[1, 0]), runs, "sweeps", "sweeps per step")
        left = fig.add_subplot(grid[0, 1])
        draw_steps_left(left, runs)
        _legend(fig, left)
        table = fig.add_subplot(grid[1, 1])
        draw_table(table, runs)
        table.set_title("sweeps: mean, median, and share of steps done in n")
    return fig


def draw_errors(axes: Any, runs: Sequence[Run], component: int) -> None:
    """Draw the mean squared difference of start and final impulse by step, its median over worlds with contacts."""
    for run, style in zip(runs, line_styles(runs), strict=True):
        if run.errors is not None:
            values = [row[np.isfinite(row) & (row > 0.0)] for row in run.errors[..., component]]  # shown by their log
            middle = [np.median(row) if len(row) else np.nan for row in values]
            _over_steps(axes, np.arange(1, len(middle) + 1), np.array(middle), style)
    what, worlds = ("normal", "tangential")[component], runs[0].sweeps.shape[1]
    axes.set_yscale("log")
    axes.set_ylim(bottom=ERROR_FLOOR)
    axes.set(xlabel="step", title=f"squared error of the {what} start impulses")
    axes.set_ylabel(f"mean over contacts, median of {worlds} worlds [N² s²]")
    axes.set_xlim(1, len(runs[0].sweeps))


def _rows(axes: Any, runs: Sequence[Run]) -> None:
    """Give each run a row, the first on top, with its label in its colour."""
    axes.set_yticks(range(len(runs)), [run.start.capitalize() for run in runs])
    for label, style in zip(axes.get_yticklabels(), line_styles(runs), strict=True):
        label.set_color(style["color"])
    axes.set_ylim(len(runs) - 0.5, -0.5)
    axes.grid(axis="y", visible=False)


def draw_worlds(axes: Any, runs: Sequence[Run]) -> None:
    """Draw the mean sweeps of each world, a dot, and of all, a bar."""
    for i, (run, style) in enumerate(zip(runs, line_styles(runs), strict=True)):
        means = run.world_means
        point = {"color": style["color"], "marker": style["marker"], "markersize": 4, "alpha": 0.55}
        axes.plot(means, np.full(len(means), i), linestyle="none", markeredgewidth=0, **point)
        axes.plot([run.summary()["mean_sweeps"]] * 2, [i - 0.35, i + 0.35], color=style["color"], linewidth=2.2)
    _rows(axes, runs)
    axes.set_xlim(left=0)
    axes.set(xlabel="sweeps, mean over the steps", title="sweeps of each world, and of all")


def draw_wall(axes: Any, runs: Sequence[Run]) -> None:
    """Draw the wall time of a world's step by part; the solve in advance of an oracle is left out."""
    scale = 1e6 / runs[0].sweeps.size
    left = np.zeros(len(runs))
    for part in PARTS:
        spent = np.array([scale * run.parts.get(part, 0.0) for run in runs])
        if part == "start":
            spent[[not run.counts for run in runs]] = 0.0
        if spent.any():
            axes.barh(range(len(runs)), spent, left=left, height=0.62, color=PART_COLORS[part], label=part, linewidth=0)
            left += spent
    _rows(axes, runs)
    axes.set(xlabel="wall time of a world's step, mean [us]", title="where the time goes (without solves in advance)")
    legend_below(axes, columns=4)


def evaluation_figure(runs: Sequence[Run], title: str) -> Any:
    """Draw all plots of the theses for runs of one solver and loop, with spread, wall time and the table."""
    with figure(17.0, 12.0 + 0.25 * len(runs), title) as fig:
        grid = fig.add_gridspec(4, 3, height_ratios=(1, 1, 1, 0.09 * (len(runs) + 1.5)))
        panels = [[fig.add_subplot(grid[row, column]) for column in range(3)] for row in range(2)]
        draw_steps_left(panels[0][0], runs)
        if any(run.decay is not None for run in runs):
            draw_change(panels[0][1], runs)
        else:
            panels[0][1].axis("off")
        draw_worlds(panels[0][2], runs)
        draw_over_steps(panels[1][0], runs, "sweeps", "sweeps per step", WINDOW)
        same = runs[0].loop == "open"
        draw_over_steps(panels[1][1], runs[:1] if same else runs, "contacts", "contacts per step")
        draw_wall(panels[1][2], runs)
        for component in range(2):
            draw_errors(fig.add_subplot(grid[2, component]), runs, component)
        legend = fig.add_subplot(grid[2, 2])
        legend.axis("off")
        legend.legend(
            *panels[0][0].get_legend_handles_labels(),
            loc="center",
            fontsize=9.5,
            handlelength=3.5,
            title=PATHS[runs[0].loop],
        )
        draw_table(fig.add_subplot(grid[3, :]), runs, EVALUATION_COLUMNS)
    return fig
