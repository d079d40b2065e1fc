"""What a start did on the thesis worlds, and what it needs beside another one.

Statistics are over the states (steps of a world) in which a contact presses or overlaps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

DONE_IN = (10, 50, 100, 200, 1000)
"""Sweeps of the table's shares [1]."""
PARTS = ("collide", "start", "features", "splat", "network", "gather", "solve", "advance")
"""Where the wall time of a step goes, in its order; "start" is what a start needs beyond the parts that are named."""
BASE = "builtin"
"""The start that others are compared with."""
PATHS = {"closed": "each on a trajectory of its own", "open": "all on the trajectory of Builtin"}
"""What each loop gives the starts."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """What one start did."""

    start: str
    """Label of the start."""
    solver: str
    """Name of the solver."""
    max_sweeps: int
    """Largest number of sweeps of a solve [1]."""
    tolerance: float
    """Impulse change of a sweep at which a solve ends [N s]."""
    sweeps: np.ndarray
    """Sweeps of each solve, (steps, worlds) [1]."""
    change: np.ndarray
    """Largest impulse change of the last sweep, (steps, worlds) [N s]."""
    contacts: np.ndarray
    """Number of contacts that press or overlap, (steps, worlds) [1]."""
    start_error: tuple[float, float]
    """Mean squared difference of start and final impulse over all contacts, normal and tangential [N^2 s^2]."""
    wall_s: float
    """Wall time of all steps, without that of a start which is no part of the method [s]."""
    strategy_s: float
    """Wall time in the start, for Copy that of the solve in advance [s]."""
    decay: np.ndarray | None = field(default=None, repr=False)
    """Largest impulse change of sweep n, median over the states with contacts, (max_sweeps,) [N s]."""
    loop: str = "closed"
    """Loop of the run, a key of ``PATHS``."""
    errors: np.ndarray | None = field(default=None, repr=False)
    """Mean squared difference of start and final impulse, (steps, worlds, 2) [N^2 s^2]; NaN without contacts."""
    parts: Mapping[str, float] = field(default_factory=dict)
    """Wall time by part (``PARTS``) [s]."""
    counts: Mapping[str, float] = field(default_factory=dict)
    """Numbers of a network, in worlds times steps; those of ``starts.start.Report.counts``."""

    @property
    def label(self) -> str:
        """Name of the run in legends and tables."""
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
        """Return the row of the table, over the states with contacts."""
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
    """Compare a run with another one on equal worlds: ratios, and in how many worlds it needs fewer sweeps."""
    mine, other = run.summary(), base.summary()
    return {
        "sweeps_ratio": _ratio(mine["mean_sweeps"], other["mean_sweeps"]),
        "median_ratio": _ratio(mine["median_sweeps"], other["median_sweeps"]),
        "worlds_better": int((run.world_means < base.world_means).sum()),
        "wall_ratio": _ratio(run.wall_s, base.wall_s),
    }


def _ratio(a: float, b: float) -> float | None:
    """Divide; None where there is nothing to divide by."""
    return a / b if b > 0 else None


def summaries(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the row of each run; "over_builtin" compares it with Builtin of its solver and loop, if that has run."""
    bases = {(run.solver, run.loop): run for run in runs if run.start == BASE}
    rows = []
    for run in runs:
        base = bases.get((run.solver, run.loop))
        rows.append({**run.summary(), "over_builtin": None if base is None else against(run, base)})
    return rows
