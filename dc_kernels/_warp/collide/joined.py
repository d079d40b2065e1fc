"""Candidate pairs that are taken out: of shapes whose bodies a joint keeps from colliding with each other."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types


@cache
def move_pair(dtype: str) -> Any:
    """Return the function that moves a candidate to another slot, for kernels that take some out."""
    t = group_types(dtype)

    @wp.func(module=kernel_module("joined", dtype))
    def move_pair(pairs: t.Pairs, p: int, to: int):
        """Move pair p, with the number of its near pair, by which recycle.py finds what it keeps."""
        pairs.shape_a[to] = pairs.shape_a[p]
        pairs.shape_b[to] = pairs.shape_b[p]
        pairs.temp_b[to] = pairs.temp_b[p]

    return move_pair


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``separate_joined``; one thread a world."""
    t = group_types(dtype)
    contiguous = contiguous_groups(dtype)
    keep = move_pair(dtype)

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
                keep(pairs, p, last)
                last += 1
        pairs.count[w] = last - first

    return {"separate_joined": separate_joined}
