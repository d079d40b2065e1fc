"""One row as small dense vectors (seed, 2.2.2): what a sweep, an impulse or a position push does to its two bodies.

Velocities are V = (v_A, w_A, v_B, w_B), (6,).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, tangent
from dc_kernels.solve.rows import COLUMNS, LANES


@dataclass
class Row:
    """A contact (normal and tangent) or a joint as the solver sees it."""

    at: tuple[int, slice, int]  # where its two impulses lie in an array of shape (blocks, 2, LANES)
    a: int
    b: int
    jacobian: Array  # (2, 6): normal, tangent
    response: Array  # (2, 6): M^-1 J^T of each, what a unit impulse changes the velocities by
    effective_mass: Array  # (2,) [kg]
    bias: Any  # [m/s]
    friction: Any
    gap: Any  # [m]
    low: Any  # least normal impulse [N s]
    is_joint: bool

    def velocity(self, bodies: Array) -> Array:
        """V of both bodies, (6,)."""
        return np.concatenate([bodies[self.a, :3], bodies[self.b, :3]])

    def change(self, bodies: Array, impulses: Array) -> None:
        """V += M^-1 J^T impulses (2.26)."""
        v = impulses @ self.response
        bodies[self.a, :3] += v[:3]
        bodies[self.b, :3] += v[3:]


def by_lane(array: Array, columns: int = 2) -> Array:
    """A view of shape (blocks, columns, LANES)."""
    return array.reshape(-1, columns, LANES)


def read_row(variant: str, block: int, lane: int, rows: Array, row_body: Array, bodies: Array) -> Row | None:
    """One row of the packed arrays; None for an empty lane.

    Args:
        variant: a key of ``rows.COLUMNS``.
        block: block of rows.
        lane: lane in the block.
        rows: packed columns.
        row_body: packed bodies.
        bodies: anything whose fourth component is the inverse mass.
    """
    a, b = (int(i) for i in by_lane(row_body)[block, :, lane])
    if a == b:
        return None
    columns = COLUMNS[variant]
    value = dict(zip(columns, by_lane(rows, len(columns))[block, :, lane]))
    n = np.array([value["nx"], value["ny"]])
    t = tangent(n)
    if variant == "discs":
        j_normal = [*-n, 0.0, *n, 0.0]
        j_tangent = [*-t, value["dA"], *t, value["dB"]]
        turn_normal = (0.0, 0.0)
        turn_tangent = (value["kA"], value["kB"])
    else:
        j_normal = [*-n, -value["rAn"], *n, value["rBn"]]
        j_tangent = [*-t, -value["rAt"], *t, value["rBt"]]
        turn_normal = (-value["iA"] * value["rAn"], value["iB"] * value["rBn"])
        turn_tangent = (-value["iA"] * value["rAt"], value["iB"] * value["rBt"])
    ma, mb = bodies[a, 3], bodies[b, 3]
    low = value.get("lo", rows.dtype.type(0))
    return Row(
        at=(block, slice(None), lane),
        a=a,
        b=b,
        jacobian=np.array([j_normal, j_tangent], rows.dtype),
        response=np.array(
            [
                [*-ma * n, turn_normal[0], *mb * n, turn_normal[1]],
                [*-ma * t, turn_tangent[0], *mb * t, turn_tangent[1]],
            ],
            rows.dtype,
        ),
        effective_mass=np.array([value["en"], value["et"]]),
        bias=value["bias"],
        friction=value["mu"],
        gap=value["gap"],
        low=low,
        is_joint=bool(low < 0),
    )


def sweep_row(row: Row, bodies: Array, row_impulse: Array, row_change: Array, omega: float) -> Any:
    """Projected Gauss-Seidel on one row, normal before friction; the larger impulse change [N s]."""
    impulse = by_lane(row_impulse)[row.at]
    before = impulse.copy()
    change = np.zeros_like(before)
    speed = row.jacobian[0] @ row.velocity(bodies)
    impulse[0] = max(before[0] - omega * row.effective_mass[0] * (speed + row.bias), row.low)
    change[0] = impulse[0] - before[0]
    speed = row.jacobian[1] @ (row.velocity(bodies) + row.response[0] * change[0])
    limit = row.friction * impulse[0]
    impulse[1] = min(max(before[1] - omega * row.effective_mass[1] * speed, -limit), limit)
    change[1] = impulse[1] - before[1]
    row.change(bodies, change)
    by_lane(row_change)[row.at] = change
    return abs(change).max()


def jacobi_row(
    row: Row, bodies: Array, body_rows: Array, row_impulse: Array, row_change: Array, summed: Array, omega: float
) -> Any:
    """Jacobi with mass splitting (Tonge et al. 2012): a row meets 1/n of a body that n rows act on.

    Velocities are read from ``bodies`` and the changes added to ``summed``: the average over a body's shares.
    """
    impulse = by_lane(row_impulse)[row.at]
    before = impulse.copy()
    shares = np.repeat(body_rows[[row.a, row.b]], 3).astype(bodies.dtype)
    k = row.jacobian @ (shares * row.response).T  # J M_split^-1 J^T, (2, 2)
    speed = row.jacobian @ row.velocity(bodies)
    if k[0, 0] > 0:
        impulse[0] = max(before[0] - omega * (speed[0] + row.bias) / k[0, 0], row.low)
    limit = row.friction * impulse[0]
    if k[1, 1] > 0:
        mixed = k[1, 0] * (impulse[0] - before[0])
        impulse[1] = min(max(before[1] - omega * (speed[1] + mixed) / k[1, 1], -limit), limit)
    change = impulse - before
    row.change(summed, change)
    by_lane(row_change)[row.at] = change
    return abs(change).max()


def push_row(row: Row, bodies: Array, factor: float, limit: Any) -> Any:
    """Position correction of one row: displacements that remove a share of what overlaps after the step."""
    step = max(factor * (row.jacobian[0] @ row.velocity(bodies) + row.gap), -limit)
    if row.is_joint:
        step = min(step, limit)
    push = max(-row.effective_mass[0] * step, row.low)
    row.change(bodies, np.array([push, 0.0], bodies.dtype))
    return abs(push)


def project_cone(normal: Any, along: Any, friction: Any) -> tuple[Any, Any]:
    """The nearest point with |along| <= friction * normal."""
    if normal >= 0 and abs(along) <= friction * normal:
        return normal, along
    if friction * abs(along) <= -normal:
        return 0.0, 0.0
    nearest = (normal + friction * abs(along)) / (1.0 + friction * friction)
    return nearest, np.sign(along) * friction * nearest


def natural_map_row(row: Row, bodies: Array, row_impulse: Array) -> Any:
    """Squared natural map of one row [(N s)^2]: impulse minus its projected step on the friction cone."""
    impulse = by_lane(row_impulse)[row.at]
    un, ut = row.jacobian @ row.velocity(bodies)
    un += row.bias
    e = row.effective_mass[0]
    if row.is_joint:
        return (e * un) ** 2
    zn, zt = project_cone(impulse[0] - e * (un + row.friction * abs(ut)), impulse[1] - e * ut, row.friction)
    return (impulse[0] - zn) ** 2 + (impulse[1] - zt) ** 2
