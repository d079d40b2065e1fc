"""The rows of a gear: the angle of B at a ratio to that of A."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions


@cache
def gear_rows(dtype: str) -> Any:
    """The function that makes the rows of a gear."""
    t = group_types(dtype)
    ends = end_functions(dtype)
    hold, turn = ends.hold, ends.turn

    @ti.func
    def make_gear_rows(j, e, config: t.Config, state: t.State, joints: t.Joints, rows: t.Rows):
        """The angle of B less ratio times that of A."""
        ratio = joints.joint_ratio[j]
        off = state.angle[e.b] - ratio * state.angle[e.a] - joints.joint_reference[j]
        hold(joints.joint_row_start[j], e, turn(e, ratio, off), config, rows)

    return make_gear_rows
