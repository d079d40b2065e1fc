"""Boxes -> candidate pairs, kept while no box leaves its margin (the pairs: ``pairs``)."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.pairs import code, pair_functions, shared_code
from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguity, contiguous_groups, group_types, struct_type
from dc_kernels.collide.fields import BOXES
from dc_kernels.model.enums import Flag

INVALID = wp.constant(int(Flag.INVALID))
PREDICT_STEPS = 8.0  # steps of motion that a moving shape's box with margin is made for
FAST_STEPS = 4.0  # where a step takes the shape beyond the speculative distance: longer boxes would meet too many
REACH_GROWTH = wp.constant(1.5)  # a box made for a speculative distance this much larger outlives bodies speeding up
SOON = wp.constant(0.5)  # of the margin: what is as close to leaving its box when others do is given a new one, too
MOST = wp.constant(2)  # where more than one in so many shapes has left its box, all are given a new one
MIX = wp.constant(wp.int64(0x2545F4914F6CDD1D))  # an odd number whose multiples spread over all bits (Vigna 2016)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``update_pairs``; one thread a world."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("broadphase", dtype)
    contiguous = contiguous_groups(dtype)
    renew_pairs = pair_functions(dtype).renew_pairs

    @wp.func_native(shared_code(dtype, "box_of", "swept", "sweep"))
    def sweep(
        w: wp.int32,
        spare: real,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        team: wp.uint64,
    ) -> wp.int32: ...

    @wp.func_native(code(dtype, "box_of", "swept", "widen", PREDICT_STEPS=PREDICT_STEPS, FAST_STEPS=FAST_STEPS))
    def widen(
        w: wp.int32, left: wp.int32, margin: real, model: t.Model, state: t.State, motion: t.Motion, pairs: t.Pairs
    ): ...

    @wp.func_native(shared_code(dtype, "cull"))
    def cull(w: wp.int32, pairs: t.Pairs, team: wp.uint64): ...

    @wp.kernel(module=module, enable_backward=False)
    def update_pairs(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
    ):
        """Candidate pairs of a world: those whose boxes, swept over the step, overlap.

        They are taken from the pairs whose boxes with margin overlap, which are kept. Where a swept box has left its
        box with margin, the shape is given a new one, and its pairs are found anew; all of them, if most have left.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(pairs)
        if state.flags[w] != 0:
            return
        shapes = model.shape_start[w + 1] - model.shape_start[w]
        margin = config.margin * model.length_scale[w]
        left = sweep(w, real(SOON) * margin, model, state, motion, pairs, launch.team)
        if pairs.valid[w] == 0 or left > shapes // MOST:
            left = shapes
        if pairs.valid[w] == 0 or left > 0:
            margin += real(REACH_GROWTH) * real(0.5) * motion.reach[w]
            widen(w, left, margin, model, state, motion, pairs)
            renew_pairs(
                w, left, model, state, pairs, pairs.near_a, pairs.near_b, pairs.near_count, pairs.shape_a, pairs.shape_b
            )
            if state.flags[w] != 0:
                return
        cull(w, pairs, launch.team)

    return {"update_pairs": update_pairs}


@cache
def box_kernels(dtype: str) -> dict[str, Any]:
    """``bound_shapes`` and ``update_box_pairs``; one thread a world."""
    t = group_types(dtype)
    vec4 = t.vec4
    Boxes = struct_type("boxes", dtype, BOXES)
    module = kernel_module("box_pairs", dtype)
    contiguous = contiguous_groups(dtype)
    renew_pairs = pair_functions(dtype).renew_pairs

    @wp.func_native(code(dtype, "box_of", "enclose"))
    def enclose(w: wp.int32, model: t.Model, state: t.State, boxes: Boxes): ...

    @wp.func_native(contiguity(BOXES))
    def contiguous_boxes(group: Boxes): ...

    @wp.kernel(module=module, enable_backward=False)
    def bound_shapes(launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes):
        """The box of each shape of a world, larger by the margin."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous_boxes(boxes)
        enclose(w, model, state, boxes)

    @wp.kernel(module=module, enable_backward=False)
    def update_box_pairs(launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes, pairs: t.Pairs):
        """Rebuild a world's pairs if a box left the one with margin, or a filter changed; else keep them.

        A world with a box that is not finite, or whose lower corner is not the lower one, has no pairs.
        """
        w = wp.tid() + launch.world_offset
        contiguous(pairs)
        contiguous_boxes(boxes)
        state.flags[w] = 0
        filters = wp.int64(1)
        good = bool(True)
        left = int(0)
        first = model.shape_start[w]
        last = model.shape_start[w + 1]
        bodies = model.body_type.shape[0]
        for shape in range(first, last):
            low = boxes.lower[shape]
            high = boxes.upper[shape]
            body = model.shape_body[shape]
            if not (low[0] <= high[0] and low[1] <= high[1] and wp.isfinite(low) and wp.isfinite(high)):
                good = False
            elif body < 0 or body >= bodies:
                good = False
            else:
                outer = pairs.box[shape]
                if not (low[0] >= outer[0] and low[1] >= outer[1] and high[0] <= outer[2] and high[1] <= outer[3]):
                    pairs.left[first + left] = shape
                    left += 1
                kinds = (wp.int64(model.shape_category[shape]) << wp.int64(32)) | wp.int64(model.shape_mask[shape])
                filters = (filters ^ kinds) * MIX
                filters = (filters ^ (wp.int64(body) * wp.int64(4) + wp.int64(model.body_type[body]))) * MIX
        if not good:
            state.flags[w] = INVALID
            pairs.valid[w] = 0
            pairs.count[w] = 0
            return
        if pairs.valid[w] == 0 or filters != boxes.filters[w] or left > (last - first) // MOST:
            left = last - first
            for shape in range(first, last):
                pairs.left[shape] = shape
        elif left == 0:
            return
        boxes.filters[w] = filters
        margin = boxes.margin
        for i in range(first, first + left):
            low = boxes.lower[pairs.left[i]]
            high = boxes.upper[pairs.left[i]]
            pairs.box[pairs.left[i]] = vec4(low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin)
        renew_pairs(w, left, model, state, pairs, pairs.shape_a, pairs.shape_b, pairs.count, pairs.near_a, pairs.near_b)

    return {"bound_shapes": bound_shapes, "update_box_pairs": update_box_pairs}
