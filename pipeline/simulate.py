"""Run a scene and write what happened: ``trajectory.h5``, ``summary.json``, ``summary.png``, a video.

Layout of ``trajectory.h5`` (schema ``deep-contact.trajectory``, version 1; attributes of the file: ``schema``,
``version``, ``complete``, ``steps``, ``config`` and ``versions`` as JSON; every dataset has ``unit`` and ``meaning``):

- ``model/NAME``: the arrays of ``dc_kernels.types.MODEL`` and ``JOINTS`` at the start;
- ``record/step``, ``record/time`` (records,) and ``record/position``, ``angle``, ``velocity``,
  ``angular_velocity`` (records, bodies[, 2]): the start, then every ``record_every`` steps, then the end;
- ``step/NAME`` (steps, worlds): the quantities of ``STEP_FIELDS`` in every step;
- ``history/change`` (steps, worlds, max_sweeps): with ``history``, the largest impulse change of each sweep,
  NaN after the last one.

Every file is written under a temporary name and renamed when it is whole.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.arrays import require
from dc_kernels.measure import contact_slots
from dc_kernels.types import STATE

from . import warmstart
from .scenes import Scene

SCHEMA = "deep-contact.trajectory"
VERSION = 1
CHUNK_BYTES = 2**20  # of a dataset's chunk, about
DEFAULT = dc.SolverConfig()

RECORD_FIELDS = {name: STATE[name] for name in ("position", "angle", "velocity", "angular_velocity")}

# name: dtype, unit, meaning
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
    "flags": ("int32", "1", "dc_kernels.types.Flag bits: why a world does not advance"),
}


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """How contacts are solved."""

    method: Literal["pgs", "jacobi"] = DEFAULT.method
    """Gauss-Seidel in colour order, or Jacobi with mass splitting."""
    acceleration: Literal["none", "sor", "aitken", "nncg", "adaptive"] = DEFAULT.acceleration
    """Acceleration of the method."""
    tolerance: float = DEFAULT.tolerance
    """Impulse change of a sweep, or residual, at which a solve ends [N s or 1]."""
    relative_tolerance: float = DEFAULT.relative_tolerance
    """Impulse change over what a typical weight gives in a step; the smaller bound counts [1]."""
    stop: Literal["change", "residual"] = DEFAULT.stop
    """What the tolerance is compared with."""
    max_sweeps: int = DEFAULT.max_sweeps
    """Sweeps after which a solve ends unconverged [1]."""
    min_sweeps: int = DEFAULT.min_sweeps
    """Sweeps of a solve at least [1]."""
    position_correction: Literal["ngs", "baumgarte", "none"] = DEFAULT.position_correction
    """A phase of its own after the velocities, a velocity bias, or nothing."""

    def config(self, history: bool = False) -> dc.SolverConfig:
        """The kernels' settings."""
        return dc.SolverConfig(**asdict(self), history=history)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What is run, and on what."""

    worlds: int = 1
    """Worlds, of the seeds seed, seed + 1, ... [1]."""
    seed: int = 0
    """Seed of the first world [1]."""
    dt: float = 0.01
    """Time step [s]."""
    threads: int = 1
    """Threads that share the worlds [1]."""
    dtype: Literal["float32", "float64"] = "float32"
    """Scalar type of all arrays."""
    backend: Literal["warp", "numpy"] = "warp"
    """Kernels: Warp, or the slow NumPy oracle."""
    device: str = "cpu"
    """Device of the Warp kernels: cpu, or cuda:0, ..."""

    def simulation(self, scene: Scene, config: dc.SolverConfig) -> dc.Simulation:
        """The scene's worlds, ready to step.

        Raises:
            ValueError: for an option out of its range.
        """
        if not (np.isfinite(self.dt) and self.dt > 0.0):
            raise ValueError(f"dt is {self.dt!r}; it must be finite and > 0")
        if self.threads < 1:
            raise ValueError(f"threads is {self.threads}; it must be >= 1")
        arrays = scene.build(self.worlds, self.seed).finalize(self.dtype, device=self.device, backend=self.backend)
        return dc.Simulation(*arrays, config=config, threads=self.threads)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder: renamed to ``path`` when the block ends, removed when it raises."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one go (``atomic_path``)."""
    with atomic_path(path) as partial:
        partial.write_text(json.dumps(content, indent=2) + "\n")


def versions() -> dict[str, str]:
    """Versions of Python, of this project and of what computes."""
    found = {"python": platform.python_version()}
    for name in ("deep-contact", "warp-lang", "numpy", "h5py"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second one interrupts as usual. Signals reach the main thread only."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(signal.SIGINT, previous)

    previous = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, previous)


@contextmanager
def torch_threads(threads: int) -> Iterator[None]:
    """As many threads for networks as for worlds, where torch is loaded: more than are free wait for each other."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def pressing(sim: dc.Simulation) -> np.ndarray:
    """Contacts of each world that press or overlap, (worlds,): those that a solver without a margin would know."""
    slots, world = contact_slots(sim.contacts)
    counts = (sim.contacts.numpy("impulse")[slots, 0] > 0.0) | (sim.contacts.numpy("gap")[slots] < 0.0)
    return np.bincount(world[counts], minlength=sim.model.world_count)


def measure(sim: dc.Simulation) -> dict[str, np.ndarray]:
    """The quantities of ``STEP_FIELDS`` after a step, (worlds,) each."""
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


class Column:
    """A dataset that grows row by row; rows are written a chunk at a time."""

    def __init__(self, group: Any, name: str, row: tuple[int, ...], dtype: Any, unit: str, meaning: str) -> None:
        """Create the dataset, empty, of rows of that shape."""
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
        """Add a row (copied)."""
        self.rows.append(np.array(row, self.dtype))
        if len(self.rows) >= self.height:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting."""
        if self.rows:
            first = self.data.shape[0]
            self.data.resize(first + len(self.rows), axis=0)
            self.data[first:] = np.stack(self.rows)
            self.rows = []


class TrajectoryWriter:
    """Writes a run into an open HDF5 file, in the layout of this module."""

    def __init__(self, file: Any, sim: dc.Simulation, config: dict[str, Any]) -> None:
        """Write the model and the state at the start."""
        self.file = file
        model = sim.model
        file.attrs.update(schema=SCHEMA, version=VERSION, complete=False, steps=0)
        file.attrs.update(config=json.dumps(config), versions=json.dumps(versions()))
        for group in (model, sim.joints):
            for name, field in group.table.items():
                data = file.create_dataset(f"model/{name}", data=group.numpy(name))
                data.attrs.update(unit=field.unit, meaning=field.meaning)
        record = file.create_group("record")
        self.record = {
            "step": Column(record, "step", (), np.int64, "1", "steps done"),
            "time": Column(record, "time", (), np.float64, "s", "steps done times dt"),
        }
        for name, field in RECORD_FIELDS.items():
            array = sim.state.numpy(name)
            self.record[name] = Column(record, name, array.shape, array.dtype, field.unit, field.meaning)
        group, worlds = file.create_group("step"), (model.world_count,)
        self.step = {name: Column(group, name, worlds, *spec) for name, spec in STEP_FIELDS.items()}
        self.history: Column | None = None
        if sim.config.history:
            shape = (model.world_count, sim.config.max_sweeps)
            meaning = "largest impulse change of each sweep, NaN after the last one"
            self.history = Column(file.create_group("history"), "change", shape, np.float32, "N s", meaning)

    def add_record(self, step: int, time: float, state: dc.State) -> None:
        """Record the bodies."""
        self.record["step"].append(step)
        self.record["time"].append(time)
        for name in RECORD_FIELDS:
            self.record[name].append(state.numpy(name))

    def add_step(self, measured: dict[str, np.ndarray], history: np.ndarray | None) -> None:
        """Record a step's quantities."""
        for name, column in self.step.items():
            column.append(measured[name])
        if self.history is not None and history is not None:
            done = np.arange(history.shape[1]) < measured["sweeps"][:, None]
            self.history.append(np.where(done, history, np.nan))

    def finish(self, steps: int, complete: bool) -> dict[str, np.ndarray]:
        """Write what is waiting and return the quantities of all steps, (steps, worlds) each."""
        columns = [*self.record.values(), *self.step.values()]
        for column in columns if self.history is None else [*columns, self.history]:
            column.flush()
        self.file.attrs.update(complete=complete, steps=steps)
        return {name: column.data[...] for name, column in self.step.items()}


@dataclass(frozen=True, kw_only=True)
class Output:
    """What a run writes."""

    steps: int = 250
    """Steps [1]."""
    start: str = "builtin"
    """Start of the contact solver: none, builtin, random, bad, copy, or copyN, rounded to N decimals; the pretrained
    network: cnn, cnn-start (not in mid-solve); the file of a trained one, .safetensors."""
    out: Path = Path("out/simulate")
    """Folder of the files, made if missing; files of an earlier run are replaced."""
    record_every: int = 1
    """Steps between two records of the bodies [1]."""
    history: bool = False
    """Record the impulse change of every sweep."""
    video: Literal["none", "gif", "mp4"] = "none"
    """Also write an animation of world 0."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        for name, low in (("steps", 0), ("record_every", 1)):
            if getattr(self, name) < low:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be >= {low}")


def simulate(
    scene: Scene,
    run: RunOptions | None = None,
    solver: SolverOptions | None = None,
    output: Output | None = None,
    progress: bool = True,
) -> tuple[dict[str, Any], dc.Simulation]:
    """Run a scene and write its files; Ctrl-C ends it early, with whole files of what was done.

    Args:
        scene: of ``scenes.SCENES``.
        run: worlds, time step, threads, dtype.
        solver: settings of the solver.
        output: steps, start strategy, files.
        progress: show bars on stderr.

    Returns:
        The content of ``summary.json``, and the simulation at its end.

    Raises:
        ValueError: for an option out of its range, or a network that cannot read the simulation.
        OSError: a network's file cannot be read.
        ImportError: naming the extra, without h5py, tqdm or matplotlib.
    """
    run, solver, output = run or RunOptions(), solver or SolverOptions(), output or Output()
    output.check()
    h5py, tqdm = require("h5py", "pipeline"), require("tqdm", "pipeline").tqdm
    from . import plots

    options = {**asdict(run), **asdict(solver), **asdict(output), "out": str(output.out)}
    config = {"scene": {"name": scene.name, **asdict(scene)}, "options": options}
    make = warmstart.maker(output.start, run.seed)
    sim = run.simulation(scene, solver.config(output.history))
    sim.warmup()
    made: Any = make(sim)
    began = time.perf_counter()
    spent = 0.0  # in the simulation itself [s]
    done = 0
    files = ["trajectory.h5", "summary.json", "summary.png"]
    with (
        atomic_path(output.out / files[0]) as partial,
        h5py.File(partial, "w") as file,
        torch_threads(run.threads),
        interruptible() as stop,
    ):
        writer = TrajectoryWriter(file, sim, config)
        writer.add_record(0, 0.0, sim.state)
        bar = tqdm(total=output.steps, desc=f"simulate {scene.name}", unit="step", disable=not progress)
        while done < output.steps and not stop.is_set():
            before = time.perf_counter()
            warmstart.step(sim, run.dt, made)
            spent += time.perf_counter() - before
            done += 1
            measured = measure(sim)
            history = dc.to_numpy(sim.stats.history) if output.history else None
            writer.add_step(measured, history)
            if done % output.record_every == 0 or done == output.steps or stop.is_set():
                writer.add_record(done, done * run.dt, sim.state)
            bar.set_postfix(contacts=int(measured["contact_count"].sum()), refresh=False)
            bar.update()
        bar.close()
        complete = done == output.steps
        series = writer.finish(done, complete)
    busy = (series["pressing_count"] > 0) | (np.diff(sim.model.numpy("joint_start")) > 0)
    solved = series["sweeps"][busy]
    flags = series["flags"][-1] if done else np.zeros(run.worlds, np.int32)
    summary = {
        "scene": scene.name,
        "complete": complete,
        "steps": done,
        "worlds": run.worlds,
        "bodies": sim.model.body_count,
        "mean_sweeps": float(solved.mean()) if len(solved) else 0.0,
        "median_sweeps": float(np.median(solved)) if len(solved) else 0.0,
        "unconverged_share": float((solved >= solver.max_sweeps).mean()) if len(solved) else 0.0,
        "contacts_mean": float(series["pressing_count"].mean()) if done else 0.0,
        "contacts_last": float(series["pressing_count"][-1].mean()) if done else 0.0,
        "penetration_max_mm": 1e3 * float(series["penetration_max"].max(initial=0.0)),
        "penetration_last_mean_mm": 1e3 * float(series["penetration_mean"][-1].mean()) if done else 0.0,
        "flagged_worlds": {str(w): str(dc.Flag(int(flags[w]))) for w in np.flatnonzero(flags)},
        "simulation_s": spent,
        "worlds_per_s": run.worlds / spent if spent and complete else 0.0,
        "capacity": plain(sim.capacity()),
        "memory": plain(sim.memory()),
        "versions": versions(),
        "config": config,
        "out": str(output.out),
    }
    if hasattr(made, "stats"):
        summary["network"] = {**plain(made.stats.totals()), "explain": made.explain()}
    start = Path(output.start).stem if warmstart.is_network(output.start) else output.start
    title = f"{scene.name}: {run.worlds} world{'s' if run.worlds > 1 else ''}, {solver.method}, {solver.acceleration}"
    with atomic_path(output.out / files[2]) as partial:
        plots.save(plots.summary_figure(sim, series, run.dt, f"{title}, start {start}"), partial)
    if output.video != "none":
        files.append(f"video.{output.video}")
        with atomic_path(output.out / files[-1]) as partial:
            plots.animate(
                output.out / files[0], partial, progress=lambda f: tqdm(f, desc="video", disable=not progress)
            )
    summary.update(files=files, wall_s=time.perf_counter() - began)
    write_json(output.out / files[1], summary)
    return summary, sim


def plain(value: Any) -> Any:
    """Nested dicts and lists with Python's own numbers, for JSON."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
