"""Starts that write impulses before a solve: those of the thesis protocol that do not use the solution.

Impulses outside the friction cone are intended: the solver projects them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.starts.start import Clock, Report, Started

RANDOM_NORMAL = (0.0, 5.0)
"""Range of random normal impulses [N s]."""
RANDOM_TANGENT = (-2.0, 2.0)
"""Range of random tangential impulses [N s]."""
BAD_IMPULSE = (50.0, 50.0)
"""Normal and tangential impulse of the bad start [N s]."""
PARTS = ("start", "splat", "network", "gather", "solve")


class ImpulseStart(ABC):
    """A start that writes the impulses of the present contacts, from which the simulation then solves.

    It can also be passed to ``sim.step(dt, start=...)``.
    """

    def __init__(self, sim: dc.Simulation) -> None:
        """Start the solves of a simulation."""
        self.sim = sim
        self.clock = Clock(dict.fromkeys(PARTS, 0.0))

    @abstractmethod
    def write(self) -> None:
        """Write the start impulses of the present contacts to ``sim.contacts.impulse`` [N s]."""

    def __call__(self, sim: dc.Simulation) -> None:
        """Write the start impulses, for ``sim.step(dt, start=...)``.

        Raises:
            ValueError: the start was made for another simulation.
        """
        if sim is not self.sim:
            raise ValueError("the start was made for another simulation")
        self.write()

    def solve(self, started: Started | None = None) -> None:
        """Write the start impulses and solve; see ``Start.solve``.

        Raises:
            ValueError: a start impulse is not finite.
        """
        with self.clock.part("start"):
            self.write()
            self.sim.check_start()
        if started is not None:
            started()
        with self.clock.part("solve"):
            self.sim.solve()

    def report(self) -> Report:
        """Return the wall times."""
        return Report(seconds=dict(self.clock.seconds))


def set_impulses(sim: dc.Simulation, values: np.ndarray | tuple[float, float]) -> None:
    """Write the start impulses of the present contacts, world after world, (contacts, 2) [N s]."""
    impulse = sim.contacts.numpy("impulse").copy()
    impulse[contact_slots(sim.contacts)[0]] = values
    sim.contacts.assign("impulse", impulse)


class Zero(ImpulseStart):
    """Starts contacts, their rolling resistance and joints from zero."""

    def write(self) -> None:
        """Write zeros."""
        set_impulses(self.sim, (0.0, 0.0))
        rolling = self.sim.contacts.numpy("rolling_impulse")
        if len(rolling):
            self.sim.contacts.assign("rolling_impulse", np.zeros_like(rolling))
        if self.sim.joints is not None:
            self.sim.joints.assign("joint_impulse", np.zeros_like(self.sim.joints.numpy("joint_impulse")))


class Builtin(ImpulseStart):
    """Starts each contact from its impulse of the previous step, a new contact from zero: the result of ``collide``."""

    def write(self) -> None:
        """Leave the impulses as they are.

        Raises:
            ValueError: the simulation's configuration starts from zero.
        """
        if self.sim.config.start != "cache":
            raise ValueError(f"SolverConfig.start is {self.sim.config.start!r}; the strategy builtin needs 'cache'")


class Bad(ImpulseStart):
    """Starts from 50 N s, normal and tangential."""

    def write(self) -> None:
        """Write ``BAD_IMPULSE``."""
        set_impulses(self.sim, BAD_IMPULSE)


class Random(ImpulseStart):
    """Starts from uniform impulses, normal in [0, 5] and tangential in [-2, 2] N s; each world has its own stream."""

    def __init__(self, sim: dc.Simulation, seed: int = 0) -> None:
        """Let world w draw from seed ``seed + w``.

        Raises:
            ValueError: for a negative seed.
        """
        super().__init__(sim)
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        self.streams = [np.random.Generator(np.random.PCG64([seed + w, 1])) for w in range(sim.model.world_count)]

    def write(self) -> None:
        """Draw the start of every contact."""
        counts = self.sim.contacts.numpy("contact_count")
        low, high = np.transpose([RANDOM_NORMAL, RANDOM_TANGENT])
        draws = [s.uniform(low, high, (int(n), 2)) for s, n in zip(self.streams, counts, strict=True)]
        set_impulses(self.sim, np.concatenate(draws))
