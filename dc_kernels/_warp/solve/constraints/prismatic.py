"""The rows of a slider: body B on a line of body A, without turning; a motor and limits of its way."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart

LIMIT = wp.constant(int(JointPart.LIMIT))
MOTOR = wp.constant(int(JointPart.MOTOR))


@cache
def prismatic_rows(dtype: str) -> Any:
    """The function that makes the rows of a slider."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    hold, limit, motor, slide, turn = ends.hold, ends.limit, ends.motor, ends.slide, ends.turn

    @wp.func(module=kernel_module("joints", dtype))
    def make_prismatic_rows(j: int, e: ends.Ends, config: t.Config, joints: t.Joints, rows: t.Rows):
        """Across the line and in angle; then the motor, and the range of the way along it."""
        s = rotate(wp.cos(e.angle_a), wp.sin(e.angle_a), joints.joint_axis[j])
        k = joints.joint_row_start[j]
        hold(k, e, slide(e, vec2(-s[1], s[0])), config, rows)
        hold(k + 1, e, turn(e, real(1.0), e.angle - joints.joint_reference[j]), config, rows)
        k += 2
        way = slide(e, s)
        if (joints.joint_parts[j] & MOTOR) != 0:
            motor(k, e, way, joints.joint_speed[j], joints.joint_strength[j] * e.dt, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            limit(k, e, way, joints.joint_lower[j], joints.joint_upper[j], config, rows)

    return make_prismatic_rows
