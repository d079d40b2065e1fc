"""The rows of a distance joint that is more than a rod: a spring, a rope, or both."""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import dot, length
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.constraints.ends import end_functions
from dc_kernels.model.enums import JointPart
from dc_kernels.solve.joints import SMALL_TURN, STIFFNESS

HOLD = int(JointPart.HOLD)
LIMIT = int(JointPart.LIMIT)
ACROSS = int(JointPart.ACROSS)
SMALL_SQUARE = SMALL_TURN * SMALL_TURN


@cache
def stretch_rows(dtype: str) -> Any:
    """The function that makes the rows of a distance joint."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    ends = end_functions(dtype)
    hold, limit, point, spring, steady = ends.hold, ends.limit, ends.point, ends.spring, ends.steady
    infinity = float("inf")

    @ti.func
    def make_stretch_rows(j, e, config: t.Config, model: t.Model, motion: t.Motion, joints: t.Joints, rows: t.Rows):
        """A rod, or a spring about the length; then the range of the length, and inertia across it.

        Along the line between the anchors, which turns within the step; where they meet it has no direction, and is
        taken along x.
        """
        apart = length(e.d)
        n = vec2(1.0, 0.0)
        if apart > 0.0:
            n = e.d / apart
        along = point(e, n)
        turn = real(0.0)
        if apart > 0.0:
            across = dot(vec2(0.0 - n[1], n[0]), e.speed)
            turn = e.dt * across / apart
            along.grow += 0.5 * e.dt * e.dt * across * across / apart
        k = joints.joint_row_start[j]
        if (joints.joint_parts[j] & HOLD) != 0:
            along.off = apart - joints.joint_length[j]
            frequency = joints.joint_frequency[j]
            if frequency > 0.0:
                spring(k, e, along, frequency, joints.joint_damping_ratio[j], infinity, model, motion, rows)
            else:
                hold(k, e, along, config, rows)
            k += 1
        if (joints.joint_parts[j] & LIMIT) != 0:
            along.off = apart
            limit(k, e, along, joints.joint_lower[j], joints.joint_upper[j], config, rows)
        if (joints.joint_parts[j] & ACROSS) != 0:
            inertia = real(0.0)
            if apart > 0.0:
                inertia = STIFFNESS * e.dt * ti.abs(joints.joint_impulse[k - 1]) / apart
            share = turn * turn / SMALL_SQUARE
            brake = ti.min(share * share, 1.0)
            steady(k, e, point(e, vec2(0.0 - n[1], n[0])), inertia, brake, model, motion, rows)

    return make_stretch_rows
