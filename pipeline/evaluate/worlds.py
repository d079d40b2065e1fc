"""One run of the thesis worlds with one start, in closed or in open loop.

In closed loop a start runs the worlds on a trajectory of its own. In open loop all starts are given the states of one
trajectory, that of Builtin on plain Gauss-Seidel: of each step the solve from a start is kept for the record only.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.evaluate.options import Acceleration, Loop, ProtocolOptions
from pipeline.evaluate.runs import PARTS, Run
from pipeline.run.trajectory import pressing
from pipeline.starts.registry import CHECKPOINT, Maker, maker
from pipeline.starts.start import Clock

TRAJECTORY: Acceleration = "none"
"""Acceleration of the trajectory of the open loop."""


def run_worlds(
    options: ProtocolOptions,
    start: str,
    acceleration: Acceleration,
    bar: Any = None,
    *,
    loop: Loop = "closed",
    make: Maker | None = None,
) -> Run:
    """Run the worlds with one start.

    Args:
        options: of the protocol.
        start: name of a start or network, with a label or without.
        acceleration: of the solver.
        bar: progress bar, updated after each step.
        loop: whose trajectory the states are of.
        make: makes the start; None: that of the name.

    Raises:
        ValueError: for an option out of its range.
    """
    label, name = split_label(start)
    make = make or maker(name, options.seed)
    sim = options.simulation(acceleration)
    made = make(sim)
    record = Record(sim, options)
    clock = Clock({"collide": 0.0, "advance": 0.0})
    trajectory = replace(sim.config, acceleration=TRAJECTORY)
    for step in range(options.steps):
        with clock.part("collide"):
            sim.collide(options.dt)
        given = sim.contacts.numpy("impulse").copy()
        made.solve(record.note_start)
        record.note_solve(step)
        if loop == "open":
            sim.contacts.numpy("impulse")[...] = given
            sim.solve(trajectory)
        with clock.part("advance"):
            sim.advance()
        record.note_contacts(step)
        if bar is not None:
            bar.update()
    report = made.report()
    parts = {**dict.fromkeys(PARTS, 0.0), **clock.seconds, **report.seconds}
    strategy_s = sum(parts[part] for part in ("start", "features", "splat", "network", "gather"))
    return Run(
        start=label,
        solver=options.method.upper() if acceleration == "none" else f"{options.method.upper()} + {acceleration}",
        max_sweeps=options.max_sweeps,
        tolerance=options.tolerance,
        sweeps=record.sweeps,
        change=record.change,
        contacts=record.contacts,
        start_error=record.start_error,
        wall_s=sum(parts.values()) - (0.0 if report.is_network else strategy_s),
        strategy_s=strategy_s,
        decay=record.decay,
        loop=loop,
        errors=record.errors,
        parts=parts,
        counts=report.counts,
    )


class Record:
    """Notes each step of a run.

    Attributes:
        sweeps: of each step and world, (steps, worlds).
        change: largest impulse change of the last sweep, (steps, worlds) [N s].
        contacts: contacts that press or overlap, (steps, worlds).
        errors: mean squared difference of start and final impulse, (steps, worlds, 2) [N^2 s^2]; NaN without contacts.
    """

    def __init__(self, sim: dc.Simulation, options: ProtocolOptions) -> None:
        """Make room for the steps of a simulation."""
        shape = (options.steps, options.worlds)
        self.sim, self.options = sim, options
        self.sweeps, self.contacts = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
        self.change, self.errors = np.zeros(shape), np.full((*shape, 2), np.nan)
        self._started = np.zeros((0, 2))
        self._squares, self._count = np.zeros(2), 0
        self._history: np.ndarray | None = None
        self._histories: list[np.ndarray] = []

    def note_start(self) -> None:
        """Keep the present impulses as those that the sweeps begin with."""
        self._started = self.sim.contacts.numpy("impulse")[contact_slots(self.sim.contacts)[0]].astype(np.float64)

    def note_solve(self, step: int) -> None:
        """Note the solve of a step, when its impulses are still there."""
        sim, worlds = self.sim, self.options.worlds
        self.sweeps[step], self.change[step] = sim.stats.numpy("sweeps"), sim.stats.numpy("change")
        slots, world = contact_slots(sim.contacts)
        square = (self._started - sim.contacts.numpy("impulse")[slots]) ** 2
        self._squares += square.sum(axis=0)
        self._count += len(square)
        of_world = np.bincount(world, minlength=worlds)
        for k in range(2):
            total = np.bincount(world, square[:, k], worlds)
            np.divide(total, of_world, out=self.errors[step, :, k], where=of_world > 0)
        if self.options.history:
            self._history = filled(dc.to_numpy(sim.stats.history), self.sweeps[step])

    def note_contacts(self, step: int) -> None:
        """Note the contacts that press at the end of a step."""
        self.contacts[step] = pressing(self.sim)
        if self._history is not None:
            self._histories.append(self._history[self.contacts[step] > 0])

    @property
    def start_error(self) -> tuple[float, float]:
        """Mean squared difference of start and final impulse over all contacts, normal and tangential [N^2 s^2]."""
        mean = self._squares / max(self._count, 1)
        return float(mean[0]), float(mean[1])

    @property
    def decay(self) -> np.ndarray | None:
        """Median impulse change of each sweep over the states with contacts, (max_sweeps,) [N s]; None without."""
        changes = np.concatenate(self._histories) if self._histories else np.zeros((0, 0))
        return np.median(changes, axis=0) if len(changes) else None


def split_label(start: str) -> tuple[str, str]:
    """Split a start such as "peak=out/best.safetensors" into label and name; a bare file is called by its stem."""
    label, separator, name = start.rpartition("=")
    if separator:
        return label, name
    return (Path(start).stem if start.lower().endswith(CHECKPOINT) else start), start


def filled(history: np.ndarray, sweeps: np.ndarray) -> np.ndarray:
    """Return changes (worlds, max_sweeps) in which a world's last sweep is repeated up to the end [N s]."""
    last = np.maximum(sweeps - 1, 0)[:, None]
    return np.take_along_axis(history, np.minimum(np.arange(history.shape[1]), last), axis=1)
