"""The rows of a distance joint that is more than a rod: a spring, a rope, or both."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import dot
from dc_kernels._numpy.solve.constraints.ends import QUARTER, Ends, X, cross
from dc_kernels.model.enums import JointPart
from dc_kernels.solve.joints import SMALL_TURN, STIFFNESS


def make_stretch_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    length = np.sqrt(dot(ends.d, ends.d))
    along = ends.point(ends.d / length if length > 0 else X)
    turn = 0.0
    if length > 0:
        turn = ends.dt * cross(ends.d / length, ends.speed) / length
        along.grow += 0.5 * length * turn**2
    if joints.joint_parts[j] & JointPart.HOLD:
        held, frequency = along.less(joints.joint_length[j]), joints.joint_frequency[j]
        if frequency > 0:
            ends.spring(held, frequency, joints.joint_damping_ratio[j])
        else:
            ends.hold(held)
    if joints.joint_parts[j] & JointPart.LIMIT:
        ends.limit(along, joints.joint_lower[j], joints.joint_upper[j])
    if joints.joint_parts[j] & JointPart.ACROSS:
        pull = abs(joints.joint_impulse[ends.row - 1])
        direct = length > 0 and not ends.substeps  # it is for trees that are solved at once
        inertia = STIFFNESS * ends.dt * pull / length if direct else 0.0
        ends.steady(
            ends.point(QUARTER @ (ends.d / length if length > 0 else X)), inertia, min((turn / SMALL_TURN) ** 4, 1)
        )
