"""The row of a distance joint along the line between its anchors (Wu 2018, equation 2.20)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import dot, rotate, rotation, tangent
from dc_kernels._numpy.solve.laws import direction
from dc_kernels._numpy.solve.row import PackedRow, effective_mass, velocities
from dc_kernels.model.config import POSITION_CORRECTIONS

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]


def make_distance_row(j: int, w: int, config: Any, model: Any, state: Any, motion: Any, joints: Any) -> PackedRow:
    """The row of joint j of world w."""
    dt = motion.step_dt[w]
    limit = config.max_correction * model.length_scale[w]
    a, b = joints.joint_body_a[j], joints.joint_body_b[j]
    if min(motion.predicted[a, 3], motion.predicted[b, 3]) < 0:  # asleep: it does nothing, and keeps its impulse
        return PackedRow(a, b, np.zeros(2), np.zeros(6), np.zeros(6), 0.0, 0.0, 0.0, 0.0, 0.0, -np.inf, 0.0)
    ra = rotate(rotation(state.angle[a]), joints.joint_anchor_a[j])
    rb = rotate(rotation(state.angle[b]), joints.joint_anchor_b[j])
    d = (state.position[b] + rb) - (state.position[a] + ra)
    length = np.sqrt(dot(d, d))
    n = d / length if length > 0 else np.array([1.0, 0.0], d.dtype)
    jn = direction(n, ra, rb)
    en = effective_mass(jn, a, b, model, motion)
    un = jn @ np.concatenate([motion.predicted[a, :3], motion.predicted[b, :3]])
    # acceleration of the distance as line and arms turn, and what it lengthens the joint by
    wa, wb = state.angular_velocity[a], state.angular_velocity[b]
    ut = direction(tangent(n), ra, rb) @ velocities(state, a, b)
    bend = wa**2 * dot(n, ra) - wb**2 * dot(n, rb) + (ut**2 / length if length > 0 else 0.0)
    grow = min(max(0.5 * dt * dt * bend, -limit), limit)
    off = length - joints.joint_length[j]
    baumgarte = config.position_factor if config.position_correction == BAUMGARTE else 0.0
    bias = (min(max(baumgarte * off, -limit), limit) + grow) / dt
    return PackedRow(
        a, b, n, jn, np.zeros(6), en, 0.0, bias, 0.0, off + grow, -np.inf, (en * (un + bias)) ** 2
    )  # fmt: skip
