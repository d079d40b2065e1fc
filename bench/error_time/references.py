"""References: contact problems solved in float64 to 1e-12, by sweeps and then in Delassus form with Newton's method.

Sweeps alone stall in hyperstatic piles: near a change of 1e-8 the impulses still have tenths of an N s to go along the
null space of the Delassus matrix. A reference is accepted by the solver's own measures: its residual, and the largest
change of a further sweep.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.measure import contact_slots

ACCURACY = 1e-12  # largest change of a sweep over the largest impulse, and relative natural map
TARGET = 1e-13  # what the Delassus form is solved to
SWEEPS = 2_000  # before
MOST = 50_000  # sweeps beside Newton's method
POLISH = 3  # plain sweeps at the end


@dataclass(frozen=True)
class Reference:
    """What a float64 solve to ``ACCURACY`` found."""

    key: np.ndarray
    """Of the contacts (c,)."""
    impulse: np.ndarray
    """(c, 2) [N s]."""
    velocity: np.ndarray
    """Solved velocity and spin of each body (bodies, 3) [m/s, rad/s]."""
    moved: float
    """Norm of what the impulses change the velocities by, in the mass norm [sqrt(J)]."""
    change: float
    """Largest change of a further sweep, over the largest impulse [1]."""
    residual: float
    """Relative natural map [1]."""

    @property
    def reached(self) -> bool:
        """Whether it is one."""
        return max(self.change, self.residual) <= ACCURACY


def solve(sim: dc.Simulation, most: int = MOST) -> Reference:
    """The reference of a step after ``collide``, from the impulses that are there; the best found, see ``reached``.

    Args:
        sim: float64, one world without joints.
        most: sweeps in Delassus form; Newton's method ends with them.

    Raises:
        ValueError: for another simulation.
    """
    if sim.dtype != np.float64 or sim.model.world_count != 1 or sim.model.joint_count:
        raise ValueError(
            f"sim is {sim.dtype} with {sim.model.world_count} worlds and {sim.model.joint_count} joints; "
            "a reference needs float64, 1 and 0"
        )
    slots, _ = contact_slots(sim.contacts)
    impulse = sim.contacts.numpy("impulse")
    rough = replace(sim.config, stop="change", tolerance=1e-15, max_sweeps=SWEEPS)
    polish = replace(rough, acceleration="none", tolerance=0.0, max_sweeps=POLISH)
    sim.solve(rough)
    found = _report(sim, slots)
    if not found.reached:
        given = delassus.from_world(sim)
        start = delassus.read_impulses(sim, given)
        # the natural map of the field alone: it is the one the simulation reports
        solution = delassus.solve(given, "newton", tolerance=TARGET, max_sweeps=most, start=start, scaled=False)
        impulse[given.slot] = solution.impulses
    sim.solve(polish)
    return _report(sim, slots)


def spread(sim: dc.Simulation, references: Sequence[Reference]) -> float:
    """Largest distance of two references in velocity, over what their impulses change velocities by [1]."""
    pairs = itertools.combinations(references, 2)
    return max((mass_norm(sim, a.velocity - b.velocity) / max(a.moved, 1e-300) for a, b in pairs), default=0.0)


def mass_norm(sim: dc.Simulation, velocity: np.ndarray) -> float:
    """Root of twice the kinetic energy of velocities and spins (bodies, 3) [sqrt(J)]."""
    mass, inertia = sim.model.numpy("mass").astype(np.float64), sim.model.numpy("inertia").astype(np.float64)
    velocity = velocity[: len(mass)].astype(np.float64)
    return float(np.sqrt((mass * (velocity[:, :2] ** 2).sum(axis=1) + inertia * velocity[:, 2] ** 2).sum()))


def _report(sim: dc.Simulation, slots: np.ndarray) -> Reference:
    impulse = sim.contacts.numpy("impulse")[slots].copy()
    solved = sim.motion.numpy("solved")[: sim.model.body_count, :3].copy()
    predicted = sim.motion.numpy("predicted")[: sim.model.body_count, :3]
    return Reference(
        key=sim.contacts.numpy("key")[slots].copy(),
        impulse=impulse,
        velocity=solved,
        moved=mass_norm(sim, solved - predicted),
        change=float(sim.stats.numpy("change")[0]) / max(float(np.abs(impulse).max(initial=0.0)), 1e-300),
        residual=float(sim.stats.numpy("residual")[0]),
    )
