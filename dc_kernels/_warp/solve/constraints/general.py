"""The rows of a general joint: the Jacobians that its user gives."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions


@cache
def general_rows(dtype: str) -> Any:
    """The function that makes the rows of a general joint."""
    t = group_types(dtype)
    ends = end_functions(dtype)
    Along, bounded = ends.Along, ends.bounded

    @wp.func(module=kernel_module("joints", dtype))
    def make_general_rows(j: int, e: ends.Ends, joints: t.Joints, rows: t.Rows):
        """J_A V_A + J_B V_B = speed, by a force within bounds."""
        along = Along()
        along.ja = joints.joint_jacobian_a[j]
        along.jb = joints.joint_jacobian_b[j]
        k = joints.joint_row_start[j]
        bounded(k, e, along, joints.joint_speed[j], joints.joint_lower[j], joints.joint_upper[j], rows)

    return make_general_rows
