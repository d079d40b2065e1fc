"""What the rows of all kinds of joints are made of: where the anchors are, and the row of each part of a joint.

Rows of angles count in arms of the world's ``length_scale``: impulses of all rows are in N s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, dot, rotate, rotation
from dc_kernels._numpy.solve.row import effective_mass
from dc_kernels.model.config import METHODS, POSITION_CORRECTIONS
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.joints import NEAR_LIMIT, SMALL_TURN

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
SUBSTEPS = METHODS["tgs_soft"]
X, Y = np.array([1.0, 0.0]), np.array([0.0, 1.0])
QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])


def cross(a: Array, b: Array) -> Any:
    """A x b, the third component."""
    return a[0] * b[1] - a[1] * b[0]


@dataclass
class Along:
    """Jacobians (J_A, J_B), what they are of at the beginning of the step, and what turning adds to it."""

    jacobian: Array  # (6,)
    off: Any
    grow: Any = 0.0

    def less(self, length: Any) -> Along:
        """Counted from another zero."""
        return replace(self, off=self.off - length)


def body_of(body: int, launch: Any, state: Any, motion: Any) -> tuple[Array, Any, Array, Any]:
    """Place, angle, velocity and spin of a body: those of the state, or of the substeps that have been made since."""
    if launch.resume:
        moved, v = motion.displacement[body], motion.solved[body]
        return state.position[body] + moved[:2], state.angle[body] + moved[2], v[:2], v[2]
    return state.position[body], state.angle[body], state.velocity[body], state.angular_velocity[body]


class Ends:
    """The ends of joint j of world w, and the rows of its parts."""

    def __init__(
        self, j: int, w: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, joints: Any, rows: Any
    ) -> None:
        self.model, self.motion, self.rows, self.config = model, motion, rows, config
        a, b = self.a, self.b = joints.joint_body_a[j], joints.joint_body_b[j]
        (place_a, self.angle_a, velocity_a, self.wa), (place_b, self.angle_b, velocity_b, self.wb) = (
            body_of(body, launch, state, motion) for body in (a, b)
        )
        self.row = int(joints.joint_row_start[j])
        self.ra = rotate(rotation(self.angle_a), joints.joint_anchor_a[j])
        self.rb = rotate(rotation(self.angle_b), joints.joint_anchor_b[j])
        self.d = (place_b + self.rb) - (place_a + self.ra)
        of_a, of_b = self.wa * QUARTER @ self.ra, self.wb * QUARTER @ self.rb
        self.speed = (velocity_b + of_b) - (velocity_a + of_a)
        self.step, self.size = motion.step_dt[w], model.length_scale[w]
        self.substeps = config.method == SUBSTEPS  # which follow what the rows are off by
        self.share = 1 / self.step.dtype.type(config.substeps if self.substeps else 1)  # of the step
        self.dt = self.step * self.share  # in which an impulse acts
        self.most = config.max_correction * self.size
        self.axis = rotate(rotation(self.angle_a), joints.joint_axis[j])

    def point(self, n: Array) -> Along:
        """Along a direction of the world."""
        bend = self.wa**2 * dot(n, self.ra) - self.wb**2 * dot(n, self.rb)
        jacobian = np.array([*-n, -cross(self.ra, n), *n, cross(self.rb, n)])
        return Along(jacobian, dot(n, self.d), 0.5 * self.dt**2 * bend)

    def slide(self, n: Array) -> Along:
        """Along a direction that turns with body A."""
        bend = self.wa**2 * dot(n, self.ra - self.d) - self.wb**2 * dot(n, self.rb)
        bend += 2 * self.wa * cross(n, self.speed)
        jacobian = np.array([*-n, -cross(self.d + self.ra, n), *n, cross(self.rb, n)])
        return Along(jacobian, dot(n, self.d), 0.5 * self.dt**2 * bend)

    def turn(self, zero: Any, ratio: Any = 1.0) -> Along:
        """Of the angle of B less ``ratio`` times that of A, counted from ``zero``."""
        off = self.angle_b - ratio * self.angle_a - zero
        return Along(np.array([0.0, 0.0, -ratio * self.size, 0.0, 0.0, self.size]), off * self.size)

    def write(
        self,
        along: Along,
        bias: Any,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        soft: Any = 0.0,
        gap: Any = 0.0,
        held: float = 0,
    ) -> None:
        """The next row of the joint."""
        k, rows = self.row, self.rows
        self.row += 1
        rows.row_body_a[k], rows.row_body_b[k] = self.a, self.b
        rows.row_jacobian_a[k], rows.row_jacobian_b[k] = along.jacobian[:3], along.jacobian[3:]
        rows.row_bias[k], rows.row_lower[k], rows.row_upper[k] = bias, lower, upper
        rows.row_softness[k], rows.row_gap[k], rows.row_held[k] = soft, gap, held

    def idle(self) -> None:
        """A row that does nothing."""
        self.write(Along(np.zeros(6), 0.0), 0.0)

    def rest(self) -> None:
        """A row that does nothing and keeps its impulse, of bodies that sleep."""
        self.write(Along(np.zeros(6), 0.0), 0.0, held=-1.0)

    def hold(self, along: Along) -> None:
        """What must stay 0, at the end of the step; of bodies that turn far in a step, where it is now."""
        turn = max(abs(self.wa), abs(self.wb)) * self.dt
        grow = along.grow * max(1 - (turn / SMALL_TURN) ** 2, 0.0)
        grow = min(max(grow, -self.most), self.most)
        factor = self.config.position_factor if self.config.position_correction == BAUMGARTE else 0.0
        pull = min(max(factor * along.off, -self.most), self.most)
        self.write(along, (pull + grow) / self.dt, gap=along.off + grow, held=1)

    def spring(self, along: Along, frequency: Any, ratio: Any, most: Any = np.inf) -> None:
        """What a damped spring of limited impulse draws to 0, by implicit Euler (Catto 2011).

        With the effective mass m, stiffness k = m w^2 and damping c = 2 m w ratio, where w = 2 pi frequency. Where
        substeps follow what it is off by, its bias is kept for each of that.
        """
        w = 2 * np.pi * frequency
        m = effective_mass(along.jacobian, self.a, self.b, self.model, self.motion)
        if not (w > 0 and m > 0):
            self.idle()
            return
        k, c, dt = m * w**2, 2 * m * w * ratio, self.dt
        soft = 1 / (dt * (c + dt * k))
        if self.substeps:
            self.write(along, dt * k * soft, -most, most, soft, gap=along.off)
        else:
            self.write(along, along.off * dt * k * soft, -most, most, soft)

    def steady(self, along: Along, inertia: Any, brake: Any) -> None:
        """Inertia against a change of speed, beyond that of the bodies themselves, and a share of the speed to lose."""
        m = effective_mass(along.jacobian, self.a, self.b, self.model, self.motion)
        if not inertia > m > 0:
            self.idle()
            return
        speed = along.jacobian @ np.concatenate([self.motion.predicted[body, :3] for body in (self.a, self.b)])
        self.write(along, (brake - 1) * speed, soft=1 / (inertia - m))

    def motor(self, along: Along, speed: Any, most: Any) -> None:
        """A speed, by impulses up to ``most``."""
        self.write(along, -speed, -most, most)

    def bounded(self, along: Along, speed: Any, lower: Any, upper: Any) -> None:
        """A speed, by forces between bounds, of which UNBOUNDED is none."""
        low = lower * self.dt if lower > -UNBOUNDED else -np.inf
        self.write(along, -speed, low, upper * self.dt if upper < UNBOUNDED else np.inf)

    def limit(self, along: Along, lower: Any, upper: Any) -> None:
        """A range, of which the nearer end counts; what is within it may move up to it in the step.

        Far from both ends the row can carry nothing, so that it is not packed.
        """
        room, sign = min((along.off - lower, 1), (upper - along.off, -1), key=lambda end: end[0])
        if upper - lower <= self.config.slop * self.size:  # both ends are one
            self.write(along, 0.0, gap=sign * room, held=1)
            return
        bias = max(room, 0.0) / self.dt
        if self.config.position_correction == BAUMGARTE and room < 0:
            bias = max(self.config.position_factor * room, -self.most) / self.dt
        low, high = (0.0, np.inf) if sign > 0 else (-np.inf, 0.0)
        way = self.step * (np.abs(self.speed).sum() + self.size * (abs(self.wa) + abs(self.wb)))
        if room > NEAR_LIMIT * self.size + 2 * way:
            low, high = 0.0, 0.0
        self.write(along, sign * bias, low, high, gap=sign * room, held=1)
