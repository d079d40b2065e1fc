"""Solving packed rows in either schedule: launches, and what a solve reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, kernel_array
from dc_kernels.model.config import ACCELERATIONS, METHODS, STOPS, SolverConfig
from dc_kernels.model.fields import STATS
from dc_kernels.runtime.backends import Launch, bind
from dc_kernels.solve.iteration import COUNTERS, NEVER
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation


class SolveStats(ArrayGroup):
    """What the last solve of each world did (``model.fields.STATS``), and its history on request."""

    table = STATS
    history: Any
    """Largest impulse change of each sweep [N s], (W, max_sweeps), zero beyond ``sweeps``; (W, 0) unless asked for."""

    def allocate_history(self, config: SolverConfig) -> None:
        """Room for ``history`` as a configuration wants it."""
        shape = (self.sizes["world"], config.max_sweeps if config.history else 0)
        zeros = np.zeros(shape, self.dtype)
        if self.device == "cpu":
            self.history = kernel_array(zeros, self.backend)
        else:
            import warp as wp

            self.history = wp.array(zeros, device=self.device)


def solver_scalars(config: SolverConfig) -> dict[str, Any]:
    """Scalar kernel arguments of the solve by name."""
    return {
        "method": METHODS[config.method],
        "acceleration": ACCELERATIONS[config.acceleration],
        "max_sweeps": config.max_sweeps,
        "min_sweeps": config.min_sweeps,
        "tolerance": config.tolerance,
        # a float32 kernel argument holds no product of inf and 0
        "relative_tolerance": min(config.relative_tolerance, 1e30),
        "stop": STOPS[config.stop],
        "residual_every": config.residual_every,
        "omega": config.omega if config.acceleration == "sor" else 1.0,
        "period_min": config.aitken_period,
        "period_max": config.aitken_period_max,
        "cap": config.aitken_cap,
        "threshold": config.aitken_threshold,
        "patience": config.aitken_patience,
        "stretch": config.stretch,
        "resume": 0,
        "pause": NEVER,
    }


# settings of the iteration alone: rows, contacts and the room reserved do not depend on them
ITERATION = (
    "acceleration",
    "max_sweeps",
    "min_sweeps",
    "tolerance",
    "relative_tolerance",
    "stop",
    "residual_every",
    "omega",
    "aitken_period",
    "aitken_period_max",
    "aitken_cap",
    "aitken_threshold",
    "aitken_patience",
    "stretch",
)


def check_iteration(config: SolverConfig, own: SolverConfig) -> None:
    """Raise ValueError, naming the setting, where ``config`` differs from the simulation's ``own`` in others."""
    for name, value in own.to_dict().items():
        if name not in ITERATION and getattr(config, name) != value:
            raise ValueError(
                f"config.{name} is {getattr(config, name)!r}, the simulation's is {value!r}; one solve may differ in "
                f"{', '.join(ITERATION)} only"
            )
    if own.history and config.max_sweeps > own.max_sweeps:
        raise ValueError(
            f"config.max_sweeps is {config.max_sweeps}; the simulation keeps the history of {own.max_sweeps} sweeps"
        )


def world_schedule(sim: Simulation, first: int, count: int, values: Mapping[str, Any]) -> list[Launch]:
    """One launch a solve: a thread runs a world's sweeps to the end. For many worlds, and on a CPU."""
    return [sim.bind("solve_world", first, count, values), sim.bind("unpack_impulses", first, count)]


def color_schedule(sim: Simulation, first: int, count: int, values: Mapping[str, Any]) -> list[Launch]:
    """A launch a colour, a thread a row, driven from the host. For large worlds on a GPU."""
    begin = sim.bind("begin", first, count, values)
    before = sim.bind("before_sweep", first, count, values)
    after = sim.bind("after_sweep", first, count, values)
    finish = sim.bind("finish", first, count, values)
    unpack = sim.bind("unpack_impulses", first, count)
    max_sweeps = {**sim.values, **values}["max_sweeps"]
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
                {**sim.values, **values, "world_offset": first, "color": color},
                sim.device,
            )
            for color in np.flatnonzero(widest)
        ]
        # a world that is done ignores further launches, so the stop need not be read after each sweep on a GPU
        stride = 1 if sim.device == "cpu" else 8
        done = 0
        while not _all_done(sim, first, count):
            for _ in range(min(stride, max_sweeps - done)):
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
