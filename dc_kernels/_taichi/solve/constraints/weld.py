"""The rows of a weld: two points together, and the angle between the bodies, or a spring that turns it back."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions


@cache
def weld_rows(dtype: str) -> Any:
    """The function that makes the rows of a weld."""
    t = group_types(dtype)
    vec2 = t.vec2
    ends = end_functions(dtype)
    hold, point, spring, turn = ends.hold, ends.point, ends.spring, ends.turn
    infinity = float("inf")

    @ti.func
    def make_weld_rows(j, e, config: t.Config, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows):
        """Two points together along x and y; then the angle."""
        k = joints.joint_row_start[j]
        hold(k, e, point(e, vec2(1.0, 0.0)), config, rows)
        hold(k + 1, e, point(e, vec2(0.0, 1.0)), config, rows)
        about = turn(e, 1.0, e.angle - joints.joint_reference[j])
        frequency = joints.joint_frequency[j]
        if frequency > 0.0:
            spring(k + 2, e, about, frequency, joints.joint_damping_ratio[j], infinity, model, motion, rows)
        else:
            hold(k + 2, e, about, config, rows)

    return make_weld_rows
