"""What every start of the contact solver is: a solve phase of its own, and a report of what it did."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import dc_kernels as dc

Started = Callable[[], None]
"""Is called once ``contacts.impulse`` holds what the first sweep begins with."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a start did, summed over its solves."""

    seconds: Mapping[str, float]
    """Wall time by part [s]: "solve" are the sweeps, "splat", "network" and "gather" the parts of a network's answer,
    "start" is all else that the start needs."""
    is_network: bool = False
    """Whether a network answers, whose time belongs to the method; other starts are yardsticks, such as a solution."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Numbers of a network, of worlds and steps: "calls", "skipped" (it was not needed) and "dropped" (its answer was
    not finite, or did harm) at least."""
    text: str = ""
    """What a network did, in words."""

    def to_dict(self) -> dict[str, Any]:
        """Return counts, ``seconds`` and, as ``explain``, the text, for a run's summary."""
        return {**self.counts, "seconds": dict(self.seconds), "explain": self.text}


class Start(Protocol):
    """A start of the contact solver, made for one simulation."""

    sim: dc.Simulation
    """The simulation whose steps it solves."""

    def solve(self, started: Started | None = None) -> None:
        """Run the solve phase of a step, between ``sim.collide(dt)`` and ``sim.advance()``.

        Args:
            started: is called once ``contacts.impulse`` holds what the first sweep begins with.
        """

    def report(self) -> Report:
        """Return what it did so far."""


def step(start: Start, dt: float) -> None:
    """Make a time step of dt [s] of the start's simulation."""
    start.sim.collide(dt)
    start.solve()
    start.sim.advance()


class Clock:
    """Wall time by part; what a part spends within another one counts for itself alone."""

    def __init__(self, seconds: dict[str, float]) -> None:
        """Add to ``seconds``, whose keys are the parts [s]."""
        self.seconds = seconds
        self._within = 0.0  # of the parts that ended within the one under way

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the wall time of the block to a part."""
        outside, self._within = self._within, 0.0
        before = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - before
            self.seconds[name] += spent - self._within
            self._within = outside + spent
