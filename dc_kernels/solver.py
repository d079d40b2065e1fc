"""Solving packed rows in either schedule: launches, and what a solve reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import ArrayGroup
from .backend import Launch, bind
from .types import ACCELERATIONS, COLORS, COUNTERS, LANES, METHODS, SERIAL_COLOR, STATS, STOPS, SolverConfig

if TYPE_CHECKING:
    from .step import Simulation


class SolveStats(ArrayGroup):
    """What the last solve of each world did (``types.STATS``), and its history on request."""

    table = STATS
    history: Any
    """Largest impulse change of each sweep [N s], (W, max_sweeps), zero beyond ``sweeps``; (W, 0) unless asked for."""

    def allocate_history(self, config: SolverConfig) -> None:
        """Room for ``history`` as a configuration wants it."""
        shape = (self.sizes["world"], config.max_sweeps if config.history else 0)
        if self.backend == "numpy":
            self.history = np.zeros(shape, self.dtype)
        else:
            import warp as wp

            self.history = wp.zeros(shape, dtype=wp.dtype_from_numpy(self.dtype), device=self.device)


def solver_scalars(config: SolverConfig) -> dict[str, Any]:
    """Scalar kernel arguments of the solve by name."""
    return {
        "method": METHODS[config.method],
        "acceleration": ACCELERATIONS[config.acceleration],
        "max_sweeps": config.max_sweeps,
        "tolerance": config.tolerance,
        "stop": STOPS[config.stop],
        "residual_every": config.residual_every,
        "omega": config.omega if config.acceleration == "sor" else 1.0,
        "period_min": config.aitken_period,
        "period_max": config.aitken_period_max,
        "cap": config.aitken_cap,
        "threshold": config.aitken_threshold,
        "patience": config.aitken_patience,
    }


def world_schedule(sim: Simulation, first: int, count: int) -> list[Launch]:
    """One launch a solve: a thread runs a world's sweeps to the end. For many worlds, and on a CPU."""
    return [sim.bind("solve_world", first, count), sim.bind("unpack_impulses", first, count)]


def color_schedule(sim: Simulation, first: int, count: int) -> list[Launch]:
    """A launch a colour, a thread a row, driven from the host. For large worlds on a GPU."""
    begin = sim.bind("begin", first, count)
    before = sim.bind("before_sweep", first, count)
    after = sim.bind("after_sweep", first, count)
    finish = sim.bind("finish", first, count)
    unpack = sim.bind("unpack_impulses", first, count)
    sweep_color = sim.kernels["sweep_color"]

    def run() -> None:
        begin()
        ends = sim.rows.numpy("color_block").reshape(-1, COLORS + 1)[first : first + count]
        live = sim.state.numpy("flags")[first : first + count] == 0
        widest = np.where(live[:, None], np.diff(ends, axis=1), 0).max(axis=0) * LANES
        sweeps = [
            bind(
                sweep_color,
                (count, 1 if color == SERIAL_COLOR else int(widest[color])),
                {**sim.values, "world_offset": first, "color": color},
                sim.device,
            )
            for color in np.flatnonzero(widest)
        ]
        # a world that is done ignores further launches, so the stop need not be read after each sweep on a GPU
        stride = 1 if sim.device == "cpu" else 8
        done = 0
        while not _all_done(sim, first, count):
            for _ in range(min(stride, sim.config.max_sweeps - done)):
                before()
                for sweep in sweeps:
                    sweep()
                after()
            done += stride
        finish()
        unpack()

    return [run]


def _all_done(sim: Simulation, first: int, count: int) -> bool:
    done = sim.stats.numpy("counters").reshape(-1, COUNTERS)[first : first + count, 3] != 0
    return bool((done | (sim.state.numpy("flags")[first : first + count] != 0)).all())


SCHEDULES: dict[str, Callable[..., list[Launch]]] = {"world": world_schedule, "color": color_schedule}
