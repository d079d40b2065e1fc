"""The rows of a wheel: a point of B on a line of A, held along it by a spring; a motor, limits of the spring."""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import rotate
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart

LIMIT = int(JointPart.LIMIT)
MOTOR = int(JointPart.MOTOR)


@cache
def wheel_rows(dtype: str) -> Any:
    """The function that makes the rows of a wheel."""
    t = group_types(dtype)
    vec2 = t.vec2
    ends = end_functions(dtype)
    hold, spring, motor, limit = ends.hold, ends.spring, ends.motor, ends.limit
    slide, turn = ends.slide, ends.turn
    infinity = float("inf")

    @ti.func
    def make_wheel_rows(
        j, e, config: t.Config, model: t.Model, state: t.State, motion: t.Motion, joints: t.Joints, rows: t.Rows
    ):
        """Across the line, and the spring along it; then the motor, and the range of the spring's way."""
        s = rotate(ti.cos(state.angle[e.a]), ti.sin(state.angle[e.a]), joints.joint_axis[j])
        k = joints.joint_row_start[j]
        hold(k, e, slide(e, vec2(0.0 - s[1], s[0])), config, rows)
        way = slide(e, s)
        frequency = joints.joint_frequency[j]
        if frequency > 0.0:
            spring(k + 1, e, way, frequency, joints.joint_damping_ratio[j], infinity, model, motion, rows)
        else:
            hold(k + 1, e, way, config, rows)
        k += 2
        if (joints.joint_parts[j] & MOTOR) != 0:
            about = turn(e, 1.0, 0.0)
            motor(k, e, about, joints.joint_speed[j] * e.size, joints.joint_strength[j] * e.dt / e.size, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            limit(k, e, way, joints.joint_lower[j], joints.joint_upper[j], config, rows)

    return make_wheel_rows
