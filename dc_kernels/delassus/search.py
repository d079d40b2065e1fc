"""A solve of a Delassus problem in progress: first-order methods by one kernel, and the best impulses so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from dc_kernels.delassus.first_order import lent
from dc_kernels.delassus.groups import Acceleration, Reason
from dc_kernels.delassus.problem import DelassusProblem
from dc_kernels.model.settings import Count, Limits, Positive, Settings, Whole

Method = Literal["auto", "pgs", "sor", "aitken", "nncg", "anderson", "hybrid", "newton"]
Dtype = Literal["float32", "float64"]
METHODS = {
    "pgs": Acceleration.NONE,
    "sor": Acceleration.NONE,
    "aitken": Acceleration.AITKEN,
    "nncg": Acceleration.NNCG,
    "anderson": Acceleration.ANDERSON,
    "hybrid": Acceleration.HYBRID,
}
"""Methods of one kernel; "auto" and "newton" are made of them and of ``newton``."""
HUGE, LEAST = 3e38, 1e-30  # tolerances that float32 can hold
LOOKS = 200_000  # rows of history kept of a phase


@dataclass(frozen=True, kw_only=True)
class SolveOptions(Settings):
    """Arguments of ``solve`` beside the problem and the start; see there."""

    method: Method = "auto"
    tolerance: Positive = 1e-8
    max_sweeps: Whole = 100_000
    scaled: bool = True
    every: Count = 5
    omega: Annotated[float, Limits(above=0.0, below=2.0)] = 1.4
    dtype: Dtype = "float64"
    backend: Literal["warp", "numpy"] = "warp"


@dataclass(frozen=True, kw_only=True, eq=False)
class DelassusSolution:
    """What a solve found: of all impulses that it looked at, those with the least natural maps."""

    impulses: np.ndarray
    """(n, 2) [N s]."""
    residual: float
    """Relative natural map (``DelassusProblem.natural_map``)."""
    scaled_residual: float
    """Relative natural map without units (``DelassusProblem.scaled_map``)."""
    converged: bool
    """Whether the residuals that were asked for are within the tolerance."""
    sweeps: int
    """Sweeps, those before and beside Newton's method included."""
    pivotings: int
    """Problems, whole or patches of at most 80 contacts, solved by Lemke's pivots."""
    factorizations: int
    """LU factorisations of Newton's method."""
    history: np.ndarray
    """At each look: sweeps so far, relative natural map, scaled one, (looks, 3)."""


class Search:
    """A solve in progress: the best impulses so far, and what they cost."""

    def __init__(
        self,
        problem: DelassusProblem,
        start: np.ndarray,
        options: SolveOptions,
    ) -> None:
        """Begin at the impulses ``start``, (n, 2) [N s]."""
        self.problem = problem
        self.options = options
        self.sweeps = 0
        self.pivotings = 0
        self.factorizations = 0
        self.reason = Reason.SWEEPS
        self.rows: list[np.ndarray] = []
        self.best = problem.inside(start)
        self.maps = self.measure(self.best)

    def measure(self, impulses: np.ndarray) -> tuple[float, float]:
        """Measure both natural maps in float64."""
        return self.problem.natural_maps(impulses)

    def worst(self, maps: tuple[float, float]) -> float:
        """Return the natural map that decides whether a solve has converged."""
        return max(maps) if self.options.scaled else maps[0]

    @property
    def done(self) -> bool:
        """Whether the best impulses are good enough."""
        return self.worst(self.maps) <= self.options.tolerance

    def offer(self, impulses: np.ndarray) -> bool:
        """Keep impulses if they are better than the best so far, and return whether they are."""
        maps = self.measure(impulses)
        self.rows.append(np.array([[self.sweeps, *maps]]))
        better = self.worst(maps) < self.worst(self.maps)
        if better:
            self.best, self.maps = impulses, maps
        return better

    def sweep(
        self,
        method: str,
        sweeps: int,
        *,
        patience: int = 0,
        gain: float = 0.5,
        start: np.ndarray | None = None,
    ) -> np.ndarray:
        """Sweep so many times at most from ``start`` (None: the best impulses) and return the last impulses.

        Args:
            method: key of ``METHODS``.
            sweeps: at most.
            patience: end where the maps have not fallen to ``gain`` times for so many looks; 0: never.
            gain: share to which the maps have to fall within ``patience`` looks [1].
            start: (n, 2) [N s].
        """
        x = self.best if start is None else start
        sweeps = min(sweeps, self.options.max_sweeps - self.sweeps)
        if sweeps <= 0 or self.done or not self.problem.count:
            return x
        looks = min(-(-sweeps // self.options.every), LOOKS)
        unit = self.problem.units[0]
        with lent(self.problem.packed(self.options.dtype, self.options.backend), METHODS[method], looks) as run:
            progress = run(
                x / unit,
                max_sweeps=sweeps,
                every=self.options.every,
                patience=patience,
                gain=gain,
                tolerance=max(self.options.tolerance, LEAST),
                scaled_tolerance=max(self.options.tolerance, LEAST) if self.options.scaled else HUGE,
                omega=self.options.omega if method == "sor" else 1.0,
            )
            looks = min(int(progress["looks"]), looks)
            row = np.empty((looks, 3))
            row[:, 0] = self.sweeps + np.minimum(self.options.every * np.arange(1, looks + 1), progress["sweeps"])
            row[:, 1:] = run.history[:looks]
            self.rows.append(row)
            self.sweeps += int(progress["sweeps"])
            self.reason = Reason(progress["reason"])
            found, last = run.best.astype(np.float64) * unit, run.impulse.astype(np.float64) * unit
        maps = self.measure(found)
        if self.worst(maps) < self.worst(self.maps):
            self.best, self.maps = found, maps
        return last

    def solution(self) -> DelassusSolution:
        """Return the best impulses and what they cost."""
        history = np.concatenate(self.rows) if self.rows else np.zeros((0, 3))
        return DelassusSolution(
            impulses=self.best,
            residual=self.maps[0],
            scaled_residual=self.maps[1],
            converged=self.done,
            sweeps=self.sweeps,
            pivotings=self.pivotings,
            factorizations=self.factorizations,
            history=history,
        )
