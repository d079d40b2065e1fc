"""The rows of a wheel: a point of B on a line of A, held along it by a spring; a motor, limits of the spring."""

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
def wheel_rows(dtype: str) -> Any:
    """The function that makes the rows of a wheel."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    hold, spring, motor, limit = ends.hold, ends.spring, ends.motor, ends.limit
    slide, turn = ends.slide, ends.turn
    infinity = real(float("inf"))

    @wp.func(module=kernel_module("joints", dtype))
    def make_wheel_rows(
        j: int,
        e: ends.Ends,
        config: t.Config,
        model: t.Model,
        motion: t.Motion,
        joints: t.Joints,
        rows: t.Rows,
    ):
        """Across the line, and the spring along it; then the motor, and the range of the spring's way."""
        s = rotate(wp.cos(e.angle_a), wp.sin(e.angle_a), joints.joint_axis[j])
        k = joints.joint_row_start[j]
        hold(k, e, slide(e, vec2(-s[1], s[0])), config, rows)
        way = slide(e, s)
        frequency = joints.joint_frequency[j]
        if frequency > real(0.0):
            spring(k + 1, e, way, frequency, joints.joint_damping_ratio[j], infinity, model, motion, rows)
        else:
            hold(k + 1, e, way, config, rows)
        k += 2
        if (joints.joint_parts[j] & MOTOR) != 0:
            about = turn(e, real(1.0), real(0.0))
            motor(k, e, about, joints.joint_speed[j] * e.size, joints.joint_strength[j] * e.dt / e.size, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            limit(k, e, way, joints.joint_lower[j], joints.joint_upper[j], config, rows)

    return make_wheel_rows
