"""A contact solve with a network in the loop: a start, then corrections while it has not converged.

    model, manifest = load_checkpoint(PRETRAINED)
    learned = LearnedSolve(sim, model)
    sim.collide(dt)
    learned.solve()  # in the place of sim.solve()
    sim.advance()

An answer costs some hundred sweeps of its world. So the network is asked where the rate of the last sweeps says that
many are left; else a call moves each contact by an even share of Aitken's step, which costs next to nothing.

Whatever the network answers, the solve ends as it would without it, at a bounded cost. A correction with NaN or inf, or
far beyond what the last sweeps let expect, is not taken. One that failed, after which the step of a sweep is no smaller
than it was before, makes the world leave out a call; where it has grown much, it is taken back. A world most of whose
calls fail is left to the solver: from then on it is the plain one, on the impulses that it has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.learn.calls import CallsInFlight
from dc_kernels.learn.channels import Answer as How
from dc_kernels.learn.channels import Scale
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.model.settings import MAX_INT, Limits, Settings, Whole
from dc_kernels.runtime.imports import require
from pipeline.starts.answers import Answer, InLanes, answer_of
from pipeline.starts.start import Clock, Report, Started

TRUST = 4
"""Calls that may fail beyond two in three before a world is left to the solver [1]."""
EVERY, EVERY_ACCELERATED = 12, 15
"""Sweeps between two calls with plain sweeps, and where the solver extrapolates by itself [1]."""
PAYS = 240.0
"""Sweeps left from which on a network is asked. On tuning worlds as many are made as with 0, in half the time [1]."""
SMALL = 500
"""Contacts of a world up to which answers gained sweeps before the first sweep and, with Aitken, in all calls [1]."""
PARTS = ("solve", "splat", "network", "gather", "start")
COUNTS = ("solves", "empty", "early", "calls", "asked", "refused", "failed", "undone")


@dataclass(frozen=True, kw_only=True)
class CallOptions(Settings):
    """When the network is called, and which of its corrections are taken."""

    settings_prefix: ClassVar[str] = "CallOptions."

    every: Annotated[int, Limits(least=2, most=MAX_INT)] | None = None
    """Sweeps between two calls; None: 12, or 15 where the solver extrapolates by itself [1]."""
    begin: bool | None = None
    """Ask the network before the first sweep; None: in worlds of up to ``SMALL`` contacts, as in larger ones its answer
    there costs sweeps."""
    middle: bool = True
    """Call while the solve has not converged."""
    pays: Annotated[float, Limits(least=0.0, size=math.inf)] | None = None
    """Sweeps that are left, as the rate of the last two tells, from which on the network is asked; with fewer left all
    contacts move by an even share of Aitken's step. 0: it is always asked; None: 240, but where the solver extrapolates
    by itself 0 in worlds of up to ``SMALL`` contacts, and inf in larger ones, where its answers cost 2 % of the sweeps
    more than even shares do (750 states of 1 000 discs) [1]."""
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
    """Calls: of the network, or for an even share."""
    asked: np.ndarray
    """Calls that went to the network."""
    refused: np.ndarray
    """Corrections not taken: not finite, or too large."""
    failed: np.ndarray
    """Corrections after which the step of a sweep had not shrunk."""
    undone: np.ndarray
    """Failed corrections that were taken back."""
    seconds: dict[str, float]
    """Wall time by part [s]; reading features counts as "splat", writing corrections as "gather". In lanes all of a
    call in mid-solve is one launch, which counts as "network"."""

    @classmethod
    def of(cls, calls: CallsInFlight, seconds: dict[str, float]) -> CallStats:
        """Return counts that are those of the calls, where these have them."""
        table = calls.calls.table
        counts: dict[str, Any] = {
            name: calls.calls.numpy(name) if name in table else np.zeros(calls.reader.worlds, np.int64)
            for name in COUNTS
        }
        return cls(**counts, seconds=seconds)

    def totals(self) -> dict[str, Any]:
        """Return the sums over the worlds, by name, and "seconds"."""
        return {**{name: int(getattr(self, name).sum()) for name in COUNTS}, "seconds": dict(self.seconds)}


def grid_of(sim: dc.Simulation, spacing: float) -> dc.Grid:
    """Make the grid over all that stands in any world, its nodes ``spacing`` of the largest typical diameter apart.

    A contact beyond it, of a body that flew away, is moved to its border.
    """
    model, state = sim.model, sim.state
    stands = model.numpy("shape_category") != 0  # not the shapes of empty slots, far from all else
    center = state.numpy("position")[model.numpy("shape_body")[stands]]
    reach = model.numpy("shape_extent")[stands, None] + np.abs(model.numpy("shape_center")[stands])
    step = spacing * float(model.numpy("length_scale").max())
    if not len(center):
        return dc.Grid.from_box((0.0, 0.0), (step, step), step)
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
        require("torch", "pipeline")
        if sim.dtype != np.float32:
            raise ValueError(f"sim.dtype is {sim.dtype}; the network reads float32")
        self.sim, self.options = sim, options or CallOptions()
        self.model = model.eval()
        grid = grid or grid_of(sim, model.config.spacing)
        self.reader = SolveReader(sim, grid, limit=self.options.limit)
        plain = sim.config.acceleration == "none"
        self.every = self.options.every or (EVERY if plain else EVERY_ACCELERATED)
        self.clock = Clock(dict.fromkeys(PARTS, 0.0))
        self._network = answer_of(self.reader, self.model, self.clock, compile=compile, bfloat16=bfloat16)
        self._even = InLanes(self.reader)
        is_even = isinstance(self._network, InLanes) and self._network.model is None
        begin, pays, small = self.options.begin, self.options.pays, 0
        # an even share of no step is nothing
        self.begin = not is_even if begin is None else begin
        self._first_most = SMALL if begin is None else MAX_INT
        if is_even:
            pays = math.inf
        elif pays is None:
            pays, small = (PAYS, 0) if plain else (math.inf, SMALL)
        rules = {name: getattr(self.options, name) for name in ("middle", "most", "harm")}
        self._calls = CallsInFlight(self.reader, **rules, trust=TRUST, pays=pays, small=small)
        self.stats = CallStats.of(self._calls, self.clock.seconds)
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
        sim, options, stats, calls = self.sim, self.options, self.stats, self._calls
        self._timed("solve", sim.solve, pause=0)
        running = sim.running
        stats.solves += 1
        stats.empty += sim.contacts.numpy("contact_count") == 0
        if not running.any():
            started()
            return
        self.reader.begin()
        calls.begin(running)
        lanes = self._network if isinstance(self._network, InLanes) else None
        if lanes is not None:
            lanes.refresh()
        if self.begin and options.most:
            self._ask_first(np.flatnonzero(running))
        started()
        at_once = lanes if self.watch is None else None
        if at_once is not None:
            self.reader.take_all()
        first = True
        while running.any():
            more = bool(calls.asking.any()) and (options.middle or bool(calls.waiting.any()))
            self._timed("solve", sim.resume, pause=self.every if more else None)
            was, running = running, sim.running
            if first:
                stats.early += was & ~running
                first = False
            if not more or not running.any():
                continue
            if at_once is not None:
                self._timed("network", calls.round, at_once.lanes)
                continue
            calls.decide()
            answer = calls.answer
            self._ask(np.flatnonzero(answer == How.NETWORK), self._network, begin=False)
            self._ask(np.flatnonzero(answer == How.EVEN), self._even, begin=False)

    def _ask_first(self, worlds: np.ndarray) -> None:
        """Correct the impulses of worlds, (n,), before the first sweep."""
        self._timed("splat", self.reader.read, worlds, begin=True, what="steps")
        steps = self.reader.scale[: len(worlds), Scale.STEP]
        # where no contact would take a step beyond the tolerance, the first sweep is the last
        contacts = np.diff(self.reader.packed_start[: len(worlds) + 1])
        needed = (steps * np.sqrt(contacts) >= self.sim.config.ends_at[1]) & (contacts <= self._first_most)
        self._ask(worlds[needed], self._network, begin=True)

    def _ask(self, worlds: np.ndarray, answer: Answer, *, begin: bool) -> None:
        """Correct the impulses of worlds, (n,), and count."""
        if not len(worlds):
            return
        what = "features" if self.watch is not None and answer.reads == "steps" else answer.reads
        self._timed("splat", self.reader.read, worlds, begin=begin, what=what)
        if self.watch is not None:
            self.watch(worlds, begin)
        self._timed("network", answer, begin=begin)
        self._calls.settle(begin=begin)

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
                f"network: {total['calls'] / solves:.2f} calls a solve, of {total['solves']} solves; "
                f"{total['asked'] / solves:.2f} asked it, the others made an even share of Aitken's step",
                f"  solves without a call: no contacts in {share['empty']}, converged before the first call in "
                f"{share['early']}",
                f"  of the corrections {total['refused']} were refused, {total['failed']} gained nothing, of which "
                f"{total['undone']} were undone",
            ]
        )


def _nothing() -> None:
    """Stand for a callback that nobody has given."""
