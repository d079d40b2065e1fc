"""Choice of the gain of a ContactNet's answer by the sweeps of whole solves with it in the loop.

Training lowers the error after one call. What that does to the calls and extrapolations that follow is not in its loss
(a gradient through several calls is useless, as each extrapolation multiplies it by up to 200): with plain sweeps the
full answer costs more sweeps than it saves, with an accelerated solver it saves them. So a gain for each is searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Settings
from pipeline.contactnet.rollouts import THESES_SETTINGS
from pipeline.options import RunOptions
from pipeline.scenes import Thesis
from pipeline.seeds import check_training_seeds
from pipeline.starts.learned import CallOptions, LearnedSolve

GAINS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.4)
"""Gains that are tried, of which the first and the last are there for their neighbours [1]."""


@dataclass(frozen=True, kw_only=True)
class Crowd(Settings):
    """Worlds of one kind, at several steps of their fall."""

    bodies: Count
    """Discs in each world [1]."""
    worlds: Count
    """Worlds at each step [1]."""
    acceleration: str
    """Acceleration of the solver."""
    steps: tuple[int, ...]
    """Steps at which a solve is repeated with each gain [1]."""
    max_sweeps: Count = 1000
    """Largest number of sweeps of a solve [1]."""


CROWDS = (
    Crowd(bodies=100, worlds=32, acceleration="none", steps=(60, 90, 110, 130, 150, 170, 200, 240)),
    Crowd(bodies=100, worlds=32, acceleration="aitken", steps=(60, 90, 110, 130, 150, 170, 200, 240)),
    Crowd(bodies=1000, worlds=4, acceleration="aitken", steps=(110, 140, 170, 200, 230, 270, 320), max_sweeps=3000),
)


def seeds_of(crowds: Sequence[Crowd]) -> int:
    """Count the worlds, and so the seeds, of some crowds."""
    return sum(len(crowd.steps) * crowd.worlds for crowd in crowds)


class Snapshot:
    """States whose solve can be repeated, with the sweeps that it takes from the cache."""

    def __init__(self, crowd: Crowd, step: int, seed: int, model: Any) -> None:
        """Let worlds of the seeds from ``seed`` on fall to a step.

        Raises:
            ValueError: for held-out seeds.
        """
        check_training_seeds(seed, crowd.worlds)
        config = dc.SolverConfig.preset(
            "accurate",
            acceleration=crowd.acceleration,  # type: ignore[arg-type]
            max_sweeps=crowd.max_sweeps,
            min_sweeps=1,
            **THESES_SETTINGS,  # type: ignore[arg-type]
        )
        self.sim = RunOptions(worlds=crowd.worlds, seed=seed).simulation(Thesis(bodies=crowd.bodies), config)
        self.sim.run(step, 0.01)
        self.sim.collide(0.01)
        self.start = self.sim.contacts.numpy("impulse").copy()
        self.sim.solve()
        self.base = self.sim.stats.numpy("sweeps").copy()
        self.solve = LearnedSolve(self.sim, model, CallOptions(begin=True, pays=0.0))

    def cost(self) -> np.ndarray:
        """Return the log of the sweeps over those from the cache, of the worlds that need more than a few."""
        self.sim.contacts.numpy("impulse")[...] = self.start
        self.solve.solve()
        counted = self.base > self.solve.every
        return np.log(self.sim.stats.numpy("sweeps")[counted] / self.base[counted])


def best_gain(costs: np.ndarray) -> float:
    """Choose the gain of the least cost, of costs (len(GAINS),) that are smoothed by (1, 2, 1), as solves are chaotic.

    The first and the last of ``GAINS`` are there for their neighbours.
    """
    smooth = (costs[:-2] + 2.0 * costs[1:-1] + costs[2:]) / 4.0
    return GAINS[1 + int(smooth.argmin())]


def choose_gains(model: Any, seed: int, crowds: Sequence[Crowd] = CROWDS) -> dict[str, Any]:
    """Set the gains of a ContactNet, for plain and for accelerated solvers.

    Args:
        model: a ContactNet, whose ``gain`` is written.
        seed: of the first world.
        crowds: states to solve; those of one kind of solver count alike.

    Returns:
        ``gain`` (plain, accelerated), and by solver and discs the mean log of sweeps over those from the cache for each
        of ``GAINS``.
    """
    groups = []
    for crowd in crowds:
        groups.append([Snapshot(crowd, step, seed + i * crowd.worlds, model) for i, step in enumerate(crowd.steps)])
        seed += len(crowd.steps) * crowd.worlds
    costs = np.zeros((len(crowds), len(GAINS)))
    for k, gain in enumerate(GAINS):
        model.gain.fill_(gain)
        for i, group in enumerate(groups):
            costs[i, k] = np.concatenate([snapshot.cost() for snapshot in group]).mean()
    accelerated = np.array([crowd.acceleration != "none" for crowd in crowds])
    for kind in (0, 1):
        mine = accelerated == bool(kind)
        model.gain[kind] = best_gain(costs[mine].mean(axis=0)) if mine.any() else 1.0
    table = {f"{crowd.acceleration}_{crowd.bodies}": row.tolist() for crowd, row in zip(crowds, costs)}
    return {"gain": model.gain.tolist(), "gains": list(GAINS), **table}
