"""One row as small dense vectors (Wu 2018, section 2.2.2): what a sweep, impulse or position push does to its bodies.

Velocities are V = (v_A, w_A, v_B, w_B), (6,).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, tangent
from dc_kernels._numpy.solve.laws import natural_map_squared
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
    high: Any  # largest normal impulse [N s]
    softness: Any  # [1/kg]
    slip: Any  # [m/s], of the surface of B against that of A
    roll: Any  # share of a contact's normal impulse that bounds it, > 0 for rolling resistance
    held: Any  # 1 where position correction moves it, else 0

    @property
    def is_box(self) -> bool:
        """Whether it is no contact: its impulse lies between bounds, without friction."""
        return bool(self.low != 0 or np.isfinite(self.high))

    def within(self, impulse: Any) -> Any:
        """A normal impulse within its bounds."""
        return min(max(impulse, self.low), self.high)

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


def read_row(variant: str, block: int, lane: int, rows: Any, bodies: Array) -> Row | None:
    """One row of the packed arrays; None for an empty lane.

    Args:
        variant: a key of ``rows.COLUMNS``.
        block: block of rows.
        lane: lane in the block.
        rows: the group of rows.
        bodies: anything whose fourth component is the inverse mass.
    """
    a, b = (int(i) for i in by_lane(rows.body)[block, :, lane])
    if a == b:
        return None
    columns = COLUMNS[variant]
    value = dict(zip(columns, by_lane(rows.column, len(columns))[block, :, lane]))
    n = np.array([value["nx"], value["ny"]])
    t = tangent(n)
    at_a = np.array([value.get("ax", n[0]), value.get("ay", n[1])])
    if variant == "discs":
        j_normal = [*-n, 0.0, *n, 0.0]
        j_tangent = [*-t, value["dA"], *t, value["dB"]]
        turn_normal = (0.0, 0.0)
        turn_tangent = (value["kA"], value["kB"])
    else:
        j_normal = [*-at_a, -value["rAn"], *n, value["rBn"]]
        j_tangent = [*-t, -value["rAt"], *t, value["rBt"]]
        turn_normal = (-value["iA"] * value["rAn"], value["iB"] * value["rBn"])
        turn_tangent = (-value["iA"] * value["rAt"], value["iB"] * value["rBt"])
    ma, mb = bodies[a, 3], bodies[b, 3]
    low, softness, slip, roll = (value.get(name, rows.column.dtype.type(0)) for name in ("lo", "soft", "slip", "roll"))
    return Row(
        at=(block, slice(None), lane),
        a=a,
        b=b,
        jacobian=np.array([j_normal, j_tangent], rows.column.dtype),
        response=np.array(
            [
                [*-ma * at_a, turn_normal[0], *mb * n, turn_normal[1]],
                [*-ma * t, turn_tangent[0], *mb * t, turn_tangent[1]],
            ],
            rows.column.dtype,
        ),
        effective_mass=np.array([value["en"], value["et"]]),
        bias=value["bias"],
        friction=value["mu"],
        gap=value["gap"],
        low=low,
        high=value.get("hi", rows.column.dtype.type(np.inf)),
        softness=softness,
        slip=slip,
        roll=roll,
        held=value.get("held", rows.column.dtype.type(1)),
    )


class PackedRow(NamedTuple):
    """One row before it is packed: a contact with its friction, or a joint."""

    a: int
    b: int
    normal: Array
    jn: Array  # J along the normal, (6,)
    jt: Array  # J along the tangent, (6,)
    normal_mass: Any  # [kg]
    tangent_mass: Any  # [kg]
    bias: Any  # [m/s]
    friction: Any
    gap: Any  # [m]
    least: Any  # least normal impulse [N s]
    square: Any  # squared impulse that would stop the row alone [(N s)^2]
    most: Any = np.inf  # largest normal impulse [N s]
    softness: Any = 0.0  # velocity for each normal impulse [1/kg]
    slip: Any = 0.0  # tangential speed of the surface of B against that of A [m/s]
    roll: Any = 0.0  # share of a contact's normal impulse that bounds it
    held: Any = 1.0  # 1 where position correction moves it, else 0
    inverse: Any = None  # inverse inertias of A and B, where they are not those of the model [1/(kg m^2)]

    def columns(self, variant: str, model: Any) -> list[Any]:
        """Values of the variant's columns."""
        jn, jt = self.jn, self.jt
        ia, ib = model.inv_inertia[[self.a, self.b]] if self.inverse is None else self.inverse
        values = {"nx": self.normal[0], "ny": self.normal[1]}
        values |= {"rAn": -jn[2], "rBn": jn[5], "rAt": -jt[2], "rBt": jt[5], "iA": ia, "iB": ib}
        values |= {"dA": jt[2], "dB": jt[5], "kA": ia * jt[2], "kB": ib * jt[5]}
        values |= {"en": self.normal_mass, "et": self.tangent_mass, "bias": self.bias}
        values |= {"mu": self.friction, "gap": self.gap, "lo": self.least}
        values |= {"hi": self.most, "ax": -jn[0], "ay": -jn[1], "soft": self.softness, "held": self.held}
        values |= {"slip": self.slip, "roll": self.roll}
        return [values[name] for name in COLUMNS[variant]]


def effective_mass(j: Array, a: int, b: int, model: Any, motion: Any, inverse: Any = None) -> Any:
    """1 / (J M^-1 J^T), 0 if nothing can move (Wu 2018, equation 2.25); with other ``inverse`` inertias if given."""
    ma, mb = motion.predicted[a, 3], motion.predicted[b, 3]
    ia, ib = model.inv_inertia[[a, b]] if inverse is None else inverse
    k = (j * j) @ np.array([ma, ma, ia, mb, mb, ib])
    return 1.0 / k if k > 0 else k


def inverse_inertias(a: int, b: int, model: Any, rows: Any) -> Array:
    """Inverse inertias of A and B, less where joints stiffen them (``solve.joints``) [1/(kg m^2)]."""
    inverse = model.inv_inertia[[a, b]]
    return inverse / (1 + inverse * rows.stiff_inertia[[a, b]]) if len(rows.stiff_inertia) else inverse


def velocities(state: Any, a: int, b: int) -> Array:
    """V of both bodies before the step's forces, (6,)."""
    va, vb = state.velocity[a], state.velocity[b]
    return np.array([*va, state.angular_velocity[a], *vb, state.angular_velocity[b]])


def sweep_row(row: Row, rows: Any, bodies: Array, omega: float) -> Any:
    """Projected Gauss-Seidel on one row, normal before friction; the larger impulse change [N s]."""
    impulse = by_lane(rows.impulse)[row.at]
    before = impulse.copy()
    change = np.zeros_like(before)
    speed = row.jacobian[0] @ row.velocity(bodies)
    speed = speed + row.bias + row.softness * before[0]
    impulse[0] = row.within(before[0] - omega * row.effective_mass[0] * speed)
    change[0] = impulse[0] - before[0]
    speed = row.jacobian[1] @ (row.velocity(bodies) + row.response[0] * change[0])
    speed = speed + row.slip
    limit = row.friction * impulse[0]
    impulse[1] = min(max(before[1] - omega * row.effective_mass[1] * speed, -limit), limit)
    change[1] = impulse[1] - before[1]
    row.change(bodies, change)
    by_lane(rows.change)[row.at] = change
    return abs(change).max()


def jacobi_row(row: Row, rows: Any, motion: Any, omega: float) -> Any:
    """Jacobi with mass splitting (Tonge et al. 2012): a row meets 1/n of a body that n rows act on.

    Velocities are read from ``motion.solved`` and the changes added to ``motion.summed``: the average over a body's
    shares.
    """
    bodies = motion.solved
    impulse = by_lane(rows.impulse)[row.at]
    before = impulse.copy()
    shares = np.repeat(rows.body_rows[[row.a, row.b]], 3).astype(bodies.dtype)
    k = row.jacobian @ (shares * row.response).T  # J M_split^-1 J^T, (2, 2)
    speed = row.jacobian @ row.velocity(bodies)
    k[0, 0] += row.softness
    if k[0, 0] > 0:
        impulse[0] = row.within(before[0] - omega * (speed[0] + row.bias + row.softness * before[0]) / k[0, 0])
    limit = row.friction * impulse[0]
    if k[1, 1] > 0:
        mixed = k[1, 0] * (impulse[0] - before[0])
        impulse[1] = min(max(before[1] - omega * (speed[1] + row.slip + mixed) / k[1, 1], -limit), limit)
    change = impulse - before
    row.change(motion.summed, change)
    by_lane(rows.change)[row.at] = change
    return abs(change).max()


def push_row(row: Row, bodies: Array, factor: float, limit: Any) -> Any:
    """Position correction of one row: displacements that remove a share of what overlaps after the step."""
    step = max(factor * (row.jacobian[0] @ row.velocity(bodies) + row.gap), -limit)
    if row.low < 0:
        step = min(step, limit)
    if row.roll > 0:
        step = 0.0  # what rolls is where it should be
    push = row.held * row.within(-row.effective_mass[0] * step)
    row.change(bodies, np.array([push, 0.0], bodies.dtype))
    return abs(push)


def natural_map_row(row: Row, rows: Any, bodies: Array) -> Any:
    """Squared natural map of one row [(N s)^2]: impulse minus its projected step on the friction cone."""
    impulse = by_lane(rows.impulse)[row.at]
    un, ut = row.jacobian @ row.velocity(bodies)
    un += row.bias + row.softness * impulse[0]
    ut += row.slip
    e = row.effective_mass[0]
    if row.is_box:
        return (impulse[0] - row.within(impulse[0] - e * un)) ** 2
    step = (impulse[0] - e * (un + row.friction * abs(ut)), impulse[1] - e * ut)
    return natural_map_squared(impulse, step, row.friction)
