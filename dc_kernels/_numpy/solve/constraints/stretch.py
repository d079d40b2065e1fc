"""The rows of a distance joint that is more than a rod: a spring, a rope, or both."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import dot
from dc_kernels._numpy.solve.constraints.ends import Ends, X, cross
from dc_kernels.model.enums import JointPart


def make_stretch_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    length = np.sqrt(dot(ends.d, ends.d))
    along = ends.point(ends.d / length if length > 0 else X)
    if length > 0:
        along.grow += 0.5 * ends.dt**2 * cross(ends.d / length, ends.speed) ** 2 / length
    if joints.joint_parts[j] & JointPart.HOLD:
        held, frequency = along.less(joints.joint_length[j]), joints.joint_frequency[j]
        if frequency > 0:
            ends.spring(held, frequency, joints.joint_damping_ratio[j])
        else:
            ends.hold(held)
    if joints.joint_parts[j] & JointPart.LIMIT:
        ends.limit(along, joints.joint_lower[j], joints.joint_upper[j])
