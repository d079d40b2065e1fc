"""Candidate pairs by testing every box against every other, kept while no shape leaves its box."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, rotate, rotation
from dc_kernels.model.enums import BodyType, Flag, ShapeType

PREDICT_STEPS = 8.0  # steps of motion a moving shape's box is stretched by
FAST_STEPS = 24.0  # the same for those that outrun the speculative distance
REACH_GROWTH = 1.5  # a box made for a speculative distance this much larger outlives bodies speeding up


def kernels(dtype: str) -> Kernels:
    """``update_pairs``; the arrays bring their scalar type."""
    return {"update_pairs": update_pairs}


def update_pairs(
    tid: int,
    world_offset: int,
    margin_factor: float,
    shape_start: Array,
    length_scale: Array,
    cell_size: Array,
    body_type: Array,
    shape_body: Array,
    shape_type: Array,
    shape_radius: Array,
    shape_center: Array,
    shape_extent: Array,
    shape_category: Array,
    shape_mask: Array,
    vertex_start: Array,
    vertices: Array,
    position: Array,
    angle: Array,
    flags: Array,
    step_dt: Array,
    reach: Array,
    predicted: Array,
    bucket_start: Array,
    bucket: Array,
    cell: Array,
    sorted_shape: Array,
    temp_a: Array,
    temp_b: Array,
    pair_valid: Array,
    rebuilds: Array,
    box: Array,
    pair_start: Array,
    pair_count: Array,
    pair_needed: Array,
    pair_a: Array,
    pair_b: Array,
) -> None:
    """Rebuild a world's pairs if a shape, swept over the step, left its box; else keep them.

    The scratch of the cell list (bucket, cell, sorted_shape, temp_a, temp_b) is not touched.
    """
    w = tid + world_offset
    if flags[w]:
        return
    dt = step_dt[w]
    pad = 0.5 * reach[w]  # on each side: a pair closer than the speculative distance counts

    def swept_box(shape: int, steps: float, extra: float) -> Array:
        """Box of a shape over ``steps`` time steps, plus a margin."""
        body = shape_body[shape]
        disc = shape_type[shape] == ShapeType.DISC
        turn = rotation(angle[body])
        first, last = vertex_start[shape], vertex_start[shape + 1]
        if shape_type[shape] == ShapeType.SEGMENT:
            last = first + 2
        core = shape_center[shape][None] if disc else vertices[first:last]
        points = position[body] + rotate(turn, core)
        arm = abs(shape_center[shape]).sum() + (0.0 if disc else shape_extent[shape])
        grow = extra + min(abs(predicted[body, 2] * dt) * steps, 2.0) * arm
        move = predicted[body, :2] * dt * steps
        radius = shape_radius[shape]
        low = points.min(axis=0) - radius + np.minimum(move, 0.0) - grow
        high = points.max(axis=0) + radius + np.maximum(move, 0.0) + grow
        return np.concatenate([low, high]).astype(box.dtype)

    shapes = np.arange(shape_start[w], shape_start[w + 1])
    if pair_valid[w]:
        now = np.array([swept_box(shape, 1.0, pad) for shape in shapes]).reshape(-1, 4)
        if (now[:, :2] >= box[shapes, :2]).all() and (now[:, 2:] <= box[shapes, 2:]).all():
            return

    rebuilds[w] += 1
    for shape in shapes:
        v = predicted[shape_body[shape]]
        steps = FAST_STEPS if (v[0] ** 2 + v[1] ** 2) * dt**2 > 1.1 * reach[w] ** 2 else PREDICT_STEPS
        box[shape] = swept_box(shape, steps, REACH_GROWTH * pad + margin_factor * length_scale[w])
    pairs = []
    for a in shapes:
        for b in np.arange(a + 1, shapes[-1] + 1):
            i, j = shape_body[a], shape_body[b]
            overlap = (box[a, :2] <= box[b, 2:]).all() and (box[b, :2] <= box[a, 2:]).all()
            dynamic = BodyType.DYNAMIC in (body_type[i], body_type[j])
            agreed = shape_category[a] & shape_mask[b] and shape_category[b] & shape_mask[a]
            if overlap and i != j and dynamic and agreed:
                pairs.append((b, a) if body_type[j] == BodyType.STATIC else (a, b))
    pairs.sort()
    pair_needed[w] = len(pairs)
    if len(pairs) > pair_start[w + 1] - pair_start[w]:
        flags[w] |= Flag.PAIR_OVERFLOW
        pair_valid[w] = 0
        return
    for i, (a, b) in enumerate(pairs, pair_start[w]):
        pair_a[i], pair_b[i] = a, b
    pair_count[w] = len(pairs)
    pair_valid[w] = 1
