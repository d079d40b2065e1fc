"""Start strategies of the thesis protocol: what the contact solver starts from.

A strategy is a callable ``sim -> None`` for ``Simulation.step(dt, start=...)``: it runs between collide
and solve and writes ``sim.contacts.impulse``. Start impulses outside the friction cone are meant: the
solver clamps them.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots

Strategy = Callable[["dc.Simulation"], None]

RANDOM_NORMAL = (0.0, 5.0)  # [N s], uniform
RANDOM_TANGENT = (-2.0, 2.0)  # [N s], uniform
BAD_IMPULSE = (50.0, 50.0)  # [N s], normal and tangential


def set_impulses(sim: dc.Simulation, values: np.ndarray | tuple[float, float]) -> None:
    """Write the start impulses of the present contacts, world after world [N s], (contacts, 2)."""
    impulse = sim.contacts.numpy("impulse").copy()
    impulse[contact_slots(sim.contacts)[0]] = values
    sim.contacts.assign("impulse", impulse)


def none(sim: dc.Simulation) -> None:
    """Zero, for contacts and joints."""
    set_impulses(sim, (0.0, 0.0))
    if sim.joints is not None:
        sim.joints.assign("joint_impulse", np.zeros_like(sim.joints.numpy("joint_impulse")))


def builtin(sim: dc.Simulation) -> None:
    """Each contact's own impulse of the step before, zero if it is new: what collide has left there.

    Raises:
        ValueError: when the simulation's configuration starts from zero instead.
    """
    if sim.config.start != "cache":
        raise ValueError(f"SolverConfig.start is {sim.config.start!r}; the strategy builtin needs 'cache'")


def bad(sim: dc.Simulation) -> None:
    """50 N s, normal and tangential."""
    set_impulses(sim, BAD_IMPULSE)


class Random:
    """Uniform impulses, normal in [0, 5] and tangential in [-2, 2] N s; each world has a stream of its own."""

    def __init__(self, seed: int = 0) -> None:
        """World w draws from seed ``seed + w``."""
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        self.seed = seed
        self.streams: list[np.random.Generator] = []

    def __call__(self, sim: dc.Simulation) -> None:
        """Draw the start of every contact."""
        counts = sim.contacts.numpy("contact_count")
        for world in range(len(self.streams), len(counts)):
            self.streams.append(np.random.Generator(np.random.PCG64([self.seed + world, 1])))
        low, high = np.transpose([RANDOM_NORMAL, RANDOM_TANGENT])
        draws = [s.uniform(low, high, (int(n), 2)) for s, n in zip(self.streams, counts, strict=True)]
        set_impulses(sim, np.concatenate(draws))


class Copy:
    """The converged impulses of this very step: the oracle. Rounded to ``decimals`` if given."""

    def __init__(self, decimals: int | None = None) -> None:
        """``decimals`` may be negative, as for ``numpy.round``."""
        self.decimals = decimals

    def __call__(self, sim: dc.Simulation) -> None:
        """Solve; the solve that follows starts from the same predicted velocities and from this solution."""
        sim.solve()
        if self.decimals is not None:
            slots, _ = contact_slots(sim.contacts)
            set_impulses(sim, np.round(sim.contacts.numpy("impulse")[slots], self.decimals))


# name: seed -> strategy; "copyN" for any number of decimals N is understood by ``parse``
STRATEGIES: dict[str, Callable[[int], Strategy]] = {
    "none": lambda seed: none,
    "builtin": lambda seed: builtin,
    "random": Random,
    "bad": lambda seed: bad,
    "copy": lambda seed: Copy(),
}


def parse(name: str, seed: int = 0) -> Strategy:
    """The strategy of a name: none, builtin, random, bad, copy, or copyN with N decimals (copy0, copy2); any case.

    Args:
        name: of the strategy.
        seed: of the random one.

    Raises:
        ValueError: for an unknown name.
    """
    lower = name.lower()
    if lower in STRATEGIES:
        return STRATEGIES[lower](seed)
    match = re.fullmatch(r"copy(\d{1,2})", lower)
    if match is None:
        raise ValueError(f"start is {name!r}; it must be one of {tuple(STRATEGIES)} or copyN with N decimals")
    return Copy(int(match[1]))
