"""The file of a run: ``trajectory.h5``.

Layout of ``trajectory.h5`` (schema ``deep-contact.trajectory``, version 1; attributes of the file: ``schema``,
``version``, ``complete``, ``steps``, ``config`` and ``versions`` as JSON; every dataset has ``unit`` and ``meaning``):

- ``model/NAME``: the arrays of ``dc_kernels.model.fields.MODEL`` and ``JOINTS`` at the start;
- ``record/step``, ``record/time`` (records,) and ``record/position``, ``angle``, ``velocity``,
  ``angular_velocity`` (records, bodies[, 2]): the start, then every ``record_every`` steps, then the end;
- ``step/NAME`` (steps, worlds): the quantities of ``STEP_FIELDS`` in every step;
- ``history/change`` (steps, worlds, max_sweeps): with ``history``, the largest impulse change of each sweep,
  NaN after the last one.

The file grows while the run goes on, under the name ``.trajectory.PROCESS.RANDOM.partial.h5``. A kill leaves that one:
it can be read, and ends a second or a twentieth of the run before the kill (``run.stream``).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.fields import STATE
from pipeline.files import versions
from pipeline.run.stream import Stream

SCHEMA = "deep-contact.trajectory"
VERSION = 1
CHUNK_BYTES = 2**20
"""Size of a dataset's chunk, about [B]."""

RECORD_FIELDS = {name: STATE[name] for name in ("position", "angle", "velocity", "angular_velocity")}

STEP_FIELDS = {
    "sweeps": ("int32", "1", "sweeps of the solver"),
    "change": ("float64", "N s", "largest impulse change of the last sweep"),
    "residual": ("float64", "1", "relative natural map at the end of the solve"),
    "contact_count": ("int32", "1", "contact points, those within the speculative margin included"),
    "pressing_count": ("int32", "1", "contact points that press or overlap"),
    "kinetic_energy": ("float64", "J", "of the dynamic bodies after the step"),
    "potential_energy": ("float64", "J", "of the dynamic bodies after the step, zero at the world's origin"),
    "penetration_max": ("float64", "m", "largest overlap at the beginning of the step"),
    "penetration_mean": (
        "float64",
        "m",
        "mean over the contacts that press or overlap at the beginning of the step",
    ),
    "flags": ("int32", "1", "dc_kernels.Flag bits: why a world does not advance"),
}
"""Dtype, unit and meaning of each quantity of a step, by name."""


def pressing(sim: dc.Simulation) -> np.ndarray:
    """Count the contacts of each world that press or overlap, without those in the speculative margin, (worlds,)."""
    slots, world = contact_slots(sim.contacts)
    counts = (sim.contacts.numpy("impulse")[slots, 0] > 0.0) | (sim.contacts.numpy("gap")[slots] < 0.0)
    return np.bincount(world[counts], minlength=sim.model.world_count)


def measure(sim: dc.Simulation) -> dict[str, np.ndarray]:
    """Measure the quantities of ``STEP_FIELDS`` after a step, (worlds,) each."""
    overlap = dc.overlap(sim)
    return {
        "sweeps": sim.stats.numpy("sweeps"),
        "change": sim.stats.numpy("change"),
        "residual": sim.stats.numpy("residual"),
        "contact_count": sim.contacts.numpy("contact_count"),
        "pressing_count": pressing(sim),
        "kinetic_energy": dc.kinetic_energy(sim),
        "potential_energy": dc.potential_energy(sim),
        "penetration_max": overlap.max,
        "penetration_mean": overlap.mean,
        "flags": sim.state.numpy("flags"),
    }


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a run has put into its trajectory."""

    steps: int
    """Steps done [1]."""
    complete: bool
    """Whether these are all that were asked for."""
    seconds: float
    """Wall time in the simulation itself [s]."""
    series: dict[str, np.ndarray]
    """Quantities of ``STEP_FIELDS`` by name, (steps, worlds) each."""


class RowWriter:
    """Lets a dataset grow row by row; rows are written a chunk at a time."""

    def __init__(self, group: Any, name: str, row: tuple[int, ...], dtype: Any, unit: str, meaning: str) -> None:
        """Create the dataset, empty, of rows of the shape ``row``."""
        self.dtype = np.dtype(dtype)
        size = max(1, int(np.prod(row, dtype=np.int64)) * self.dtype.itemsize)
        self.height = int(np.clip(CHUNK_BYTES // size, 1, 256))
        chunk = (self.height, *row)
        if size > 4 * CHUNK_BYTES:
            chunk = (1, max(1, row[0] * CHUNK_BYTES // size), *row[1:])
        compressed = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
        self.data = group.create_dataset(
            name, (0, *row), self.dtype, maxshape=(None, *row), chunks=tuple(max(1, n) for n in chunk), **compressed
        )
        self.data.attrs.update(unit=unit, meaning=meaning)
        self.rows: list[np.ndarray] = []

    def append(self, row: Any) -> None:
        """Add a copy of a row."""
        self.rows.append(np.array(row, self.dtype))
        if len(self.rows) >= self.height:
            self.flush()

    def cut(self, count: int) -> None:
        """Drop the rows after the first ``count``."""
        del self.rows[max(count - self.data.shape[0], 0) :]
        if self.data.shape[0] > count:
            self.data.resize(count, axis=0)

    def flush(self) -> None:
        """Write the rows that are waiting."""
        if self.rows:
            first = self.data.shape[0]
            self.data.resize(first + len(self.rows), axis=0)
            self.data[first:] = np.stack(self.rows)
            self.rows = []


class TrajectoryWriter:
    """Writes a run into a file that grows with it, in the layout of this module.

    As a context: the file is put in its place at the end. When the block raises after some steps, a full disk among the
    reasons, it is put there with the steps so far, all datasets of the same length; before that the old file stays.

    Attributes:
        steps: steps added, and ``written``, those of them that the disk has.
    """

    def __init__(self, path: Path, sim: dc.Simulation, config: dict[str, Any]) -> None:
        """Open the file, and write the model and the state at the start.

        Raises:
            OSError: naming the file, when it cannot be written.
        """
        self.steps = self.written = self.records = 0
        self.stream = Stream(path)
        try:
            self._begin(sim, config)
            self.add_record(0, 0.0, sim.state)
            self.commit()
        except BaseException:
            self.stream.close()
            raise

    def __enter__(self) -> TrajectoryWriter:
        """Return the writer."""
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Put the file in its place, whole or with the steps so far.

        Raises:
            OSError: the disk does not take it; the error says what the file holds.
        """
        try:
            if error is None:
                self._try(self.stream.finish)
            elif self.steps and not isinstance(error, _Unwritten):
                self.commit()
                self._try(self.stream.keep)
        finally:
            self.stream.close()

    def _begin(self, sim: dc.Simulation, config: dict[str, Any]) -> None:
        """Write the model, and make the datasets."""
        file, model = self.stream.file, sim.model
        file.attrs.update(schema=SCHEMA, version=VERSION, complete=False, steps=0)
        file.attrs.update(config=json.dumps(config), versions=json.dumps(versions()))
        for group in (model, sim.joints):
            for name, field in group.table.items():
                data = file.create_dataset(f"model/{name}", data=group.numpy(name))
                data.attrs.update(unit=field.unit, meaning=field.meaning)
        record = file.create_group("record")
        self.record = {
            "step": RowWriter(record, "step", (), np.int64, "1", "steps done"),
            "time": RowWriter(record, "time", (), np.float64, "s", "steps done times dt"),
        }
        for name, field in RECORD_FIELDS.items():
            array = sim.state.numpy(name)
            self.record[name] = RowWriter(record, name, array.shape, array.dtype, field.unit, field.meaning)
        group, worlds = file.create_group("step"), (model.world_count,)
        self.step = {name: RowWriter(group, name, worlds, *spec) for name, spec in STEP_FIELDS.items()}
        self.history: RowWriter | None = None
        if sim.config.history:
            shape = (model.world_count, sim.config.max_sweeps)
            meaning = "largest impulse change of each sweep, NaN after the last one"
            self.history = RowWriter(file.create_group("history"), "change", shape, np.float32, "N s", meaning)

    def add_record(self, step: int, time: float, state: dc.State) -> None:
        """Record the bodies."""
        self.record["step"].append(step)
        self.record["time"].append(time)
        for name in RECORD_FIELDS:
            self.record[name].append(state.numpy(name))
        self.records += 1

    def add_step(self, measured: dict[str, np.ndarray], history: np.ndarray | None) -> None:
        """Record a step's quantities."""
        for name, column in self.step.items():
            column.append(measured[name])
        if self.history is not None and history is not None:
            done = np.arange(history.shape[1]) < measured["sweeps"][:, None]
            self.history.append(np.where(done, history, np.nan))
        self.steps += 1

    def commit_if_due(self) -> None:
        """Bring to the disk what is waiting, now and then.

        Raises:
            OSError: see ``commit``.
        """
        if self.stream.due():
            self.commit()

    def commit(self) -> None:
        """Bring to the disk what is waiting.

        Raises:
            OSError: the disk does not take it; the file is in its place with the steps committed before, if any.
        """
        for columns, count in ((self.record.values(), self.records), (self._step_columns(), self.steps)):
            for column in columns:
                column.cut(count)  # an interrupt may come between two columns of a row
                column.flush()
        self.stream.file.attrs.update(steps=self.steps)
        self._try(self.stream.commit)
        self.written = self.steps

    def finish(self, complete: bool) -> dict[str, np.ndarray]:
        """Write what is waiting and return the quantities of all steps, (steps, worlds) each."""
        self.stream.file.attrs.update(complete=complete)
        self.commit()
        return {name: column.data[...] for name, column in self.step.items()}

    def _step_columns(self) -> list[RowWriter]:
        """Return what grows with every step."""
        return [*self.step.values(), *([] if self.history is None else [self.history])]

    def _try(self, action: Callable[[], None]) -> None:
        """Do what the disk may refuse; then keep the steps that it has.

        Raises:
            OSError: that says so.
        """
        try:
            action()
        except OSError as error:
            path, reason = self.stream.path, error.strerror or error
            if not self.written:
                raise _Unwritten(
                    error.errno, f"{path} was not written: {reason}; what was there before is whole"
                ) from error
            self.stream.keep()
            text = f"{path} holds the first {self.written} steps; then it could not be written: {reason}"
            raise _Unwritten(error.errno, text) from error


class _Unwritten(OSError):
    """Says that the disk does not take a file, which has been dealt with."""
