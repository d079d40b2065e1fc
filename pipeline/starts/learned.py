"""A contact solve with a network in the loop: a start, then corrections while it has not converged.

    model, manifest = load_checkpoint(PRETRAINED)
    learned = LearnedSolve(sim, model)
    sim.collide(dt)
    learned.solve()  # in the place of sim.solve()
    sim.advance()

Whatever the network answers, the solve ends as it would without it, at a bounded cost. A correction with NaN or inf, or
far beyond what the last sweeps let expect, is not taken. One that failed, after which the step of a sweep is no smaller
than it was before, makes the world leave out a call; where it has grown much, it is taken back. A world most of whose
calls fail is left to the solver: from then on it is the plain one, on the impulses that it has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.learn.channels import Scale
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.model.settings import MAX_INT, Limits, Settings, Whole
from dc_kernels.runtime.optional import require
from pipeline.starts.start import Clock, Report, Started

TRUST = 4
"""Calls that may fail beyond two in three before a world is left to the solver [1]."""
RUNAWAY = 1e4
"""Ratio of a correction to the impulses that it may not reach, as float32 has 7 digits [1]."""
EVERY, EVERY_ACCELERATED = 12, 15
"""Sweeps between two calls with plain sweeps, and where the solver extrapolates by itself [1]."""
PARTS = ("solve", "splat", "network", "gather", "start")
COUNTS = ("solves", "empty", "early", "calls", "refused", "failed", "undone")


@dataclass(frozen=True, kw_only=True)
class CallOptions(Settings):
    """When the network is called, and which of its corrections are taken."""

    settings_prefix: ClassVar[str] = "CallOptions."

    every: Annotated[int, Limits(least=2, most=MAX_INT)] | None = None
    """Sweeps between two calls; None: 12, or 15 where the solver extrapolates by itself [1]."""
    begin: bool = True
    """Call the network before the first sweep."""
    middle: bool = True
    """Call the network while the solve has not converged."""
    most: Whole = 60
    """Largest number of calls of a world in a solve [1]."""
    harm: Annotated[float, Limits(least=1.0, size=math.inf)] = 3.0
    """Least ratio of the step of the sweep after a correction to the one before for which it is taken back [1]."""
    limit: Annotated[float, Limits(least=0.0, size=math.inf)] = 10.0
    """Largest RMS of a correction that is taken, in units of what the last sweeps let expect [1]."""


@dataclass
class CallStats:
    """Counts of solves and calls, summed over solves, (W,) each."""

    solves: np.ndarray
    """Solves of the world."""
    empty: np.ndarray
    """Solves without a contact, in which there was nothing to do."""
    early: np.ndarray
    """Solves that were done in the first sweeps, so that no call came while solving."""
    calls: np.ndarray
    """Calls of the network."""
    refused: np.ndarray
    """Corrections not taken: not finite, or too large."""
    failed: np.ndarray
    """Corrections after which the step of a sweep had not shrunk."""
    undone: np.ndarray
    """Failed corrections that were taken back."""
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PARTS, 0.0))
    """Wall time by part [s]; reading features counts as "splat", writing corrections as "gather"."""

    @classmethod
    def zeros(cls, worlds: int) -> CallStats:
        """Return counts of 0 for a number of worlds."""
        counts: dict[str, Any] = {name: np.zeros(worlds, np.int64) for name in COUNTS}
        return cls(**counts)

    def totals(self) -> dict[str, Any]:
        """Return the sums over the worlds, by name, and "seconds"."""
        return {**{name: int(getattr(self, name).sum()) for name in COUNTS}, "seconds": dict(self.seconds)}


def grid_of(sim: dc.Simulation, spacing: float) -> dc.Grid:
    """Make the grid over all that stands in any world, its nodes ``spacing`` of the largest typical diameter apart.

    A contact beyond it, of a body that flew away, is moved to its border.
    """
    model, state = sim.model, sim.state
    owner = model.numpy("shape_body")
    center = state.numpy("position")[owner]
    reach = model.numpy("shape_extent")[:, None] + np.abs(model.numpy("shape_center"))
    step = spacing * float(model.numpy("length_scale").max())
    lower, upper = (center - reach).min(axis=0), (center + reach).max(axis=0)
    return dc.Grid.from_box(lower, np.maximum(upper, lower + step), step)


class LearnedSolve:
    """A start that solves a simulation's steps with a network in the loop.

    Worlds that are still unconverged go through the network as one batch. Worlds without contacts and solves that
    converge within the first sweeps never reach it.
    """

    def __init__(
        self,
        sim: dc.Simulation,
        model: Any,
        options: CallOptions | None = None,
        *,
        grid: dc.Grid | None = None,
        compile: bool = False,
        bfloat16: bool = False,
    ) -> None:
        """Allocate what the network reads.

        Args:
            sim: float32, on the CPU, schedule "world".
            model: a ``ContactNet``, or any module with ``trunk`` and ``head``.
            options: when it is called.
            grid: of its images; None: over all that stands, at the model's spacing.
            compile: run the network through ``torch.compile``.
            bfloat16: run the convolutions in bfloat16, for large batches on a CPU that has it; costs a copy.

        Raises:
            ValueError: for a simulation that the network cannot read.
        """
        self._torch = torch = require("torch", "pipeline")
        if sim.dtype != np.float32:
            raise ValueError(f"sim.dtype is {sim.dtype}; the network reads float32")
        self.sim, self.options = sim, options or CallOptions()
        self.model = model.eval()
        grid = grid or grid_of(sim, model.config.spacing)
        self.reader = SolveReader(sim, grid, limit=self.options.limit)
        trunk = torch.compile(model.trunk) if compile else model.trunk
        self._trunk = _in_bfloat16(torch, trunk) if bfloat16 else trunk
        self._head = torch.compile(model.head) if compile else model.head
        plain = sim.config.acceleration == "none"
        self.every = self.options.every or (EVERY if plain else EVERY_ACCELERATED)
        self.stats = CallStats.zeros(sim.model.world_count)
        self.clock = Clock(self.stats.seconds)
        self.watch: Callable[[np.ndarray, bool], None] | None = None
        """Called with the worlds, and whether no sweep is done, when their features are read: for training."""

    def solve(self, started: Started | None = None) -> None:
        """Solve from ``contacts.impulse``, between ``collide`` and ``advance``; see ``Start.solve``.

        Raises:
            ValueError: see ``Simulation.solve``.
        """
        with self.clock.part("start"):
            self._solve(started or _nothing)

    def _solve(self, started: Started) -> None:
        """Solve; ``started`` is called before the first sweep."""
        sim, options, stats = self.sim, self.options, self.stats
        self._timed("solve", sim.solve, pause=0)
        running = sim.running
        stats.solves += 1
        stats.empty += sim.contacts.numpy("contact_count") == 0
        if not running.any():
            started()
            return
        self.reader.begin()
        worlds = len(running)
        self._waiting = np.zeros(worlds, bool)  # for the verdict on a call
        self._before = np.zeros(worlds)  # squared step of the sweep before it
        self._size = np.full(worlds, np.inf)  # of steps and impulses, the least so far [N s]
        self._failures = np.zeros(worlds, np.int64)
        self._pause = np.zeros(worlds, np.int64)  # calls to leave out
        asking = running.copy()  # worlds that calls are made for
        calls = np.zeros(worlds, np.int64)
        if options.begin and options.most:
            calls += self._call(asking, begin=True)
        started()
        first = True
        while running.any():
            more = bool(asking.any()) and (options.middle or bool(self._waiting.any()))
            self._timed("solve", sim.resume, pause=self.every if more else None)
            was, running = running, sim.running
            if first:
                stats.early += was & ~running
                first = False
            if not running.any() or not more:
                continue
            asking &= running
            self._judge(asking)
            if options.middle:
                asking &= (calls < options.most) & (3 * self._failures < 2 * calls + 3 * TRUST)
                calls += self._call(asking & (self._pause == 0), begin=False)
                self._pause = np.maximum(self._pause - 1, 0)
            else:
                asking[:] = False

    def _call(self, asking: np.ndarray, begin: bool) -> np.ndarray:
        """Correct the impulses of the worlds ``asking``, (W,); returns those that were asked for, bool (W,)."""
        worlds = np.flatnonzero(asking)
        if not len(worlds):
            return asking
        reader = self.reader
        contacts = self._read(worlds, begin)
        if begin:
            # where no contact would take a step beyond the tolerance, the first sweep is the last
            needed = reader.scale[: len(worlds), Scale.STEP] * np.sqrt(contacts) >= self.sim.config.ends_at[1]
            if not needed.all():
                asking = asking.copy()
                asking[worlds[~needed]] = False
                worlds = worlds[needed]
                if not len(worlds):
                    return asking
                contacts = self._read(worlds, begin)
        if self.watch is not None:
            self.watch(worlds, begin)
        with self._torch.inference_mode():
            trunk = self._timed("network", self._trunk, reader.images())
            near = self._timed("gather", reader.gather, trunk.contiguous())
            output = self._timed("network", self._head, reader.features(), near)
            lost = self._lost(worlds)
            if lost.any():
                output[self._torch.from_numpy(np.repeat(lost, np.diff(reader.packed_start[: len(worlds) + 1])))] = (
                    np.nan
                )
        taken = self._timed("gather", reader.correct, output)
        if begin:
            self._before[worlds] = contacts * reader.scale[: len(worlds), Scale.STEP].astype(float) ** 2
        else:
            self._before[worlds] = self._step()[worlds]
        self._waiting[worlds] = taken
        self.stats.calls[worlds] += 1
        refused = worlds[~taken]
        self._pause[refused] = 2
        self._failures[refused] += 1
        self.stats.refused[refused] += 1
        return asking

    def _read(self, worlds: np.ndarray, begin: bool) -> np.ndarray:
        """Read the features of some worlds; returns the contacts of each, (asked,)."""
        self._timed("splat", self.reader.read, worlds, begin=begin)
        return np.diff(self.reader.packed_start[: len(worlds) + 1])

    def _lost(self, worlds: np.ndarray) -> np.ndarray:
        """Tell whether a correction could be so large that velocities lose all their digits in it, bool (asked,)."""
        scale = self.reader.scale[: len(worlds)].astype(float)
        self._size[worlds] = np.minimum(self._size[worlds], scale[:, [Scale.STEP, Scale.IMPULSE]].max(axis=1))
        return self.options.limit * scale[:, Scale.EXPECTED] > RUNAWAY * self._size[worlds]

    def _step(self) -> np.ndarray:
        """Return the squared step of the last sweep of each world, (W,) [N^2 s^2]."""
        return self.sim.stats.numpy("iteration")["step_last"]

    def _judge(self, asking: np.ndarray) -> None:
        """Take back what did harm; a world whose sweeps take no smaller steps leaves out a call."""
        judged = self._waiting & asking
        if not judged.any():
            return
        self._waiting[:] = False
        now, before = self._step(), self._before
        harmed = judged & ~(now < self.options.harm**2 * before)
        if harmed.any():
            first = self.sim.contacts.numpy("contact_start")
            count = self.sim.contacts.numpy("contact_count")
            impulse, known = self.sim.contacts.numpy("impulse"), self.reader.known
            for w in np.flatnonzero(harmed):
                part = slice(first[w], first[w] + count[w])
                impulse[part] = known[part] = self.reader.before[part]
            self.sim.stats.numpy("replaced")[harmed] = 1
            self.stats.undone += harmed
        failed = judged & ~(now < before)
        self._pause[failed] = 1
        self._failures += failed
        self.stats.failed += failed

    def _timed(self, part: str, function: Any, *arguments: Any, **options: Any) -> Any:
        """Call a function, whose wall time counts for a part."""
        with self.clock.part(part):
            return function(*arguments, **options)

    def report(self) -> Report:
        """Return what was called, what was not and why, and what it took."""
        counts = self.stats.totals()
        seconds = counts.pop("seconds")
        counts.update(skipped=counts["empty"] + counts["early"], dropped=counts["refused"] + counts["undone"])
        return Report(seconds=seconds, is_network=True, counts=counts, text=self._explained())

    def _explained(self) -> str:
        """Say how often the network was called, and why not."""
        total = self.stats.totals()
        solves = max(total["solves"], 1)
        share = {name: f"{100.0 * total[name] / solves:.1f} %" for name in ("empty", "early")}
        return "\n".join(
            [
                f"network: {total['calls'] / solves:.2f} calls a solve, of {total['solves']} solves",
                f"  skipped: no contact in {share['empty']}, done in the first {self.every} sweeps or so in "
                f"{share['early']}",
                f"  of the corrections {total['refused']} were refused, {total['failed']} failed and {total['undone']} "
                "of these were taken back",
            ]
        )


def _nothing() -> None:
    """Stand for a callback that nobody has given."""


def _in_bfloat16(torch: Any, trunk: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let the convolutions of a trunk run in bfloat16; its answer is float32."""

    def run(images: Any) -> Any:
        with torch.autocast("cpu", torch.bfloat16):
            answer = trunk(images)
        return answer.float()

    return run
