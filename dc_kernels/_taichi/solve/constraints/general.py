"""The rows of a general joint: the Jacobians that its user gives."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions


@cache
def general_rows(dtype: str) -> Any:
    """The function that makes the rows of a general joint."""
    t = group_types(dtype)
    vec3 = t.vec3
    ends = end_functions(dtype)
    Along, bounded = ends.Along, ends.bounded

    @ti.func
    def make_general_rows(j, e, joints: t.Joints, rows: t.Rows):
        """J_A V_A + J_B V_B = speed, by a force within bounds."""
        along = Along()
        along.ja = vec3(joints.joint_jacobian_a[j, 0], joints.joint_jacobian_a[j, 1], joints.joint_jacobian_a[j, 2])
        along.jb = vec3(joints.joint_jacobian_b[j, 0], joints.joint_jacobian_b[j, 1], joints.joint_jacobian_b[j, 2])
        k = joints.joint_row_start[j]
        bounded(k, e, along, joints.joint_speed[j], joints.joint_lower[j], joints.joint_upper[j], rows)

    return make_general_rows
