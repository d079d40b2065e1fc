"""Sweeps over contact problems from small dense Jacobians; their adjoint as the transpose of their derivative.

Velocities of a pair are V = (v_A, w_A, v_B, w_B), (6,).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, cross, tangent
from dc_kernels.learn.packed import Active, Column


def kernels(dtype: str) -> Kernels:
    """The kernels by name."""
    return {
        "complete_rows": complete_rows,
        "push_impulses": push_impulses,
        "pull_velocities": pull_velocities,
        "step_problem": step_problem,
        "sweep_problem": sweep_problem,
        "pull_problem": pull_problem,
    }


class _Row(NamedTuple):
    """Jacobian and response M^-1 J^T of a contact's two directions, (2, 6) each, and its scalars."""

    jacobian: Array
    response: Array
    mass: Array
    bias: float
    friction: float
    bodies: Array

    def speed(self, velocity: Array) -> Array:
        return self.jacobian @ velocity[self.bodies].ravel()

    def push(self, velocity: Array, impulse: Array) -> None:
        change = impulse @ self.response
        velocity[self.bodies[0]] += change[:3]
        velocity[self.bodies[1]] += change[3:]


def _rows(w: int, contact_start: Array, row: Array, row_body: Array) -> Iterator[tuple[int, _Row]]:
    for c in range(contact_start[w], contact_start[w + 1]):
        r = {column.name.lower(): value for column, value in zip(Column, row[c].astype(np.float64))}
        n = np.array([r["nx"], r["ny"]])
        axes = (("normal", n), ("tangent", tangent(n)))
        jacobian = np.array([[*-d, -r[f"{of}_arm_a"], *d, r[f"{of}_arm_b"]] for of, d in axes])
        response = np.array(
            [[*(-r["inv_mass_a"] * d), -r[f"{of}_turn_a"], *(r["inv_mass_b"] * d), r[f"{of}_turn_b"]] for of, d in axes]
        )
        yield c, _Row(jacobian, response, np.array([r["en"], r["et"]]), r["bias"], r["mu"], row_body[c])


def complete_rows(
    tid: int,
    world_offset: int,
    given_mass: int,
    contact_start: Array,
    row_body: Array,
    inverse: Array,
    arm_a: Array,
    arm_b: Array,
    row: Array,
) -> None:
    """Fill in arms, inverse masses and, unless they are given, effective masses 1 / (J M^-1 J^T) of a world."""
    w = tid + world_offset
    for c in range(contact_start[w], contact_start[w + 1]):
        n = row[c, [Column.NX, Column.NY]].astype(np.float64)
        arms = np.array([[cross(arm, d) for arm in (arm_a[c], arm_b[c])] for d in (n, tangent(n))])  # (2, 2)
        masses = inverse[row_body[c]]
        turn = arms * masses[:, 2]
        row[c, Column.NORMAL_ARM_A : Column.TANGENT_ARM_B + 1] = arms.ravel()
        row[c, Column.INV_MASS_A : Column.INV_MASS_B + 1] = masses[:, 0]
        row[c, Column.NORMAL_TURN_A : Column.TANGENT_TURN_B + 1] = turn.ravel()
        if not given_mass:
            total = masses[:, 0].sum() + (arms * turn).sum(axis=1)
            row[c, Column.EN : Column.ET + 1] = np.divide(1.0, total, out=np.zeros(2), where=total > 0)


def push_impulses(
    tid: int, world_offset: int, contact_start: Array, row: Array, row_body: Array, impulse: Array, velocity: Array
) -> None:
    """Add M^-1 J^T impulse to the velocities (Wu 2018, equation 2.26)."""
    for c, r in _rows(tid + world_offset, contact_start, row, row_body):
        r.push(velocity, impulse[c])


def pull_velocities(
    tid: int, world_offset: int, contact_start: Array, row: Array, row_body: Array, velocity: Array, speed: Array
) -> None:
    """Compute J V: normal and tangential speed of each contact."""
    for c, r in _rows(tid + world_offset, contact_start, row, row_body):
        speed[c] = r.speed(velocity)


def step_problem(
    tid: int,
    world_offset: int,
    contact_start: Array,
    row: Array,
    row_body: Array,
    impulse: Array,
    velocity: Array,
    step: Array,
) -> None:
    """Compute what each row alone would change its impulses by, all at the same velocities."""
    for c, r in _rows(tid + world_offset, contact_start, row, row_body):
        free = impulse[c] - r.mass * (r.speed(velocity) + np.array([r.bias, 0.0]))
        n = max(free[0], 0.0)
        step[c] = (n, np.clip(free[1], -r.friction * n, r.friction * n)) - impulse[c]


def sweep_problem(
    tid: int,
    world_offset: int,
    contact_start: Array,
    row: Array,
    row_body: Array,
    impulse: Array,
    velocity: Array,
    change: Array,
    active: Array,
) -> None:
    """Sweep as often as the tape ``active`` is long, normal before tangent, from ``velocity`` as predicted."""
    w = tid + world_offset
    push_impulses(tid, world_offset, contact_start, row, row_body, impulse, velocity)
    rows = list(_rows(w, contact_start, row, row_body))
    for k in range(len(active)):
        for c, r in rows:
            before = impulse[c].copy()
            free_n = impulse[c, 0] - r.mass[0] * (r.speed(velocity)[0] + r.bias)
            impulse[c, 0] = max(free_n, 0.0)
            r.push(velocity, np.array([impulse[c, 0] - before[0], 0.0]))
            limit = r.friction * impulse[c, 0]
            free_t = impulse[c, 1] - r.mass[1] * r.speed(velocity)[1]
            impulse[c, 1] = np.clip(free_t, -limit, limit)
            r.push(velocity, np.array([0.0, impulse[c, 1] - before[1]]))
            change[c] = impulse[c] - before
            active[k, c] = Active.PRESSING * (free_n > 0)
            active[k, c] += Active.UPPER * (free_t > limit) + Active.LOWER * (free_t < -limit)


def pull_problem(
    tid: int,
    world_offset: int,
    leak: float,
    contact_start: Array,
    row: Array,
    row_body: Array,
    active: Array,
    by_change: Array,
    by_velocity: Array,
    by_impulse: Array,
) -> None:
    """The adjoint of ``sweep_problem``, from its derivative in the direction of each impulse in turn.

    ``by_velocity`` holds M^-1 times the velocities' cotangent. Velocities follow the impulses at all times,
    V = predicted + M^-1 J^T x, so their cotangent's part is J of that in the direction of the change of x.
    """
    w = tid + world_offset
    rows = list(_rows(w, contact_start, row, row_body))
    world = slice(contact_start[w], contact_start[w + 1])
    by_end = by_impulse[world].astype(np.float64)
    for c, r in rows:
        by_end[c - world.start] += r.speed(by_velocity)
    result = np.zeros_like(by_end)
    for index in np.ndindex(result.shape):
        x = np.zeros((len(by_impulse), 2))
        x[world.start + index[0], index[1]] = 1.0
        v = np.zeros(by_velocity.shape)
        for c, r in rows:
            r.push(v, x[c])
        step = np.zeros_like(by_end)
        for k in range(len(active)):
            for c, r in rows:
                before, code = x[c].copy(), active[k, c]
                x[c, 0] -= r.mass[0] * r.speed(v)[0]
                if not code & Active.PRESSING:
                    x[c, 0] *= leak
                r.push(v, np.array([x[c, 0] - before[0], 0.0]))
                x[c, 1] -= r.mass[1] * r.speed(v)[1]
                if code & (Active.UPPER | Active.LOWER):
                    x[c, 1] = leak * x[c, 1] + (r.friction if code & Active.UPPER else -r.friction) * x[c, 0]
                r.push(v, np.array([0.0, x[c, 1] - before[1]]))
                step[c - world.start] = x[c] - before
        result[index] = (by_end * x[world]).sum() + (by_change[world] * step).sum()
    by_impulse[world] = result
