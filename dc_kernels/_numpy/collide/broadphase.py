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


def box_kernels(dtype: str) -> Kernels:
    """``bound_shapes`` and ``update_box_pairs``; the arrays bring their scalar type."""
    return {"bound_shapes": bound_shapes, "update_box_pairs": update_box_pairs}


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
        points = core_points(shape, model, state)
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

    for shape in shapes:
        v = motion.predicted[model.shape_body[shape]]
        steps = FAST_STEPS if (v[0] ** 2 + v[1] ** 2) * dt**2 > 1.1 * motion.reach[w] ** 2 else PREDICT_STEPS
        pairs.box[shape] = swept_box(shape, steps, REACH_GROWTH * pad + config.margin * model.length_scale[w])
    find_pairs(w, model, state, pairs)


def core_points(shape: int, model: Any, state: Any) -> Array:
    """The points whose hull, with the shape's radius, is the shape, (n, 2)."""
    body = model.shape_body[shape]
    first, last = model.vertex_start[shape], model.vertex_start[shape + 1]
    if model.shape_type[shape] == ShapeType.SEGMENT:
        last = first + 2
    disc = model.shape_type[shape] == ShapeType.DISC
    core = model.shape_center[shape][None] if disc else model.vertices[first:last]
    return state.position[body] + rotate(rotation(state.angle[body]), core)


def bound_shapes(tid: int, launch: Any, model: Any, state: Any, boxes: Any) -> None:
    """The box of each shape of a world, larger by the margin."""
    w = tid + launch.world_offset
    for shape in range(model.shape_start[w], model.shape_start[w + 1]):
        points = core_points(shape, model, state)
        grow = model.shape_radius[shape] + points.dtype.type(boxes.margin)
        boxes.lower[shape], boxes.upper[shape] = points.min(axis=0) - grow, points.max(axis=0) + grow


def update_box_pairs(tid: int, launch: Any, model: Any, state: Any, boxes: Any, pairs: Any) -> None:
    """Rebuild a world's pairs if a box left the one with margin, or a filter changed; else keep them."""
    w = tid + launch.world_offset
    state.flags[w] = 0
    shapes = slice(model.shape_start[w], model.shape_start[w + 1])
    lower, upper, body = boxes.lower[shapes], boxes.upper[shapes], model.shape_body[shapes]
    bodies = ((body >= 0) & (body < len(model.body_type))).all()
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all() and bodies):
        state.flags[w] = Flag.INVALID
        pairs.valid[w] = pairs.count[w] = 0
        return
    filters = hash(tuple(a.tobytes() for a in (model.shape_category[shapes], model.shape_mask[shapes], body)))
    filters = hash((filters, model.body_type[body].tobytes()))
    inside = (lower >= pairs.box[shapes, :2]).all() and (upper <= pairs.box[shapes, 2:]).all()
    if pairs.valid[w] and inside and filters == boxes.filters[w]:
        return
    boxes.filters[w] = filters
    pairs.box[shapes] = np.concatenate([lower - boxes.margin, upper + boxes.margin], axis=1)
    find_pairs(w, model, state, pairs)
    if state.flags[w]:
        pairs.count[w] = 0


def find_pairs(w: int, model: Any, state: Any, pairs: Any) -> None:
    """Pairs of a world's shapes whose boxes ``pairs.box`` overlap."""
    pairs.rebuilds[w] += 1
    shapes = np.arange(model.shape_start[w], model.shape_start[w + 1])
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
