"""The rows of a distance joint that is more than a rod: a spring, a rope, or both."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart

HOLD = wp.constant(int(JointPart.HOLD))
LIMIT = wp.constant(int(JointPart.LIMIT))


@cache
def stretch_rows(dtype: str) -> Any:
    """The function that makes the rows of a distance joint."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    hold, limit, point, spring = ends.hold, ends.limit, ends.point, ends.spring
    infinity = real(float("inf"))

    @wp.func(module=kernel_module("joints", dtype))
    def make_stretch_rows(
        j: int, e: ends.Ends, config: t.Config, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows
    ):
        """A rod, or a spring about the length; then the range of the length.

        Along the line between the anchors, which turns within the step; where they meet it has no direction, and is
        taken along x.
        """
        length = wp.length(e.d)
        n = vec2(real(1.0), real(0.0))
        if length > real(0.0):
            n = e.d / length
        along = point(e, n)
        if length > real(0.0):
            across = wp.dot(vec2(-n[1], n[0]), e.speed)
            along.grow += real(0.5) * e.dt * e.dt * across * across / length
        k = joints.joint_row_start[j]
        if (joints.joint_parts[j] & HOLD) != 0:
            along.off = length - joints.joint_length[j]
            frequency = joints.joint_frequency[j]
            if frequency > real(0.0):
                spring(k, e, along, frequency, joints.joint_damping_ratio[j], infinity, model, motion, rows)
            else:
                hold(k, e, along, config, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            along.off = length
            limit(k, e, along, joints.joint_lower[j], joints.joint_upper[j], config, rows)

    return make_stretch_rows
