"""The rows of a gear: the angle of B at a ratio to that of A."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions


@cache
def gear_rows(dtype: str) -> Any:
    """The function that makes the rows of a gear."""
    t = group_types(dtype)
    ends = end_functions(dtype)
    hold, turn = ends.hold, ends.turn

    @wp.func(module=kernel_module("joints", dtype))
    def make_gear_rows(j: int, e: ends.Ends, config: t.Config, joints: t.Joints, rows: t.Rows):
        """The angle of B less ratio times that of A."""
        ratio = joints.joint_ratio[j]
        off = e.angle_b - ratio * e.angle_a - joints.joint_reference[j]
        hold(joints.joint_row_start[j], e, turn(e, ratio, off), config, rows)

    return make_gear_rows
