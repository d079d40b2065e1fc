"""The rows of a hinge: two points together; a motor and limits of the angle."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.solve.constraints.ends import Ends, X, Y
from dc_kernels.model.enums import JointPart


def make_revolute_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    for n in (X, Y):
        ends.hold(ends.point(n))
    about = ends.turn(joints.joint_reference[j])
    if joints.joint_parts[j] & JointPart.MOTOR:
        ends.motor(about, joints.joint_speed[j] * ends.size, joints.joint_strength[j] * ends.dt / ends.size)
    if joints.joint_parts[j] & JointPart.LIMIT:
        ends.limit(about, joints.joint_lower[j] * ends.size, joints.joint_upper[j] * ends.size)
