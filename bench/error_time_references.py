"""References: contact problems solved in float64 to 1e-12, by sweeps and then by Newton's method along a path.

Sweeps alone stall in hyperstatic piles, where the Delassus matrix W is singular and friction makes the problem
nonsymmetric: near a change of 1e-8 the impulses still have tenths of an N s to go along its null space. Newton's method
on the Alart-Curnier equations (P. Alart, A. Curnier 1991) stalls there too. Both go through once W is shifted, as in
the proximal point method: u = W p + free + shift (p - center), with the last solution as the center, is solved for
shifts that fall from 1e-3 of the effective masses; the contacts that open, close, stick or slip on the way do so a few
at a time. A reference is accepted by the solver's own measures: its residual, and the change of a further sweep.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.arrays import require
from dc_kernels.measure import contact_slots
from dc_kernels.rows import COLUMNS
from dc_kernels.types import LANES

ACCURACY = 1e-12  # largest change of a sweep over the largest impulse, and relative natural map
SWEEPS = 20_000  # before Newton's method, in each round
ROUNDS = 4
NEWTON_STEPS = 40  # for one value of the shift
SHIFTS, FAILURES = 20, 2  # values of the shift in a round, and how many may fail
FIRST, DOWN, SMALLEST = 1e-3, 0.2, 1e-13  # shift [1]: the first, times what after success, the last
CLOSE = 1e-12  # of the equations [N s], relative to the largest impulse above 1 N s: success
ROUND_OFF = 2e-14  # of the equations [N s], relative to the largest impulse above 1 N s
MEMORY = 4  # residuals that a step may not exceed
SHORTEST = 1e-3  # part of a step, the least tried


@dataclass(frozen=True)
class Problem:
    """A world's contact problem: ``u = matrix @ p + free``, pairs of normal and tangent, contact by contact."""

    matrix: Any
    """Delassus matrix (2c, 2c) [1/kg], sparse."""
    free: np.ndarray
    """Relative velocities without impulses, bias added to the normal one (2c,) [m/s]."""
    friction: np.ndarray
    """Coulomb coefficients (c,) [1]."""
    mass: np.ndarray
    """Effective masses (2c,) [kg]."""

    def wrong(self, p: np.ndarray) -> float:
        """Norm of p minus its step, projected: zero at a solution [N s]."""
        return float(np.linalg.norm(project(p, p - self.mass * (self.matrix @ p + self.free), self.friction)))


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


def problem(sim: dc.Simulation) -> Problem:
    """The contact problem of a step after ``collide``, from the rows that the solver sweeps.

    Args:
        sim: one world without joints, with rows of the variant "general" (``specialize=False``).

    Raises:
        ValueError: for another simulation.
    """
    if sim.variant != "general" or sim.model.world_count != 1:
        raise ValueError(
            f"sim has rows of the variant {sim.variant!r} and {sim.model.world_count} worlds; it needs 'general' and 1"
        )
    sparse = require("scipy.sparse", "bench")
    slots, _ = contact_slots(sim.contacts)
    slot = sim.rows.numpy("slot")[slots].astype(np.int64)
    block, lane = np.divmod(slot, 2 * LANES)
    columns = COLUMNS["general"]
    rows = sim.rows.numpy("rows").astype(np.float64).reshape(-1, len(columns), LANES)[block, :, lane]
    column = {name: rows[:, i] for i, name in enumerate(columns)}
    first, second = sim.rows.numpy("row_body")[slot], sim.rows.numpy("row_body")[slot + LANES]
    predicted = sim.motion.numpy("predicted").astype(np.float64)
    count, bodies = len(slot), len(predicted)
    number = np.arange(count)
    nx, ny = column["nx"], column["ny"]
    entries = []
    for row, x, y, turn_a, turn_b in (
        (2 * number, nx, ny, column["rAn"], column["rBn"]),
        (2 * number + 1, ny, -nx, column["rAt"], column["rBt"]),
    ):
        for body, sign, turn in ((first, -1.0, turn_a), (second, 1.0, turn_b)):
            entries += [(row, 3 * body + k, sign * value) for k, value in enumerate((x, y, turn))]
    i, j, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    jacobian = sparse.csr_matrix((values, (i, j)), shape=(2 * count, 3 * bodies))
    inverse = np.stack([predicted[:, 3], predicted[:, 3], np.zeros(bodies)], axis=1)
    inverse[first, 2] = column["iA"]
    inverse[second, 2] = np.where(column["iB"] > 0, column["iB"], inverse[second, 2])
    free = jacobian @ predicted[:, :3].ravel()
    free[::2] += column["bias"]
    matrix = (jacobian.multiply(inverse.ravel()) @ jacobian.T).tocsc()
    return Problem(matrix, free, column["mu"], np.stack([column["en"], column["et"]], axis=1).ravel())


def project(p: np.ndarray, step: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Impulses minus their step, clamped normal first and then tangent (2c,)."""
    normal = np.maximum(step[::2], 0.0)
    limit = friction * normal
    return p - np.stack([normal, np.clip(step[1::2], -limit, limit)], axis=1).ravel()


def newton(task: Problem, center: np.ndarray, start: np.ndarray, shift: float) -> tuple[np.ndarray, float]:
    """Impulses (2c,) and what is left [N s] by semismooth Newton steps, with ``shift (p - center)`` in the velocities.

    A step may raise the equations' residual, but not above the largest of the last few (L. Grippo et al. 1986).
    """
    sparse, linalg = require("scipy.sparse", "bench"), require("scipy.sparse.linalg", "bench")
    unit = sparse.identity(len(start), format="csr")
    matrix = sparse.diags(task.mass) @ task.matrix + shift * unit
    offset = task.mass * task.free - shift * center
    odd = np.arange(1, len(start), 2)

    def equations(p: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """Norm and values of what is zero at a solution (2c,), normal and tangential steps (c,)."""
        step = p - matrix @ p - offset
        wrong = project(p, step, task.friction)
        return float(np.linalg.norm(wrong)), wrong, step[::2], step[1::2]

    p = best = start
    size, wrong, normal, tangent = equations(p)
    sizes, least = [size], size
    while len(sizes) <= NEWTON_STEPS and size > ROUND_OFF * max(1.0, float(np.abs(p).max(initial=0.0))):
        closed = normal > 0.0
        slides = closed & (np.abs(tangent) > task.friction * normal)
        # rows: p = 0 where open, no velocity where closed; where it slides, p_t = +-mu times the new p_n
        whole = np.stack([closed, closed & ~slides], axis=1).ravel().astype(np.float64)
        coupling = np.where(slides, np.sign(tangent) * task.friction, 0.0)
        slide = sparse.csr_matrix((coupling, (odd, odd - 1)), shape=unit.shape)
        slope = sparse.diags(whole) @ matrix + sparse.diags(1.0 - whole) - slide @ (unit - matrix)
        try:
            step = linalg.splu(slope.tocsc()).solve(-wrong)
        except RuntimeError:  # exactly singular
            break
        allowed, part = max(sizes[-MEMORY:]), 1.0
        trials = []
        while part >= SHORTEST:
            trials.append((*equations(p + part * step), p + part * step))
            if trials[-1][0] < allowed:
                break
            part *= 0.5
        size, wrong, normal, tangent, p = min(trials, key=lambda trial: trial[0])
        sizes.append(size)
        if size < least:
            best, least = p, size
        elif len(sizes) > 10 and size >= min(sizes[:-8]):
            break
    return best, least


def solve(sim: dc.Simulation, rounds: int = ROUNDS) -> Reference:
    """The reference of a step after ``collide``, from the impulses that are there; the best found, see ``reached``.

    Args:
        sim: float64, one world, ``specialize=False``.
        rounds: of sweeps and Newton's method, at most.
    """
    slots, _ = contact_slots(sim.contacts)
    rough = replace(sim.config, acceleration="aitken", stop="change", tolerance=1e-14, max_sweeps=SWEEPS)
    polish = replace(rough, acceleration="none", tolerance=0.0, max_sweeps=3)
    task = problem(sim)
    impulse = sim.contacts.numpy("impulse")
    best: Reference | None = None
    for _ in range(rounds):
        sim.solve(rough)
        center = impulse[slots].astype(np.float64).ravel()
        shift, failed = FIRST, 0
        for _ in range(SHIFTS):
            p, wrong = newton(task, center, center, shift)
            if wrong > CLOSE * max(1.0, float(np.abs(center).max(initial=0.0))):
                failed, shift = failed + 1, shift / DOWN
                if failed == FAILURES:
                    break
                continue
            center, shift = p, max(shift * DOWN, SMALLEST)
            if task.wrong(p) < CLOSE:
                break
        impulse[slots] = center.reshape(-1, 2)
        sim.solve(polish)
        found = _report(sim, slots)
        if best is None or max(found.change, found.residual) < max(best.change, best.residual):
            best = found
        if best.reached:
            break
    assert best is not None
    return best


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
