"""Solving packed rows in either schedule: launches, and what a solve reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Protocol

import numpy as np

from dc_kernels.model.arrays import State
from dc_kernels.model.config import ACCELERATIONS, SolverConfig, check_config
from dc_kernels.model.settings import Limits, checker
from dc_kernels.runtime.backends import Launch, bind
from dc_kernels.solve.iteration import NEVER
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR
from dc_kernels.solve.storage import Rows, SolveStats

_pause = checker(Annotated[int, Limits(least=0, below=NEVER)])
SOLVES = 64  # settings of single solves whose launches are kept
# settings of the iteration alone: rows, contacts and the room reserved do not depend on them
ITERATION = (
    "acceleration",
    "max_sweeps",
    "min_sweeps",
    "tolerance",
    "relative_tolerance",
    "stop",
    "motion_tolerance",
    "motion_share",
    "motion_mean",
    "residual_every",
    "omega",
    "aitken_period",
    "aitken_period_max",
    "aitken_cap",
    "aitken_threshold",
    "aitken_patience",
    "stretch",
)


class Solver(Protocol):
    """What has packed rows to solve: a simulation, or a solver of other engines' contacts."""

    device: str
    kernels: Mapping[str, Any]
    state: State
    rows: Rows
    stats: SolveStats

    @property
    def config(self) -> SolverConfig:
        """Settings of the solver."""

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """A launch of a kernel over the worlds first .. first + count, one thread each; with ``changed`` arguments."""

    def launch_values(self, first: int, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of the kernels for worlds from ``first`` on, with ``changed`` settings or numbers of the launch."""


def check_iteration(config: SolverConfig, own: SolverConfig) -> None:
    """Raise ValueError, naming the setting, where ``config`` differs from its solver's ``own`` in others."""
    for name, value in own.to_dict().items():
        if name not in ITERATION and getattr(config, name) != value:
            raise ValueError(
                f"config.{name} is {getattr(config, name)!r}, the solver's is {value!r}; one solve may differ in "
                f"{', '.join(ITERATION)} only"
            )
    if own.history and config.max_sweeps > own.max_sweeps:
        raise ValueError(
            f"config.max_sweeps is {config.max_sweeps}; the solver keeps the history of {own.max_sweeps} sweeps"
        )


def check_schedule(config: SolverConfig, schedule: str) -> None:
    """Raise ValueError for a schedule that has no kernels of the method."""
    if config.soft and schedule != "world":
        raise ValueError(f"schedule is {schedule!r}; method 'tgs_soft' runs with 'world' only")


def check_change(config: SolverConfig, before: SolverConfig, ran: str, schedule: str) -> None:
    """Raise ValueError where a method cannot follow another one after the phase that ran last."""
    check_schedule(config, schedule)
    if config.soft != before.soft and ran == "solve":
        raise ValueError(
            f"config.method is {config.method!r}, of the step in flight {before.method!r}: finish it with advance()"
        )
    if config.contact_switches != before.contact_switches and ran != "advance":
        raise ValueError(
            "config.contact_switches changes in the middle of a step: finish it with solve() and advance()"
        )


def check_solve(
    config: SolverConfig | None, pause: int | None, resume: bool, schedule: str, soft: bool = False
) -> tuple[SolverConfig | None, int | None]:
    """Return settings and pause of one solve.

    Raises:
        TypeError, ValueError: for others, or a solve that cannot pause.
    """
    config = None if config is None else check_config("config", config)
    pause = None if pause is None else _pause("pause", pause)
    if (pause is not None or resume) and schedule != "world":
        raise ValueError(f"schedule is {schedule!r}; only 'world' can pause a solve")
    if (pause is not None or resume) and soft:
        raise ValueError("SolverConfig.method is 'tgs_soft'; only a solve of sweeps can pause")
    return config, pause


def settings_of_solve(config: SolverConfig, pause: int | None, resume: bool) -> dict[str, Any]:
    """Settings and numbers of a launch of one solve, which may pause or go on."""
    changed = config.kernel_values()
    if (pause is not None or resume) and changed["acceleration"] == ACCELERATIONS["adaptive"]:
        changed["acceleration"] = ACCELERATIONS["aitken"]  # what a stretch remembers outlives no launch
    return {**changed, "resume": int(resume), "pause": NEVER if pause is None else pause}


def world_schedule(solver: Solver, first: int, count: int, values: Mapping[str, Any]) -> list[Launch]:
    """One launch a solve: a thread runs a world's sweeps to the end. For many worlds, and on a CPU."""
    unpack = solver.bind("unpack_impulses", first, count)
    if not solver.config.soft:
        return [solver.bind("solve_world", first, count, values), unpack]
    if "make_joint_rows" not in solver.kernels:
        return [solver.bind("solve_soft", first, count, values), unpack]
    launches = []
    for k in range(solver.config.substeps + 1):
        part = {**values, "resume": k, "pause": 1}
        if k > 0:  # joints are where the substep before has brought their bodies
            launches.append(solver.bind("make_joint_rows", first, count, part))
        launches.append(solver.bind("solve_soft", first, count, part))
    return [*launches, unpack]


def color_schedule(solver: Solver, first: int, count: int, values: Mapping[str, Any]) -> list[Launch]:
    """A launch a colour, a thread a row, driven from the host. For large worlds on a GPU."""
    begin = solver.bind("begin", first, count, values)
    before = solver.bind("before_sweep", first, count, values)
    after = solver.bind("after_sweep", first, count, values)
    finish = solver.bind("finish", first, count, values)
    unpack = solver.bind("unpack_impulses", first, count)
    max_sweeps = values.get("max_sweeps", solver.config.max_sweeps)
    sweep_color = solver.kernels["sweep_color"]

    def run() -> None:
        begin()
        ends = solver.rows.numpy("color_block").reshape(-1, COLORS + 1)[first : first + count]
        live = solver.state.numpy("flags")[first : first + count] == 0
        widest = np.where(live[:, None], np.diff(ends, axis=1), 0).max(axis=0) * LANES
        sweeps = [
            bind(
                sweep_color,
                (count, 1 if color == SERIAL_COLOR else int(widest[color])),
                {**solver.launch_values(first, values), "color": color},
                solver.device,
            )
            for color in np.flatnonzero(widest)
        ]
        # a world that is done ignores further launches, so the stop need not be read after each sweep on a GPU
        stride = 1 if solver.device == "cpu" else 8
        done = 0
        while not _all_done(solver, first, count):
            for _ in range(min(stride, max_sweeps - done)):
                before()
                for sweep in sweeps:
                    sweep()
                after()
            done += stride
        finish()
        unpack()

    return [run]


def _all_done(solver: Solver, first: int, count: int) -> bool:
    done = solver.stats.numpy("iteration")["finished"][first : first + count] != 0
    return bool((done | (solver.state.numpy("flags")[first : first + count] != 0)).all())


SCHEDULES: dict[str, Callable[..., list[Launch]]] = {"world": world_schedule, "color": color_schedule}
