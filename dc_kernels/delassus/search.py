"""A solve of a Delassus problem in progress: first-order methods by one kernel, and the best impulses so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.delassus.problem import DelassusProblem
from dc_kernels.model.arrays import kernel_array, kernel_vectors, to_numpy
from dc_kernels.model.config import SolverConfig
from dc_kernels.runtime.backends import bind, make_kernels

METHODS = {"pgs": 0, "sor": 0, "aitken": 1, "nncg": 2, "anderson": 3, "hybrid": 4}
"""Methods of one kernel; "auto" and "newton" are made of them and of ``newton``."""
REASONS = ("sweeps", "converged", "stalled")
HUGE, LEAST = 3e38, 1e-30  # tolerances that float32 can hold
LOOKS = 200_000  # rows of history kept of a phase
WINDOW = 5  # earlier sweeps that Anderson's combination takes
DEFAULT = SolverConfig()  # of the Aitken extrapolation
GROWTH = 1.0  # of a step's squared norm at which its last combination is taken back


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


def delassus_kernels(backend: str, dtype: str) -> dict[str, Any]:
    """Look up the kernels: map_delassus, solve_delassus."""
    return make_kernels(backend, "delassus.search", dtype)


class Search:
    """A solve in progress: the best impulses so far, and what they cost."""

    def __init__(
        self,
        problem: DelassusProblem,
        start: np.ndarray,
        tolerance: float,
        scaled: bool,
        max_sweeps: int,
        every: int,
        omega: float,
        dtype: str,
        backend: str,
    ) -> None:
        """Arguments as of ``solve``."""
        self.problem = problem
        self.tolerance = tolerance
        self.scaled = scaled
        self.max_sweeps = max_sweeps
        self.every = every
        self.omega = omega
        self.dtype = dtype
        self.backend = backend
        self.sweeps = 0
        self.pivotings = 0
        self.factorizations = 0
        self.reason = REASONS[0]
        self.rows: list[np.ndarray] = []
        self.best = problem.inside(start)
        self.maps = self.measure(self.best)

    def measure(self, impulses: np.ndarray) -> tuple[float, float]:
        """Both natural maps."""
        return self.problem.natural_maps(impulses)

    def worst(self, maps: tuple[float, float]) -> float:
        """The map that decides."""
        return max(maps) if self.scaled else maps[0]

    @property
    def done(self) -> bool:
        """Whether the best impulses are good enough."""
        return self.worst(self.maps) <= self.tolerance

    def offer(self, impulses: np.ndarray) -> bool:
        """Keep impulses if they are better; whether they are."""
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
        """A first-order solve of so many sweeps at most from ``start`` (None: the best impulses); its last impulses.

        Args:
            method: key of ``METHODS``.
            sweeps: at most.
            patience: end where the maps have not fallen to ``gain`` times for so many looks; 0: never.
            gain: see patience.
            start: (n, 2) [N s].
        """
        x = self.best if start is None else start
        sweeps = min(sweeps, self.max_sweeps - self.sweeps)
        if sweeps <= 0 or self.done or not self.problem.count:
            return x
        values, last, best = self.arguments(method, sweeps, patience, x, gain)
        kernel = delassus_kernels(self.backend, self.dtype)["solve_delassus"]
        bind(kernel, 1, values, "cpu")()
        counters, history = to_numpy(values["counters"]), to_numpy(values["history"])
        looks = min(int(counters[1]), len(history))
        row = np.empty((looks, 3))
        row[:, 0] = self.sweeps + np.minimum(self.every * np.arange(1, looks + 1), counters[0])
        row[:, 1:] = history[:looks]
        self.rows.append(row)
        self.sweeps += int(counters[0])
        self.reason = REASONS[counters[2]]
        unit = self.problem.units[0]
        found = best.astype(np.float64) * unit
        maps = self.measure(found)
        if self.worst(maps) < self.worst(self.maps):
            self.best, self.maps = found, maps
        return last.astype(np.float64) * unit

    def arguments(
        self, method: str, sweeps: int, patience: int, start: np.ndarray, gain: float = 0.5
    ) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        """Arguments of ``solve_delassus`` by name, and the arrays of its last and its best impulses."""
        real, n, backend = np.dtype(self.dtype), self.problem.count, self.backend
        last = np.ascontiguousarray(start / self.problem.units[0], real)
        best = last.copy()
        room = WINDOW if method == "anderson" else 1  # others use none of it
        config = DEFAULT
        values: dict[str, Any] = {
            **self.problem.packed(self.dtype, backend),
            "method": METHODS[method],
            "max_sweeps": sweeps,
            "every": self.every,
            "patience": patience,
            "gain": gain,
            "tolerance": max(self.tolerance, LEAST),
            "scaled_tolerance": max(self.tolerance, LEAST) if self.scaled else HUGE,
            "omega": self.omega if method == "sor" else 1.0,
            "period_min": config.aitken_period,
            "period_max": config.aitken_period_max,
            "cap": config.aitken_cap,
            "threshold": config.aitken_threshold,
            "window": room,
            "growth": GROWTH,
            "impulse": kernel_vectors(last, backend),
            "best": kernel_vectors(best, backend),
            "counters": kernel_array(np.zeros(3, np.int32), backend),
            "history": kernel_array(np.zeros((min(-(-sweeps // self.every), LOOKS), 2), real), backend),
            "gram": kernel_array(np.zeros((2 * room, room), real), backend),
            "weight": kernel_array(np.zeros(room, real), backend),
        }
        for name in ("step", "before"):
            values[name] = kernel_vectors(np.zeros((n, 2), real), backend)
        values["direction"] = kernel_vectors(last.copy() if method == "hybrid" else np.zeros((n, 2), real), backend)
        for name in ("end_change", "step_change"):
            values[name] = kernel_vectors(np.zeros((room * n, 2), real), backend)
        return values, last, best

    def solution(self) -> DelassusSolution:
        """The best impulses."""
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
