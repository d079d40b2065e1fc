"""Pairs by testing every box against every other: those with margin are kept while no shape leaves its box.

Candidates are those of them whose boxes, swept over the step, overlap.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, rotate, rotation
from dc_kernels.model.enums import BodyType, Flag, ShapeType

PREDICT_STEPS = 8.0  # steps of motion that a moving shape's box with margin is made for
FAST_STEPS = 4.0  # where a step takes the shape beyond the speculative distance: longer boxes would meet too many
SOON = 0.5  # of the margin: what is as close to leaving its box when others do is given a new one, too
MOST = 2  # where more than one in so many shapes has left its box, all are given a new one
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
    """Candidate pairs of a world: those whose boxes, swept over the step, overlap.

    They are taken from the pairs of boxes with margin, which are kept until a shape leaves its box. Then it is given a
    new one; all are, if most have left. Scratch is not touched.
    """
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    dt = motion.step_dt[w]
    pad = 0.5 * motion.reach[w]  # on each side: a pair closer than the speculative distance counts

    def swept_box(shape: int, steps: float, extra: float) -> Array:
        """What a shape covers that moves on for some steps, larger by ``extra`` on each side.

        The last of the steps counts as far as a gap may lie that it closes along its normal: such gaps end on the
        circle whose diameter is the way of the step.
        """
        body = model.shape_body[shape]
        disc = model.shape_type[shape] == ShapeType.DISC
        points = core_points(shape, model, state)
        arm = abs(model.shape_center[shape]).sum() + (0.0 if disc else model.shape_extent[shape])
        grow = extra + min(abs(motion.predicted[body, 2] * dt) * steps, 2.0) * arm
        way = motion.predicted[body, :2] * dt
        length, before = np.hypot(*way), way * (steps - 1.0)
        radius = model.shape_radius[shape]
        low = points.min(axis=0) - radius + (way - length) / 2 + np.minimum(before, 0.0) - grow
        high = points.max(axis=0) + radius + (way + length) / 2 + np.maximum(before, 0.0) + grow
        return np.concatenate([low, high]).astype(pairs.box.dtype)

    shapes = np.arange(model.shape_start[w], model.shape_start[w + 1])
    swept = np.array([swept_box(shape, 1.0, pad) for shape in shapes], pairs.box.dtype).reshape(-1, 4)
    pairs.swept[shapes] = swept
    spare = SOON * config.margin * model.length_scale[w]
    left = leavers(pairs.valid[w], swept, pairs.box[shapes], spare)
    if left.any() or not pairs.valid[w]:
        for shape in shapes[left]:
            v = motion.predicted[model.shape_body[shape]]
            steps = FAST_STEPS if (v[0] ** 2 + v[1] ** 2) * dt**2 > 1.1 * motion.reach[w] ** 2 else PREDICT_STEPS
            pairs.box[shape] = swept_box(shape, steps, REACH_GROWTH * pad + config.margin * model.length_scale[w])
        find_pairs(w, model, state, pairs, pairs.near_a, pairs.near_b, pairs.near_count)
        if state.flags[w]:
            return
    first, last = pairs.start[w], pairs.start[w] + pairs.near_count[w]
    met = [(a, b) for a, b in zip(pairs.near_a[first:last], pairs.near_b[first:last]) if overlap(pairs.swept, a, b)]
    for i, (a, b) in enumerate(met, first):
        pairs.shape_a[i], pairs.shape_b[i] = a, b
    pairs.count[w] = len(met)


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
    valid = pairs.valid[w] and filters == boxes.filters[w]
    left = leavers(valid, np.concatenate([lower, upper], axis=1), pairs.box[shapes])
    if valid and not left.any():
        return
    boxes.filters[w] = filters
    pairs.box[shapes][left] = np.concatenate([lower - boxes.margin, upper + boxes.margin], axis=1)[left]
    find_pairs(w, model, state, pairs, pairs.shape_a, pairs.shape_b, pairs.count)


def leavers(valid: bool, now: Array, box: Array, spare: float = 0.0) -> Array:
    """Which shapes have left their box with margin, (n,) bool; all, if most have or pairs are not valid.

    Where there are some, those that come closer to the sides of theirs than ``spare`` count, too.
    """

    def outside(spare: float) -> Array:
        return ~((now[:, :2] >= box[:, :2] + spare).all(axis=1) & (now[:, 2:] <= box[:, 2:] - spare).all(axis=1))

    left = outside(0.0)
    if left.any():
        left = outside(spare)
    return left if valid and left.sum() <= len(box) // MOST else np.ones_like(left)


def overlap(box: Array, a: int, b: int) -> bool:
    """Whether two boxes have a point in common."""
    return bool((box[a, :2] <= box[b, 2:]).all() and (box[b, :2] <= box[a, 2:]).all())


def find_pairs(w: int, model: Any, state: Any, pairs: Any, near_a: Array, near_b: Array, near_count: Array) -> None:
    """Pairs of a world's shapes whose boxes ``pairs.box`` overlap, into ``near_a`` and ``near_b``."""
    pairs.rebuilds[w] += 1
    shapes = np.arange(model.shape_start[w], model.shape_start[w + 1])
    found = []
    for a in shapes:
        for b in np.arange(a + 1, shapes[-1] + 1):
            i, j = model.shape_body[a], model.shape_body[b]
            dynamic = BodyType.DYNAMIC in (model.body_type[i], model.body_type[j])
            agreed = model.shape_category[a] & model.shape_mask[b] and model.shape_category[b] & model.shape_mask[a]
            if overlap(pairs.box, a, b) and i != j and dynamic and agreed:
                found.append((b, a) if model.body_type[j] == BodyType.STATIC else (a, b))
    found.sort()
    pairs.needed[w] = len(found)
    pairs.valid[w] = len(found) <= pairs.start[w + 1] - pairs.start[w]
    if not pairs.valid[w]:
        state.flags[w] |= Flag.PAIR_OVERFLOW
        near_count[w] = 0
        return
    for i, (a, b) in enumerate(found, pairs.start[w]):
        near_a[i], near_b[i] = a, b
    near_count[w] = len(found)
