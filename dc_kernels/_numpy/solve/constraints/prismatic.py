"""The rows of a slider: body B on a line of body A, without turning; a motor and limits of its way."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.common import tangent
from dc_kernels._numpy.solve.constraints.ends import Ends
from dc_kernels.model.enums import JointPart


def make_prismatic_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    ends.hold(ends.slide(-tangent(ends.axis)))
    ends.hold(ends.turn(joints.joint_reference[j]))
    way = ends.slide(ends.axis)
    if joints.joint_parts[j] & JointPart.MOTOR:
        ends.motor(way, joints.joint_speed[j], joints.joint_strength[j] * ends.dt)
    if joints.joint_parts[j] & JointPart.LIMIT:
        ends.limit(way, joints.joint_lower[j], joints.joint_upper[j])
