"""The rows of a distance joint that is more than a rod: a spring, a rope, or both."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart
from dc_kernels.solve.joints import SMALL_TURN, STIFFNESS

HOLD = wp.constant(int(JointPart.HOLD))
LIMIT = wp.constant(int(JointPart.LIMIT))
ACROSS = wp.constant(int(JointPart.ACROSS))


@cache
def stretch_rows(dtype: str) -> Any:
    """The function that makes the rows of a distance joint."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    hold, limit, point, spring, steady = ends.hold, ends.limit, ends.point, ends.spring, ends.steady
    stiff, small_square = real(STIFFNESS), real(SMALL_TURN * SMALL_TURN)
    infinity = real(float("inf"))

    @wp.func(module=kernel_module("joints", dtype))
    def make_stretch_rows(
        j: int, e: ends.Ends, config: t.Config, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows
    ):
        """A rod, or a spring about the length; then the range of the length, and inertia across it.

        Along the line between the anchors, which turns within the step; where they meet it has no direction, and is
        taken along x. A rod that pulls by T draws its ends into line with the stiffness T / length. Across it they meet
        as much inertia as slows that to what steps follow, which a rope that turns as a whole at one speed does not
        feel (Andrews et al. 2017). A rod that turns by SMALL_TURN in a step is braked.
        """
        length = wp.length(e.d)
        n = vec2(real(1.0), real(0.0))
        if length > real(0.0):
            n = e.d / length
        along = point(e, n)
        turn = real(0.0)
        if length > real(0.0):
            across = wp.dot(vec2(-n[1], n[0]), e.speed)
            turn = e.dt * across / length
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
        if (joints.joint_parts[j] & ACROSS) != 0:
            inertia = real(0.0)
            if length > real(0.0):
                inertia = stiff * e.dt * wp.abs(joints.joint_impulse[k - 1]) / length
            share = turn * turn / small_square
            brake = wp.min(share * share, real(1.0))
            if e.substeps:  # it is for trees that are solved at once
                inertia = real(0.0)
            steady(k, e, point(e, vec2(-n[1], n[0])), inertia, brake, model, motion, rows)

    return make_stretch_rows
