"""Pairs of shapes whose bodies a joint keeps from colliding with each other."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.kernels import kernel


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``separate_joined``; one thread a world."""
    t = group_types(dtype)

    @kernel
    def separate_joined(
        tid, launch: t.Launch, model: t.Model, state: t.State, joints: t.Joints, rows: t.Rows, pairs: t.Pairs
    ):
        """Candidate pairs without those of bodies that a joint that is not broken keeps apart, in their order."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            first = pairs.start[w]
            last = first
            for p in range(first, first + pairs.count[w]):
                shape_a = pairs.shape_a[p]
                shape_b = pairs.shape_b[p]
                a = model.shape_body[shape_a]
                b = model.shape_body[shape_b]
                apart = 0
                for i in range(rows.apart_start[a], rows.apart_start[a + 1]):
                    if rows.apart_body[i] == b and joints.joint_broken[rows.apart_joint[i]] == 0:
                        apart = 1
                if apart == 0:
                    pairs.shape_a[last] = shape_a
                    pairs.shape_b[last] = shape_b
                    last += 1
            pairs.count[w] = last - first

    return {"separate_joined": separate_joined}
