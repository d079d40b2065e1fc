"""Work-precision diagrams: one figure a scene, and one of the trajectories with a closed form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.error_time import runs as error_time_runs
from bench.error_time import solve as error_time_solve
from bench.error_time.motion import MOTIONS, SERIES, order
from dc_kernels.runtime.imports import require
from pipeline.plots import style as plots

Style = Mapping[str, str]
"""Colour, marker and dash of a setting."""
PALE = "#b8c4d0"
LINE = {"linewidth": 1.6, "zorder": 3}
# panels of a scene: kind of point, error, title, axis
PANELS = (
    ("solve", "residual", "relative natural map", "[1]"),
    ("solve", "velocity", "error in velocity", "over the change of velocity [1]"),
    ("solve", "impulse", "error in impulse (not unique)", "relative [1]"),
    ("solve", "change", "largest impulse change", "[N s]"),
    ("run", "penetration", "mean penetration, pile at rest", "[m]"),
    ("run", "drift", "drift of the pile at rest", "[m/s]"),
)
VARIANTS = {"from zero": ("v", ":"), "float64": ("D", "--"), "scalar": ("X", "-."), "ContactNet": ("P", "--")}
"""Marker and dash of settings that differ in more than the acceleration."""
LEAST = {"penetration": 1e-9, "drift": 1e-9}  # zero is drawn there
PEERS = {"pymunk": "s", "pybox2d": "^"}
OFFSETS = {"pymunk": 5, "pybox2d": -10}  # of their names [points]
MOST_NAMED = 5  # curves of a scene with a colour of their own


def scene_figure(title: str, points: Sequence[Mapping[str, Any]], path: Path) -> None:
    """The panels of one scene.

    Args:
        title: of the figure.
        points: of this scene, marked by ``error_time_points.mark``.
        path: where it is written.
    """
    with plots.figure(14.0, 8.4) as figure:
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        axes = figure.subplots(2, 3).ravel()
        styles = _styles(points)
        for panel, (kind, error, name, unit) in zip(axes, PANELS, strict=True):
            chosen = [p for p in points if p["kind"] in (kind, f"{kind}_default") and p.get(error) is not None]
            panel.set(xscale="log", yscale="log", title=f"{name} {unit}")
            panel.set_xlabel("wall time of a solve [s]" if kind == "solve" else "wall time per simulated second [s]")
            if not chosen:
                panel.text(0.5, 0.5, "no reference reached", transform=panel.transAxes, ha="center", color=plots.MUTED)
                panel.axis("off")
                continue
            (_solves if kind == "solve" else _runs)(panel, chosen, error, styles)
            _decades(panel)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, fontsize=9, loc="outside lower center", ncols=9, handlelength=1.6)
        path.parent.mkdir(parents=True, exist_ok=True)
        plots.save_figure(figure, path)


def _styles(points: Sequence[Mapping[str, Any]]) -> dict[str, Style]:
    """A colour for plain and default, and for what is on a front most often; the others are pale."""
    counts: dict[str, int] = {}
    for point in points:
        if point["kind"] == "solve":
            on = sum(error in point.get("front_in", ()) for error in ("residual", "velocity"))
            counts[point["setting"]] = counts.get(point["setting"], 0) + on
    fixed = [error_time_solve.DEFAULT.label, "plain"]
    often = sorted((label for label in counts if label not in fixed and counts[label]), key=lambda s: -counts[s])
    named = [label for label in fixed if label in counts] + often[:MOST_NAMED]
    return {label: line_style(label) for label in named}


def line_style(label: str) -> Style:
    """Colour of a setting's acceleration, with a marker and a dash of the setting's own; Jacobi's curves are grey."""
    name, *more = label.split(", ")
    method, _, acceleration = name.rpartition(" ")
    style = dict(plots.SOLVERS[acceleration])
    if method:
        style["color"] = plots.MUTED
    for kind, (marker, line) in VARIANTS.items():
        if kind in more:
            style.update(marker=marker, linestyle=line)
    return style


def _decades(axes: Any) -> None:
    """Ticks at whole decades only, two of them at least on each axis."""
    ticker = require("matplotlib.ticker", "pipeline")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        if np.floor(np.log10(high)) - np.ceil(np.log10(low)) < 1:
            low, high = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high))
            (axes.set_xlim if axis is axes.xaxis else axes.set_ylim)(low * 0.9, high * 1.1)
        axis.set_minor_formatter(ticker.NullFormatter())


def _front(axes: Any, points: Sequence[Mapping[str, Any]], error: str) -> None:
    """The Pareto front as a broad line behind the points."""
    on = sorted((p["seconds"], _value(p, error)) for p in points if error in p.get("front_in", ()))
    if on:
        axes.plot(
            *zip(*on, strict=True), color="#f3d9a4", linewidth=7.0, solid_capstyle="round", zorder=1, label="front"
        )


def _value(point: Mapping[str, Any], error: str) -> float:
    return max(point[error], LEAST.get(error, 0.0))


def _solves(axes: Any, points: Sequence[Mapping[str, Any]], error: str, styles: Mapping[str, Style]) -> None:
    """A curve a setting over the number of sweeps; a star where the default solver stops."""
    _front(axes, points, error)
    curves: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        if point["kind"] == "solve":
            curves.setdefault(point["setting"], []).append((point["seconds"], point[error]))
    for label, curve in curves.items():
        if label not in styles:
            axes.plot(*zip(*curve, strict=True), color=PALE, linewidth=0.8, zorder=2)
    for label, style in styles.items():
        if label in curves:
            axes.plot(*zip(*curves[label], strict=True), markersize=3.5, label=label, **style, **LINE)
    axes.plot([], [], color=PALE, linewidth=0.8, label="other settings")
    for point in points:
        if point["kind"] == "solve_default":
            place = (point["seconds"], point[error])
            axes.plot(
                *place, "*", color=plots.VERMILION, markersize=13, markeredgecolor="white", zorder=5, label="default"
            )


def _runs(axes: Any, points: Sequence[Mapping[str, Any]], error: str, styles: Mapping[str, Style]) -> None:
    """Ours by name where on the front, the peers in grey, joined over the number of iterations."""
    _front(axes, points, error)
    ours = [p for p in points if p["engine"] == "deep-contact"]
    for point in ours:
        place = (point["seconds"], _value(point, error))
        if point["setting"] == "default":
            axes.plot(*place, "*", color=plots.VERMILION, markersize=13, markeredgecolor="white", zorder=5)
        else:
            axes.plot(*place, "o", color=plots.VERMILION, markersize=4, zorder=4)
    for engine, marker in PEERS.items():
        chosen = [p for p in points if p["engine"] == engine]
        usual = [(p["seconds"], _value(p, error)) for p in chosen if p["dt"] == error_time_runs.DT]
        if not usual:
            continue
        axes.plot(*zip(*usual, strict=True), color=plots.MUTED, marker=marker, markersize=5, linewidth=0.8, zorder=2)
        finer = [(p["seconds"], _value(p, error)) for p in chosen if p["dt"] != error_time_runs.DT]
        if finer:
            axes.plot(*zip(*finer, strict=True), marker, color=plots.MUTED, markersize=5, fillstyle="none", zorder=2)
        axes.annotate(
            engine,
            usual[-1],
            xytext=(5, OFFSETS[engine]),
            textcoords="offset points",
            fontsize=8,
            color=plots.MUTED,
            zorder=6,
        )
    _names(axes, [p for p in ours if error in p.get("front_in", ()) or p["setting"] in ("default", "plain")], error)


def _names(axes: Any, points: Sequence[Mapping[str, Any]], error: str) -> None:
    """Labels beside points, the default's first; one that would lie over another is left out."""
    placed: list[np.ndarray] = []
    axes.autoscale_view()
    low, high = np.log10(np.array([axes.get_xlim(), axes.get_ylim()])).T
    for point in sorted(points, key=lambda p: (p["setting"] != "default", p["seconds"])):
        place = (np.log10([point["seconds"], _value(point, error)]) - low) / np.maximum(high - low, 1e-9)
        if any(abs(place[0] - other[0]) < 0.25 and abs(place[1] - other[1]) < 0.07 for other in placed):
            continue
        placed.append(place)
        axes.annotate(
            point["setting"],
            (point["seconds"], _value(point, error)),
            xytext=(6, 5),
            textcoords="offset points",
            fontsize=8,
            color=plots.INK,
            zorder=6,
        )


def motion_figure(points: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Error of each motion over wall time, with the order of convergence in dt."""
    style: dict[str, dict[str, Any]] = {
        "deep-contact": {"color": plots.VERMILION, "marker": "o"},
        "deep-contact float64": {"color": plots.VERMILION, "marker": "D", "linestyle": "--", "fillstyle": "none"},
        "pymunk": {"color": plots.MUTED, "marker": "s", "linewidth": 0.9},
        "pybox2d": {"color": plots.MUTED, "marker": "^", "linewidth": 0.9, "linestyle": "--"},
    }
    with plots.figure(14.0, 4.2) as figure:
        figure.suptitle(
            "error of a trajectory at 1.6 s [m], time steps from 0.02 s",
            x=0.01,
            ha="left",
            fontsize=12,
            fontweight="bold",
        )
        for axes, (name, motion) in zip(figure.subplots(1, len(MOTIONS)), MOTIONS.items(), strict=True):
            here = [p for p in points if p["scene"] == name]
            _front(axes, here, "trajectory")
            orders = []
            for series in SERIES:
                curve = series_points(here, series)
                slope = order([p["dt"] for p in curve], [p["trajectory"] for p in curve])
                orders.append("-" if slope is None else f"{slope:.2f}")
                places = np.array([(p["seconds"], p["trajectory"]) for p in curve])
                axes.plot(*places.T, markersize=4, label=series, **{"linewidth": 1.6, **style[series]})
            axes.set(xscale="log", yscale="log", title=motion.title, xlabel="wall time per simulated second [s]")
            _decades(axes)
            axes.text(
                0.03, 0.03, "order in dt\n" + "\n".join(orders), transform=axes.transAxes, fontsize=8, color=plots.MUTED
            )
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, fontsize=9, loc="outside lower center", ncols=5)
        plots.save_figure(figure, path)


def series_points(points: Sequence[Mapping[str, Any]], series: str) -> list[Mapping[str, Any]]:
    """The points of one of ``SERIES``, from large steps to small ones."""
    engine, _, dtype = series.partition(" ")
    return [p for p in points if p["engine"] == engine and p.get("dtype", "") == dtype]
