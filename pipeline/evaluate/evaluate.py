"""How many sweeps the solver needs from each start strategy and with each network: the thesis protocol and more.

Worlds, seeds and settings are those of the theses: 100 discs that fall into a box, 250 steps of 0.01 s, sweeps until
the largest impulse change is below 1e-4 N s, at most 1000; all worlds in one batch. The theses' engine left overlaps of
5 mm alone and looked no further ahead than a step's own motion; so does the protocol, unlike the solver's defaults.
Statistics are over the states (steps of a world) in which a contact presses or overlaps.

In closed loop each strategy runs the worlds on a trajectory of its own. In open loop all are given the same states,
those of the trajectory of Builtin on plain Gauss-Seidel: of each step a strategy's solve is kept for the record only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.runtime.optional import require
from pipeline.evaluate.runs import COLUMNS, EVALUATION, PARTS, Column, Run, against, cells, summaries, table
from pipeline.options import RunOptions, SolverOptions
from pipeline.process import torch_threads
from pipeline.run.trajectory import pressing
from pipeline.scenes import THESIS_BODIES, Thesis
from pipeline.seeds import HELD_OUT_SEED
from pipeline.starts import warmstart

__all__ = [
    "COLUMNS",
    "EVALUATION",
    "Column",
    "EvaluationOptions",
    "ProtocolOptions",
    "Run",
    "against",
    "cells",
    "evaluation",
    "protocol",
    "report",
    "run_strategy",
    "table",
]

Acceleration = Literal["none", "sor", "aitken", "nncg", "adaptive"]
Loop = Literal["closed", "open"]
TRAJECTORY: Acceleration = "none"  # of the open loop's Builtin
SKIPPED, DROPPED = ("empty", "early"), ("refused", "undone")  # of a driver's totals


@dataclass(frozen=True, kw_only=True)
class ProtocolOptions:
    """The thesis protocol; the defaults are the theses'."""

    starts: tuple[str, ...] = ("none", "builtin", "copy")
    """Start strategies: none, builtin, random, bad, copy, copyN (rounded to N decimals), grid, grid-bilinear (copy
    through splat and gather); cnn, cnn-start (the pretrained network, in mid-solve too or at the start only), or a
    trained network: PATH.safetensors or LABEL=PATH.safetensors."""
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

    def simulation(self, acceleration: Acceleration) -> dc.Simulation:
        """The worlds, ready to step; compiling is done."""
        solver = SolverOptions(
            method=self.method,
            acceleration=acceleration,
            tolerance=self.tolerance,
            max_sweeps=self.max_sweeps,
            min_sweeps=1,
        )
        run = RunOptions(worlds=self.worlds, seed=self.seed, dt=self.dt, threads=self.threads, dtype=self.dtype)
        config = replace(
            solver.config(self.history),
            slop=self.slop,
            speculative=self.speculative,
            speculative_max=self.speculative,
        )
        sim = run.simulation(Thesis(bodies=self.bodies), config)
        sim.warmup()
        return sim


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions(ProtocolOptions):
    """All strategies and networks on the same held-out worlds."""

    starts: tuple[str, ...] = ("none", "builtin", "copy", "copy2", "copy0", "grid", "grid-bilinear", "random", "bad")
    """Start strategies: none, builtin, random, bad, copy, copyN (rounded to N decimals), grid, grid-bilinear (copy
    through splat and gather); cnn, cnn-start (the pretrained network, in mid-solve too or at the start only), or a
    trained network: PATH.safetensors or LABEL=PATH.safetensors."""
    loops: tuple[Loop, ...] = ("closed", "open")
    """Each strategy on a trajectory of its own, or all on that of Builtin."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        super().check()
        if not self.loops:
            raise ValueError("loops must name at least one")


# ------------------------------------------------------------------ one run


def run_strategy(
    options: ProtocolOptions,
    start: str,
    acceleration: Acceleration,
    bar: Any = None,
    *,
    loop: Loop = "closed",
    make: warmstart.Maker | None = None,
) -> Run:
    """Run the worlds with one strategy.

    Args:
        options: of the protocol.
        start: name of a strategy or network.
        acceleration: of the solver.
        bar: progress bar, updated after each step.
        loop: whose trajectory the states are of.
        make: makes the strategy or driver; None: that of the name.

    Raises:
        ValueError: for an option out of its range.
    """
    label, name = split_label(start)
    make = make or warmstart.maker(name, options.seed)
    sim = options.simulation(acceleration)
    phase = SolvePhase(sim, make(sim))
    trajectory = replace(sim.config, acceleration=TRAJECTORY)
    shape = (options.steps, options.worlds)
    sweeps, contacts, change = np.zeros(shape, np.int32), np.zeros(shape, np.int32), np.zeros(shape)
    errors, squares, count = np.full((*shape, 2), np.nan), np.zeros(2), 0
    histories = []
    for step in range(options.steps):
        with phase.timed("collide"):
            sim.collide(options.dt)
        given = sim.contacts.numpy("impulse").copy()
        phase.run()
        sweeps[step], change[step] = sim.stats.numpy("sweeps"), sim.stats.numpy("change")
        slots, world = contact_slots(sim.contacts)
        square = (phase.started - sim.contacts.numpy("impulse")[slots]) ** 2
        squares += square.sum(axis=0)
        count += len(square)
        of_world = np.bincount(world, minlength=options.worlds)
        for k in range(2):
            total = np.bincount(world, square[:, k], options.worlds)
            np.divide(total, of_world, out=errors[step, :, k], where=of_world > 0)
        history = _filled(dc.to_numpy(sim.stats.history), sweeps[step]) if options.history else None
        if loop == "open":
            sim.contacts.numpy("impulse")[...] = given
            sim.solve(trajectory)
        with phase.timed("advance"):
            sim.advance()
        contacts[step] = pressing(sim)
        if history is not None:
            histories.append(history[contacts[step] > 0])
        if bar is not None:
            bar.update()
    mean = squares / max(count, 1)
    changes = np.concatenate(histories) if histories else np.zeros((0, 0))
    strategy_s = phase.strategy_s
    return Run(
        start=label,
        solver=options.method.upper() if acceleration == "none" else f"{options.method.upper()} + {acceleration}",
        max_sweeps=options.max_sweeps,
        tolerance=options.tolerance,
        sweeps=sweeps,
        change=change,
        contacts=contacts,
        start_error=(float(mean[0]), float(mean[1])),
        wall_s=sum(phase.parts.values()) - (0.0 if phase.is_network else strategy_s),
        strategy_s=strategy_s,
        decay=np.median(changes, axis=0) if len(changes) else None,
        loop=loop,
        errors=errors,
        parts=dict(phase.parts),
        counts=phase.counts(int(np.prod(shape))),
    )


class SolvePhase:
    """The solve phase with a strategy or driver, timed by parts; it keeps what the solver began with.

    Attributes:
        parts: wall time of each of ``PARTS`` so far [s].
        started: start impulses of the present contacts, (contacts, 2), float64 [N s].
        is_network: whether the strategy is part of the method, so that its time counts.
    """

    def __init__(self, sim: dc.Simulation, made: warmstart.Strategy | warmstart.Driver) -> None:
        """Time what the strategy is known to consist of."""
        self.sim, self.made = sim, made
        self.parts = dict.fromkeys(PARTS, 0.0)
        self.started = np.zeros((0, 2))
        self.is_network = hasattr(made, "model")
        self.is_driver = hasattr(made, "solve")
        if self.is_driver:
            self._watch()
            return
        images = made.bind(sim) if isinstance(made, warmstart.Transfer) else getattr(made, "images", None)
        if images is not None:
            self._time(images, "splat", "splat")
            self._time(images, "impulse_image", "splat")
            self._time(images, "start_from", "gather")
        if hasattr(made, "model"):
            self._time(made, "model", "network")

    def run(self) -> None:
        """Start and solve."""
        made: Any = self.made
        if self.is_driver:
            known = dict(made.stats.totals()["seconds"])
            before = time.perf_counter()
            made.solve()
            rest = time.perf_counter() - before
            for part, total in made.stats.totals()["seconds"].items():
                self.parts[part] += total - known[part]
                rest -= total - known[part]
            self.parts["start"] += rest
            if self._waiting:  # nothing to sweep
                self._note_start()
            return
        named = sum(self.parts.values())
        before = time.perf_counter()
        made(self.sim)
        self._note_start()
        self.sim.storage.check_start()
        spent = time.perf_counter() - before
        self.parts["start"] += spent - (sum(self.parts.values()) - named)
        with self.timed("solve"):
            self.sim.solve()

    @property
    def strategy_s(self) -> float:
        """Wall time in the strategy [s]."""
        return sum(self.parts[name] for name in ("start", "features", "splat", "network", "gather"))

    def counts(self, states: int) -> dict[str, float]:
        """Calls of a network, worlds times steps in which it was skipped, and whose answer was dropped."""
        if not self.is_network:
            return {}
        made: Any = self.made
        if not self.is_driver:
            return {"calls": states - made.skipped, "skipped": made.skipped, "dropped": made.dropped}
        totals = {name: value for name, value in made.stats.totals().items() if name != "seconds"}
        skipped, dropped = (sum(totals.get(name, 0) for name in names) for names in (SKIPPED, DROPPED))
        return {**totals, "skipped": skipped, "dropped": dropped}

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Add the time of a block to a part."""
        before = time.perf_counter()
        yield
        self.parts[part] += time.perf_counter() - before

    def _note_start(self) -> None:
        """Keep the present impulses as those that the sweeps begin with."""
        self.started = self.sim.contacts.numpy("impulse")[contact_slots(self.sim.contacts)[0]].astype(np.float64)

    def _watch(self) -> None:
        """Note the start when a driver lets the first sweep run: a solve that pauses before it may be given another."""
        sim: Any = self.sim
        solve, resume = sim.solve, sim.resume
        self._waiting = False

        def watched_solve(*arguments: Any, pause: int | None = None, **options: Any) -> None:
            self._waiting = pause == 0
            if not self._waiting:
                self._note_start()
            solve(*arguments, pause=pause, **options)

        def watched_resume(*arguments: Any, **options: Any) -> None:
            if self._waiting:
                self._note_start()
                self._waiting = False
            resume(*arguments, **options)

        sim.solve, sim.resume = watched_solve, watched_resume

    def _time(self, owner: Any, name: str, part: str) -> None:
        """Add the time of an object's method to a part from now on."""
        call: Callable[..., Any] = getattr(owner, name)

        def run(*arguments: Any, **options: Any) -> Any:
            with self.timed(part):
                return call(*arguments, **options)

        setattr(owner, name, run)


def split_label(start: str) -> tuple[str, str]:
    """Label and name of a start: "peak=out/best.safetensors"; a file without a label is called by its stem."""
    label, separator, name = start.rpartition("=")
    if separator:
        return label, name
    return (Path(start).stem if start.lower().endswith(warmstart.CHECKPOINT) else start), start


def _filled(history: np.ndarray, sweeps: np.ndarray) -> np.ndarray:
    """Impulse changes (worlds, max_sweeps), after a world's last sweep those of that sweep."""
    last = np.maximum(sweeps - 1, 0)[:, None]
    return np.take_along_axis(history, np.minimum(np.arange(history.shape[1]), last), axis=1)


# ------------------------------------------------------------------ many runs


def protocol(
    options: ProtocolOptions | None = None,
    pairs: Sequence[tuple[str, Acceleration]] | None = None,
    progress: bool = True,
) -> list[Run]:
    """Run the thesis protocol, in closed loop.

    Args:
        options: of the protocol; the theses' if None.
        pairs: start strategy and acceleration of each run; None: every combination in the options.
        progress: show a bar on stderr.

    Returns:
        One ``Run`` for each pair, in order.

    Raises:
        OSError: a network's file cannot be read.
        ValueError: for an option out of its range.
    """
    options = options or ProtocolOptions()
    return _run_all(options, pairs, ("closed",), progress)


def evaluation(
    options: EvaluationOptions | None = None,
    pairs: Sequence[tuple[str, Acceleration]] | None = None,
    progress: bool = True,
) -> list[Run]:
    """All strategies and networks on the same worlds, in each of the loops; arguments as for ``protocol``.

    Returns:
        One ``Run`` for each loop and pair: the loops in order, the pairs in order in each.
    """
    options = options or EvaluationOptions()
    return _run_all(options, pairs, options.loops, progress)


def _run_all(
    options: ProtocolOptions,
    pairs: Sequence[tuple[str, Acceleration]] | None,
    loops: Sequence[Loop],
    progress: bool,
) -> list[Run]:
    options.check()
    pairs = pairs or [(start, acceleration) for acceleration in options.accelerations for start in options.starts]
    makers = {}
    for start, _ in pairs:  # before anything is computed
        name = split_label(start)[1]
        if warmstart.is_network(name) and options.dtype != "float32":
            raise ValueError(f"dtype is {options.dtype!r}; the network {name} answers in float32")
        makers[start] = warmstart.maker(name, options.seed)
    runs = []
    tqdm = require("tqdm", "pipeline").tqdm
    total = len(loops) * len(pairs) * options.steps
    with torch_threads(options.threads), tqdm(total=total, unit="step", disable=not progress) as bar:
        for loop in loops:
            for start, acceleration in pairs:
                bar.set_description(f"{split_label(start)[0]}, {acceleration}, {loop} loop")
                runs.append(run_strategy(options, start, acceleration, bar, loop=loop, make=makers[start]))
    return runs


def report(options: ProtocolOptions, runs: Sequence[Run]) -> dict[str, Any]:
    """What ``--json`` prints and the JSON file holds."""
    return {"options": asdict(options), "runs": summaries(runs)}
