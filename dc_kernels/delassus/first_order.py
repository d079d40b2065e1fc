"""First-order solves of a Delassus problem: sweeps, accelerated in between, one launch each."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from dc_kernels.delassus.groups import (
    MEMORY,
    PROGRESS,
    SETTINGS,
    Acceleration,
    PackedProblem,
    SearchMemory,
    SearchState,
)
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.runtime.backends import bind, kernel_file, make_kernels
from dc_kernels.runtime.threads import in_main_thread, run_apart, uninterrupted

WINDOW = 5  # earlier sweeps that Anderson's combination takes
LONG = 10_000_000  # contacts times sweeps from which an interrupt is looked for: 0.1 to 0.3 s
GROWTH = 1.0  # of a step's squared norm at which its last combination is taken back
DEFAULT = SolverConfig()
AITKEN = ("aitken_period", "aitken_period_max", "aitken_cap", "aitken_threshold")  # settings taken from it


def delassus_kernels(backend: str, dtype: str) -> dict[str, Any]:
    """Look up the kernels: map_delassus, solve_delassus."""
    return make_kernels(backend, "delassus.first_order", dtype)


class FirstOrder:
    """A first-order solve as its kernel takes it, in the problem's units; it may run again with other settings.

    Attributes:
        impulse: to begin with, then after the last sweep, (n, 2).
        best: impulses with the least natural maps of all looks, (n, 2).
        history: natural map and scaled map of each look, as far as there is room, (looks, 2).
    """

    def __init__(self, problem: PackedProblem, acceleration: Acceleration, looks: int) -> None:
        """Allocate impulses and scratch.

        Args:
            problem: what is solved; its arrays may change between runs.
            acceleration: what is done between two sweeps.
            looks: rows of history kept.
        """
        dtype, backend, n = problem.dtype.name, problem.backend, problem.sizes["contact"]
        self._kernel = delassus_kernels(backend, dtype)["solve_delassus"]
        groups = kernel_file(backend, "groups")
        self.acceleration, self.looks = acceleration, looks
        self._compiled, self._cut = backend == "warp", aligned_zeros((1,), np.dtype(np.int32))
        state = SearchState({"contact": n, "look": looks}, dtype, backend=backend)
        self.impulse, self.best, self._direction, self.history = (
            state.numpy(name) for name in ("impulse", "best", "direction", "history")
        )
        memory = groups.group("delassus_memory", dtype, MEMORY, {})
        if acceleration is Acceleration.ANDERSON:
            sizes = {"contact": n, "remembered contact": WINDOW * n, "window": WINDOW}
            memory = groups.array_group(SearchMemory(sizes, dtype, backend=backend), "delassus_memory")
        progress, self._progress = groups.element_array("delassus_progress", dtype, PROGRESS)
        values = {
            "scale": problem.scale,
            "method": int(acceleration),
            "patience": 0,
            "gain": 0.5,
            "omega": 1.0,
            "window": WINDOW,
            "growth": GROWTH,
            "cut": self._cut.ctypes.data,
            **{name: getattr(DEFAULT, name) for name in AITKEN},
        }
        self._settings = groups.group("delassus_settings", dtype, SETTINGS, values)
        self._values = {
            "settings": self._settings,
            "problem": problem.struct,
            "search": groups.array_group(state, "delassus_search"),
            "memory": memory,
            "progress": progress,
        }

    def __call__(self, start: np.ndarray, **settings: Any) -> np.void:
        """Sweep.

        Args:
            start: impulses to begin with, (n, 2).
            settings: fields of ``groups.SETTINGS``; others stay as they were.

        Returns:
            What was done, by the names of ``groups.PROGRESS``.
        """
        self.impulse[...] = self.best[...] = start
        self._direction[...] = start if self.acceleration is Acceleration.HYBRID else 0.0
        for name, value in settings.items():
            setattr(self._settings, name, value)
        launch = bind(self._kernel, 1, self._values, "cpu")
        if self._compiled and in_main_thread() and len(self.impulse) * self._settings.max_sweeps > LONG:
            run_apart(launch, self._interrupt)
        else:
            launch()
        return self._progress[0]

    def _interrupt(self, ended: threading.Event) -> None:
        """End the solve after the sweep that it is in."""
        with uninterrupted():
            self._cut[0] = 1
            ended.wait()


@contextlib.contextmanager
def lent(problem: PackedProblem, acceleration: Acceleration, looks: int) -> Iterator[FirstOrder]:
    """Lend a first-order solve of a problem with room for so many looks.

    Its memory serves the next one, since to allocate it takes as long as hundreds of sweeps of a small problem. Each
    thread that asks at one time gets its own.
    """
    idle = problem.idle.setdefault(acceleration, [])
    try:
        run = idle.pop()
    except IndexError:
        run = None
    if run is None or run.looks < looks:
        run = FirstOrder(problem, acceleration, looks)
    yield run
    idle.append(run)
