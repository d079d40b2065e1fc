"""Pairs of shapes whose bodies a joint keeps from colliding with each other."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.common import Kernels


def separate_joined(tid: int, launch: Any, model: Any, state: Any, joints: Any, rows: Any, pairs: Any) -> None:
    """Candidate pairs without those of bodies that a joint that is not broken keeps apart, in their order."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    first = pairs.start[w]
    last = first
    for p in range(first, first + pairs.count[w]):
        a, b = model.shape_body[[pairs.shape_a[p], pairs.shape_b[p]]]
        own = slice(rows.apart_start[a], rows.apart_start[a + 1])
        joined = rows.apart_joint[own][rows.apart_body[own] == b]
        if joints.joint_broken[joined].all():
            pairs.shape_a[last], pairs.shape_b[last] = pairs.shape_a[p], pairs.shape_b[p]
            last += 1
    pairs.count[w] = last - first


def kernels(dtype: str) -> Kernels:
    """``separate_joined``; the arrays bring their scalar type."""
    return {"separate_joined": separate_joined}
