"""The rows of a wheel: a point of B on a line of A, held along it by a spring; a motor, limits of the spring."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.common import tangent
from dc_kernels._numpy.solve.constraints.ends import Ends
from dc_kernels.model.enums import JointPart


def make_wheel_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    ends.hold(ends.slide(-tangent(ends.axis)))
    way, frequency = ends.slide(ends.axis), joints.joint_frequency[j]
    if frequency > 0:
        ends.spring(way, frequency, joints.joint_damping_ratio[j])
    else:
        ends.hold(way)
    if joints.joint_parts[j] & JointPart.MOTOR:
        about = ends.turn(0.0)
        ends.motor(about, joints.joint_speed[j] * ends.size, joints.joint_strength[j] * ends.dt / ends.size)
    if joints.joint_parts[j] & JointPart.LIMIT:
        ends.limit(way, joints.joint_lower[j], joints.joint_upper[j])
