"""Pairs of shapes whose bodies a joint keeps from colliding with each other."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``separate_joined``; one thread a world."""
    t = group_types(dtype)
    contiguous = contiguous_groups(dtype)

    @wp.kernel(module=kernel_module("joined", dtype), enable_backward=False)
    def separate_joined(
        launch: t.Launch, model: t.Model, state: t.State, joints: t.Joints, rows: t.Rows, pairs: t.Pairs
    ):
        """Candidate pairs without those of bodies that a joint that is not broken keeps apart, in their order."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(joints)
        contiguous(rows)
        contiguous(pairs)
        if state.flags[w] != 0:
            return
        first = pairs.start[w]
        last = first
        for p in range(first, first + pairs.count[w]):
            a = model.shape_body[pairs.shape_a[p]]
            b = model.shape_body[pairs.shape_b[p]]
            apart = int(0)
            for i in range(rows.apart_start[a], rows.apart_start[a + 1]):
                if rows.apart_body[i] == b and joints.joint_broken[rows.apart_joint[i]] == 0:
                    apart = 1
            if apart == 0:
                pairs.shape_a[last] = pairs.shape_a[p]
                pairs.shape_b[last] = pairs.shape_b[p]
                pairs.temp_b[last] = pairs.temp_b[p]  # its near pair, whose place has what recycle.py keeps
                last += 1
        pairs.count[w] = last - first

    return {"separate_joined": separate_joined}
