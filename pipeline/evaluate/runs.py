"""What a strategy did on the thesis worlds, and the tables that compare several."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

DONE_IN = (10, 50, 100, 200, 1000)  # sweeps of the table's shares
# where the wall time of a step goes, in its order; "start" is what a strategy needs beyond the parts that are named
PARTS = ("collide", "start", "features", "splat", "network", "gather", "solve", "advance")
BASE = "builtin"  # the start that others are compared with
PATHS = {"closed": "each on a trajectory of its own", "open": "all on the trajectory of Builtin"}


@dataclass(frozen=True, kw_only=True)
class Run:
    """What one strategy did, in arrays (steps, worlds)."""

    start: str
    solver: str
    max_sweeps: int
    tolerance: float
    sweeps: np.ndarray
    change: np.ndarray
    contacts: np.ndarray
    """Contacts that press or overlap."""
    start_error: tuple[float, float]
    """Mean squared difference of start and final impulse over all contacts, normal and tangential [N^2 s^2]."""
    wall_s: float
    """Wall time of all steps, without that of a strategy which is no part of the method [s]."""
    strategy_s: float
    """Wall time in the strategy, for Copy that of the solve in advance [s]."""
    decay: np.ndarray | None = field(default=None, repr=False)
    """Largest impulse change of sweep n, median over the states with contacts, (max_sweeps,) [N s]."""
    loop: str = "closed"
    """A key of ``PATHS``."""
    errors: np.ndarray | None = field(default=None, repr=False)
    """Mean squared difference of start and final impulse, (steps, worlds, 2) [N^2 s^2]; NaN without contacts."""
    parts: Mapping[str, float] = field(default_factory=dict)
    """Wall time by part (``PARTS``) [s]."""
    counts: Mapping[str, float] = field(default_factory=dict)
    """Of a network, worlds times steps: "calls", "skipped" (not needed), "dropped" (worse than the cache, or NaN)."""

    @property
    def label(self) -> str:
        """For legends and tables."""
        return f"{self.start.capitalize()}, {self.solver}"

    @property
    def with_contacts(self) -> np.ndarray:
        """The states that the statistics count, bool (steps, worlds)."""
        return self.contacts > 0

    @property
    def converged(self) -> np.ndarray:
        """Whether the solve ended below the tolerance, bool (steps, worlds)."""
        return (self.sweeps < self.max_sweeps) | (self.change <= self.tolerance)

    @property
    def world_means(self) -> np.ndarray:
        """Mean sweeps of each world over its states with contacts, (worlds,)."""
        states = self.with_contacts
        return np.where(states, self.sweeps, 0).sum(axis=0) / np.maximum(states.sum(axis=0), 1)

    def summary(self) -> dict[str, Any]:
        """The row of the table, over the states with contacts."""
        states = self.with_contacts
        sweeps, converged = self.sweeps[states], self.converged[states]
        count = max(len(sweeps), 1)
        return {
            "label": self.label,
            "start": self.start,
            "solver": self.solver,
            "loop": self.loop,
            "states": len(sweeps),
            "mean_sweeps": float(sweeps.sum() / count),
            "median_sweeps": float(np.median(sweeps)) if len(sweeps) else 0.0,
            "world_mean_sweeps": self.world_means.tolist(),
            "done_in": {str(n): float(((sweeps <= n) & converged).sum() / count) for n in DONE_IN},
            "contacts": float(self.contacts[states].sum() / count),
            "start_error_normal": self.start_error[0],
            "start_error_tangent": self.start_error[1],
            "wall_s": self.wall_s,
            "strategy_s": self.strategy_s,
            "parts_s": dict(self.parts),
            "counts": dict(self.counts),
        }


def against(run: Run, base: Run) -> dict[str, Any]:
    """What a run needs over another one on the same worlds: ratios, and in how many worlds it needs fewer sweeps."""
    mine, other = run.summary(), base.summary()
    return {
        "sweeps_ratio": _ratio(mine["mean_sweeps"], other["mean_sweeps"]),
        "median_ratio": _ratio(mine["median_sweeps"], other["median_sweeps"]),
        "worlds_better": int((run.world_means < base.world_means).sum()),
        "wall_ratio": _ratio(run.wall_s, base.wall_s),
    }


def _ratio(a: float, b: float) -> float | None:
    return a / b if b > 0 else None


def summaries(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """The row of each run; "over_builtin" compares it with Builtin of the same solver and loop, if that has run."""
    bases = {(run.solver, run.loop): run for run in runs if run.start == BASE}
    rows = []
    for run in runs:
        base = bases.get((run.solver, run.loop))
        rows.append({**run.summary(), "over_builtin": None if base is None else against(run, base)})
    return rows


# ------------------------------------------------------------------ tables


@dataclass(frozen=True)
class Column:
    """A column of the table."""

    title: str
    text: Callable[[dict[str, Any]], str]


def _share(sweeps: int) -> Callable[[dict[str, Any]], str]:
    return lambda row: f"{100.0 * row['done_in'][str(sweeps)]:.0f} %"


def _spread(row: dict[str, Any]) -> str:
    means = row["world_mean_sweeps"]
    return f"{min(means):.0f}-{max(means):.0f}"


def _over(row: dict[str, Any]) -> str:
    ratio = (row["over_builtin"] or {}).get("sweeps_ratio")
    return "-" if ratio is None else f"{ratio:.2f}"


def _calls(row: dict[str, Any]) -> str:
    return f"{row['counts']['calls'] / max(row['states'], 1):.2f}" if row["counts"] else "-"


_LABEL = Column("start, solver", lambda row: row["label"])
_MEAN = Column("mean", lambda row: f"{row['mean_sweeps']:.0f}")
_MEDIAN = Column("median", lambda row: f"{row['median_sweeps']:.0f}")
_WALL = Column("wall [s]", lambda row: f"{row['wall_s']:.2f}")
COLUMNS = (
    _LABEL,
    _MEAN,
    _MEDIAN,
    *(Column(f"<={n}", _share(n)) for n in DONE_IN),
    Column("contacts", lambda row: f"{row['contacts']:.0f}"),
    _WALL,
)
"""Of the protocol."""
EVALUATION = (
    _LABEL,
    _MEAN,
    _MEDIAN,
    Column("worlds", _spread),
    Column("/builtin", _over),
    *(Column(f"<={n}", _share(n)) for n in DONE_IN),
    Column("MSE normal", lambda row: f"{row['start_error_normal']:.2g}"),
    Column("tangent", lambda row: f"{row['start_error_tangent']:.2g}"),
    Column("calls", _calls),
    _WALL,
)
"""Of the evaluation."""


def cells(runs: Sequence[Run], columns: Sequence[Column] = COLUMNS) -> list[list[str]]:
    """The table's rows as text."""
    return [[column.text(row) for column in columns] for row in summaries(runs)]


def table(runs: Sequence[Run], columns: Sequence[Column] = COLUMNS) -> str:
    """The table for people, with what its columns mean below."""
    rows = [[column.title for column in columns], *cells(runs, columns)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(columns))]
    lines = []
    for row in rows:
        first = row[0].ljust(widths[0])
        lines.append("  ".join([first, *(text.rjust(width) for text, width in zip(row[1:], widths[1:]))]))
    lines.insert(1, "-" * len(lines[0]))
    worlds = runs[0].sweeps.shape[1]
    total = runs[0].sweeps.size
    counted = sorted({int(run.with_contacts.sum()) for run in runs})
    many = f"{counted[0]}" if len(counted) == 1 else f"{counted[0]} to {counted[-1]}"
    lines.append(f"sweeps per step over the states in which a contact presses ({many} of {total}, {worlds} worlds);")
    lines.append(f"<=n: share of them that reached the tolerance of {runs[0].tolerance:g} N s in n sweeps.")
    if columns is EVALUATION:
        lines.append("worlds: least and largest mean of a world; /builtin: mean over that of Builtin, same solver;")
        lines.append("MSE: start against solution [N^2 s^2]; calls: of the network for a state.")
    lines.append("wall: all steps, networks included; a start that is no method (Copy: a solve in advance) left out")
    return "\n".join(lines)
