"""The rows of a target: a point of B drawn to one of A by a spring of limited force."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions


@cache
def target_rows(dtype: str) -> Any:
    """The function that makes the rows of a target."""
    t = group_types(dtype)
    vec2 = t.vec2
    ends = end_functions(dtype)
    point, spring = ends.point, ends.spring

    @ti.func
    def make_target_rows(j, e, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows):
        """The springs along x and y."""
        k = joints.joint_row_start[j]
        frequency = joints.joint_frequency[j]
        ratio = joints.joint_damping_ratio[j]
        most = joints.joint_strength[j] * e.dt
        spring(k, e, point(e, vec2(1.0, 0.0)), frequency, ratio, most, model, motion, rows)
        spring(k + 1, e, point(e, vec2(0.0, 1.0)), frequency, ratio, most, model, motion, rows)

    return make_target_rows
