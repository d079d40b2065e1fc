"""The rows of a target: a point of B drawn to one of A by a spring of limited force."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions


@cache
def target_rows(dtype: str) -> Any:
    """The function that makes the rows of a target."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    point, spring = ends.point, ends.spring

    @wp.func(module=kernel_module("joints", dtype))
    def make_target_rows(j: int, e: ends.Ends, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows):
        """The springs along x and y."""
        k = joints.joint_row_start[j]
        frequency = joints.joint_frequency[j]
        ratio = joints.joint_damping_ratio[j]
        most = joints.joint_strength[j] * e.dt
        spring(k, e, point(e, vec2(real(1.0), real(0.0))), frequency, ratio, most, model, motion, rows)
        spring(k + 1, e, point(e, vec2(real(0.0), real(1.0))), frequency, ratio, most, model, motion, rows)

    return make_target_rows
