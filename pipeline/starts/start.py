"""The protocol of starts of the contact solver: each runs the solve phase, and reports its costs."""

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
    """Statistics of a start, summed over its solves."""

    seconds: Mapping[str, float]
    """Wall time by part [s]: "solve" for the sweeps, "splat", "network" and "gather" for the parts of a network's call,
    "start" for the rest of the start."""
    is_network: bool = False
    """Whether it is a network, whose time is part of the method; other starts are references, such as a solution."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Counts of a network over worlds and steps, at least "calls", "skipped" (not needed) and "dropped" (the output was
    not finite, or did harm)."""
    text: str = ""
    """Description of a network's calls."""

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
            started: function called once ``contacts.impulse`` holds the start of the first sweep.
        """

    def report(self) -> Report:
        """Return the statistics so far."""


def step(start: Start, dt: float) -> None:
    """Make a time step of dt [s] of the start's simulation."""
    start.sim.collide(dt)
    start.solve()
    start.sim.advance()


class Clock:
    """Wall time by part; the time of a nested part is not counted for the outer one."""

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
