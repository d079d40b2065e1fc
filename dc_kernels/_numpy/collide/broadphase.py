"""Candidate pairs by testing every box against every other, kept while no shape leaves its box."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, rotate, rotation
from dc_kernels.model.enums import BodyType, Flag, ShapeType

PREDICT_STEPS = 8.0  # steps of motion a moving shape's box is stretched by
FAST_STEPS = 24.0  # steps a box is stretched by where a step takes its shape beyond the speculative distance
REACH_GROWTH = 1.5  # a box made for a speculative distance this much larger outlives bodies speeding up


def kernels(dtype: str) -> Kernels:
    """``update_pairs``; the arrays bring their scalar type."""
    return {"update_pairs": update_pairs}


def update_pairs(
    tid: int,
    launch: Any,
    config: Any,
    model: Any,
    state: Any,
    motion: Any,
    pairs: Any,
) -> None:
    """Rebuild a world's pairs if a shape, swept over the step, left its box; else keep them.

    The scratch of the cell list (bucket, cell, sorted_shape, temp_a, temp_b) is not touched.
    """
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    dt = motion.step_dt[w]
    pad = 0.5 * motion.reach[w]  # on each side: a pair closer than the speculative distance counts

    def swept_box(shape: int, steps: float, extra: float) -> Array:
        """Box of a shape over ``steps`` time steps, plus a margin."""
        body = model.shape_body[shape]
        disc = model.shape_type[shape] == ShapeType.DISC
        turn = rotation(state.angle[body])
        first, last = model.vertex_start[shape], model.vertex_start[shape + 1]
        if model.shape_type[shape] == ShapeType.SEGMENT:
            last = first + 2
        core = model.shape_center[shape][None] if disc else model.vertices[first:last]
        points = state.position[body] + rotate(turn, core)
        arm = abs(model.shape_center[shape]).sum() + (0.0 if disc else model.shape_extent[shape])
        grow = extra + min(abs(motion.predicted[body, 2] * dt) * steps, 2.0) * arm
        move = motion.predicted[body, :2] * dt * steps
        radius = model.shape_radius[shape]
        low = points.min(axis=0) - radius + np.minimum(move, 0.0) - grow
        high = points.max(axis=0) + radius + np.maximum(move, 0.0) + grow
        return np.concatenate([low, high]).astype(pairs.box.dtype)

    shapes = np.arange(model.shape_start[w], model.shape_start[w + 1])
    if pairs.valid[w]:
        now = np.array([swept_box(shape, 1.0, pad) for shape in shapes]).reshape(-1, 4)
        if (now[:, :2] >= pairs.box[shapes, :2]).all() and (now[:, 2:] <= pairs.box[shapes, 2:]).all():
            return

    pairs.rebuilds[w] += 1
    for shape in shapes:
        v = motion.predicted[model.shape_body[shape]]
        steps = FAST_STEPS if (v[0] ** 2 + v[1] ** 2) * dt**2 > 1.1 * motion.reach[w] ** 2 else PREDICT_STEPS
        pairs.box[shape] = swept_box(shape, steps, REACH_GROWTH * pad + config.margin * model.length_scale[w])
    found = []
    for a in shapes:
        for b in np.arange(a + 1, shapes[-1] + 1):
            i, j = model.shape_body[a], model.shape_body[b]
            overlap = (pairs.box[a, :2] <= pairs.box[b, 2:]).all() and (pairs.box[b, :2] <= pairs.box[a, 2:]).all()
            dynamic = BodyType.DYNAMIC in (model.body_type[i], model.body_type[j])
            agreed = model.shape_category[a] & model.shape_mask[b] and model.shape_category[b] & model.shape_mask[a]
            if overlap and i != j and dynamic and agreed:
                found.append((b, a) if model.body_type[j] == BodyType.STATIC else (a, b))
    found.sort()
    pairs.needed[w] = len(found)
    if len(found) > pairs.start[w + 1] - pairs.start[w]:
        state.flags[w] |= Flag.PAIR_OVERFLOW
        pairs.valid[w] = 0
        return
    for i, (a, b) in enumerate(found, pairs.start[w]):
        pairs.shape_a[i], pairs.shape_b[i] = a, b
    pairs.count[w] = len(found)
    pairs.valid[w] = 1
