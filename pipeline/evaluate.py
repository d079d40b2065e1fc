"""The thesis protocol: how many sweeps the solver needs from each start strategy, in closed loop.

Worlds, seeds and settings are those of the theses: 100 discs that fall into a box, 250 steps of 0.01 s, sweeps until
the largest impulse change is below 1e-4 N s, at most 1000. Each strategy runs the same worlds on a trajectory of its
own, all worlds in one batch. The theses' engine left overlaps of 5 mm alone and looked no further ahead than a step's
own motion; so does the protocol, unlike the solver's defaults. Statistics are over the states (steps of a world) in
which a contact presses or overlaps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.arrays import require
from dc_kernels.measure import contact_slots

from . import warmstart
from .scenes import THESIS_BODIES, Thesis
from .simulate import RunOptions, SolverOptions, pressing

HELD_OUT_SEED = 100_000  # of the first test world: no training uses seeds from here on
DONE_IN = (10, 50, 100, 200, 1000)  # sweeps of the table's shares

Acceleration = Literal["none", "sor", "aitken", "nncg"]


@dataclass(frozen=True, kw_only=True)
class ProtocolOptions:
    """The thesis protocol; the defaults are the theses'."""

    starts: tuple[str, ...] = ("none", "builtin", "copy")
    """Start strategies: none, builtin, random, bad, copy, copyN (rounded to N decimals)."""
    accelerations: tuple[Acceleration, ...] = ("none",)
    """Accelerations of the solver; each runs with every start strategy."""
    method: Literal["pgs", "jacobi"] = "pgs"
    """Gauss-Seidel in colour order, or Jacobi with mass splitting."""
    worlds: int = 10
    """Worlds, of the seeds seed, seed + 1, ... [1]."""
    seed: int = HELD_OUT_SEED
    """Seed of the first world [1]."""
    bodies: int = THESIS_BODIES
    """Discs in each world; the box grows with them [1]."""
    steps: int = 250
    """Steps [1]."""
    dt: float = 0.01
    """Time step [s]."""
    tolerance: float = 1e-4
    """Impulse change of a sweep at which a solve ends [N s]."""
    max_sweeps: int = 1000
    """Sweeps after which a solve ends unconverged [1]."""
    slop: float = 5e-3
    """Overlap that is left alone [diameters]."""
    speculative: float = 0.0
    """Gaps below this are contacts though they do not close within the step [diameters]."""
    threads: int = 1
    """Threads that share the worlds [1]."""
    dtype: Literal["float32", "float64"] = "float32"
    """Scalar type of all arrays."""
    history: bool = True
    """Also record the impulse change of every sweep, for its plot."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        if not self.starts or not self.accelerations:
            raise ValueError("starts and accelerations must each name at least one")
        for name in ("steps", "max_sweeps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be >= 1")


@dataclass(frozen=True, kw_only=True)
class Run:
    """What one strategy did, in arrays (steps, worlds)."""

    start: str
    solver: str
    max_sweeps: int
    tolerance: float
    sweeps: np.ndarray
    change: np.ndarray
    contacts: np.ndarray
    """Contacts that press or overlap."""
    start_error: tuple[float, float]
    """Mean squared difference of start and final impulse over all contacts, normal and tangential [N^2 s^2]."""
    wall_s: float
    """Wall time of all steps, without that of the strategy [s]."""
    strategy_s: float
    """Wall time in the strategy, for Copy that of the solve in advance [s]."""
    decay: np.ndarray | None = field(default=None, repr=False)
    """Largest impulse change of sweep n, median over the states with contacts, (max_sweeps,) [N s]."""

    @property
    def label(self) -> str:
        """For legends and tables."""
        return f"{self.start.capitalize()}, {self.solver}"

    @property
    def with_contacts(self) -> np.ndarray:
        """The states that the statistics count, bool (steps, worlds)."""
        return self.contacts > 0

    @property
    def converged(self) -> np.ndarray:
        """Whether the solve ended below the tolerance, bool (steps, worlds)."""
        return (self.sweeps < self.max_sweeps) | (self.change <= self.tolerance)

    def summary(self) -> dict[str, Any]:
        """The row of the table, over the states with contacts."""
        states = self.with_contacts
        sweeps, converged = self.sweeps[states], self.converged[states]
        count = max(len(sweeps), 1)
        return {
            "label": self.label,
            "start": self.start,
            "solver": self.solver,
            "states": len(sweeps),
            "mean_sweeps": float(sweeps.sum() / count),
            "median_sweeps": float(np.median(sweeps)) if len(sweeps) else 0.0,
            "done_in": {str(n): float(((sweeps <= n) & converged).sum() / count) for n in DONE_IN},
            "contacts": float(self.contacts[states].sum() / count),
            "start_error_normal": self.start_error[0],
            "start_error_tangent": self.start_error[1],
            "wall_s": self.wall_s,
            "strategy_s": self.strategy_s,
        }


@dataclass(frozen=True)
class Column:
    """A column of the table."""

    title: str
    text: Callable[[dict[str, Any]], str]


def _share(sweeps: int) -> Callable[[dict[str, Any]], str]:
    return lambda row: f"{100.0 * row['done_in'][str(sweeps)]:.0f} %"


COLUMNS = (
    Column("start, solver", lambda row: row["label"]),
    Column("mean", lambda row: f"{row['mean_sweeps']:.0f}"),
    Column("median", lambda row: f"{row['median_sweeps']:.0f}"),
    *(Column(f"<={n}", _share(n)) for n in DONE_IN),
    Column("contacts", lambda row: f"{row['contacts']:.0f}"),
    Column("wall [s]", lambda row: f"{row['wall_s']:.2f}"),
)


def cells(run: Run) -> list[str]:
    """The table's row of a run as text."""
    row = run.summary()
    return [column.text(row) for column in COLUMNS]


def table(runs: Sequence[Run]) -> str:
    """The table for people: mean and median sweeps, share of steps done in so many, contacts, wall time."""
    rows = [[column.title for column in COLUMNS], *(cells(run) for run in runs)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(COLUMNS))]
    lines = []
    for row in rows:
        first = row[0].ljust(widths[0])
        lines.append("  ".join([first, *(text.rjust(width) for text, width in zip(row[1:], widths[1:]))]))
    lines.insert(1, "-" * len(lines[0]))
    worlds = runs[0].sweeps.shape[1]
    total = runs[0].sweeps.size
    counted = ", ".join(str(int(run.with_contacts.sum())) for run in runs)
    lines.append(f"sweeps per step over the states in which a contact presses ({counted} of {total}, {worlds} worlds);")
    lines.append(f"<=n: share of them that reached the tolerance of {runs[0].tolerance:g} N s in n sweeps.")
    lines.append("wall: all steps without the strategy itself (for Copy, without the solve in advance)")
    return "\n".join(lines)


def run_strategy(options: ProtocolOptions, start: str, acceleration: Acceleration, bar: Any = None) -> Run:
    """Run the worlds with one strategy.

    Args:
        options: of the protocol.
        start: name of a strategy.
        acceleration: of the solver.
        bar: progress bar, updated after each step.

    Raises:
        ValueError: for an option out of its range.
    """
    strategy = warmstart.parse(start, options.seed)
    solver = SolverOptions(
        method=options.method,
        acceleration=acceleration,
        tolerance=options.tolerance,
        max_sweeps=options.max_sweeps,
    )
    run = RunOptions(
        worlds=options.worlds, seed=options.seed, dt=options.dt, threads=options.threads, dtype=options.dtype
    )
    config = replace(
        solver.config(options.history),
        slop=options.slop,
        speculative=options.speculative,
        speculative_max=options.speculative,
    )
    sim = run.simulation(Thesis(bodies=options.bodies), config)
    sim.warmup()  # compiling is not in the wall time
    started = np.zeros((0, 2))
    strategy_s = 0.0

    def supply(sim: dc.Simulation) -> None:
        nonlocal started, strategy_s
        before = time.perf_counter()
        strategy(sim)
        started = sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]].astype(np.float64)
        strategy_s += time.perf_counter() - before

    shape = (options.steps, options.worlds)
    sweeps, contacts, change = np.zeros(shape, np.int32), np.zeros(shape, np.int32), np.zeros(shape)
    error, count, wall = np.zeros(2), 0, 0.0
    histories = []
    for step in range(options.steps):
        before = time.perf_counter()
        sim.step(options.dt, start=supply)
        wall += time.perf_counter() - before
        sweeps[step], change[step] = sim.stats.numpy("sweeps"), sim.stats.numpy("change")
        contacts[step] = pressing(sim)
        final = sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]]
        error += ((started - final) ** 2).sum(axis=0)
        count += len(final)
        if options.history:
            histories.append(_filled(dc.to_numpy(sim.stats.history), sweeps[step])[contacts[step] > 0])
        if bar is not None:
            bar.update()
    mean = error / max(count, 1)
    changes = np.concatenate(histories) if histories else np.zeros((0, 0))
    return Run(
        start=start,
        solver=options.method.upper() if acceleration == "none" else f"{options.method.upper()} + {acceleration}",
        max_sweeps=options.max_sweeps,
        tolerance=options.tolerance,
        sweeps=sweeps,
        change=change,
        contacts=contacts,
        start_error=(float(mean[0]), float(mean[1])),
        wall_s=wall - strategy_s,
        strategy_s=strategy_s,
        decay=np.median(changes, axis=0) if len(changes) else None,
    )


def _filled(history: np.ndarray, sweeps: np.ndarray) -> np.ndarray:
    """Impulse changes (worlds, max_sweeps), after a world's last sweep those of that sweep."""
    last = np.maximum(sweeps - 1, 0)[:, None]
    return np.take_along_axis(history, np.minimum(np.arange(history.shape[1]), last), axis=1)


def protocol(
    options: ProtocolOptions | None = None,
    pairs: Sequence[tuple[str, Acceleration]] | None = None,
    progress: bool = True,
) -> list[Run]:
    """Run the thesis protocol.

    Args:
        options: of the protocol; the theses' if None.
        pairs: start strategy and acceleration of each run; None: every combination in the options.
        progress: show a bar on stderr.

    Returns:
        One ``Run`` for each pair, in order.

    Raises:
        ValueError: for an option out of its range.
    """
    options = options or ProtocolOptions()
    options.check()
    pairs = pairs or [(start, acceleration) for acceleration in options.accelerations for start in options.starts]
    for start, _ in pairs:
        warmstart.parse(start)  # before anything is computed
    runs = []
    tqdm = require("tqdm", "pipeline").tqdm
    with tqdm(total=len(pairs) * options.steps, desc="protocol", unit="step", disable=not progress) as bar:
        for start, acceleration in pairs:
            bar.set_postfix_str(f"{start}, {acceleration}")
            runs.append(run_strategy(options, start, acceleration, bar))
    return runs


def report(options: ProtocolOptions, runs: Sequence[Run]) -> dict[str, Any]:
    """What ``--json`` prints and ``protocol.json`` holds."""
    return {"options": asdict(options), "runs": [run.summary() for run in runs]}
