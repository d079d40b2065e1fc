"""The rows of a hinge: two points together; a motor and limits of the angle."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart

LIMIT = int(JointPart.LIMIT)
MOTOR = int(JointPart.MOTOR)


@cache
def revolute_rows(dtype: str) -> Any:
    """The function that makes the rows of a hinge."""
    t = group_types(dtype)
    vec2 = t.vec2
    ends = end_functions(dtype)
    hold, limit, motor, point, turn = ends.hold, ends.limit, ends.motor, ends.point, ends.turn

    @ti.func
    def make_revolute_rows(j, e, config: t.Config, joints: t.Joints, rows: t.Rows):
        """Two points together along x and y; then the motor, and the range of the angle."""
        k = joints.joint_row_start[j]
        hold(k, e, point(e, vec2(1.0, 0.0)), config, rows)
        hold(k + 1, e, point(e, vec2(0.0, 1.0)), config, rows)
        k += 2
        about = turn(e, 1.0, e.angle - joints.joint_reference[j])
        if (joints.joint_parts[j] & MOTOR) != 0:
            motor(k, e, about, joints.joint_speed[j] * e.size, joints.joint_strength[j] * e.dt / e.size, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            limit(k, e, about, joints.joint_lower[j] * e.size, joints.joint_upper[j] * e.size, config, rows)

    return make_revolute_rows
