"""Boxes -> candidate pairs, kept while no box leaves its margin (the pairs: ``pairs``)."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.pairs import DISC, pair_functions
from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguity, contiguous_groups, group_types, struct_type
from dc_kernels.collide.fields import BOXES
from dc_kernels.model.enums import Flag

INVALID = wp.constant(int(Flag.INVALID))
PREDICT_STEPS = wp.constant(8.0)  # steps of motion a moving shape's box is stretched by; 2 to 16 cost the same
FAST_STEPS = wp.constant(24.0)  # steps a box is stretched by where a step takes it beyond the speculative distance
REACH_GROWTH = wp.constant(1.5)  # a box made for a speculative distance this much larger outlives bodies speeding up
FINEST = wp.constant(2.0**-29)  # of the farthest coordinate: cells are counted in int32
TINY = wp.constant(1e-30)
MIX = wp.constant(wp.int64(0x2545F4914F6CDD1D))  # an odd number whose multiples spread over all bits (Vigna 2016)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``update_pairs``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("broadphase", dtype)
    contiguous = contiguous_groups(dtype)
    functions = pair_functions(dtype)
    shape_box, find_pairs = functions.shape_box, functions.find_pairs

    @wp.func(module=module)
    def spin_arm(kind: int, center: vec2, extent: real):
        """Bound on the distance from the centre of mass of what a rotation moves."""
        arm = wp.abs(center[0]) + wp.abs(center[1])
        if kind != DISC:
            arm += extent
        return arm

    @wp.kernel(module=module, enable_backward=False)
    def update_pairs(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
    ):
        """Rebuild a world's pairs if a shape, swept over the step, left its box; else keep them."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(pairs)
        if state.flags[w] != 0:
            return
        first = model.shape_start[w]
        last = model.shape_start[w + 1]
        dt = motion.step_dt[w]
        # half the speculative distance on each side: a pair closer than it is found
        pad = real(0.5) * motion.reach[w]

        keep = pairs.valid[w]
        shape = first
        while keep == 1 and shape < last:
            body = model.shape_body[shape]
            v = motion.predicted[body]
            x = state.position[body]
            kind = model.shape_type[shape]
            r = model.shape_radius[shape]
            center = model.shape_center[shape]
            c = real(1.0)
            s = real(0.0)
            if kind != DISC or center[0] != real(0.0) or center[1] != real(0.0):
                c = wp.cos(state.angle[body])
                s = wp.sin(state.angle[body])
            tight = shape_box(shape, kind, center, c, s, x, model.vertex_start, model.vertices, r)
            grow = pad + wp.min(wp.abs(v[2] * dt), real(2.0)) * spin_arm(kind, center, model.shape_extent[shape])
            outer = pairs.box[shape]
            if (
                tight[0] + wp.min(v[0] * dt, real(0.0)) - grow < outer[0]
                or tight[1] + wp.min(v[1] * dt, real(0.0)) - grow < outer[1]
                or tight[2] + wp.max(v[0] * dt, real(0.0)) + grow > outer[2]
                or tight[3] + wp.max(v[1] * dt, real(0.0)) + grow > outer[3]
            ):
                keep = 0
            shape += 1
        if keep == 1:
            return

        margin = config.margin * model.length_scale[w] + real(REACH_GROWTH) * pad
        for shape in range(first, last):
            body = model.shape_body[shape]
            v = motion.predicted[body]
            kind = model.shape_type[shape]
            center = model.shape_center[shape]
            c = real(1.0)
            s = real(0.0)
            if kind != DISC or center[0] != real(0.0) or center[1] != real(0.0):
                c = wp.cos(state.angle[body])
                s = wp.sin(state.angle[body])
            tight = shape_box(
                shape,
                kind,
                center,
                c,
                s,
                state.position[body],
                model.vertex_start,
                model.vertices,
                model.shape_radius[shape],
            )
            arm = spin_arm(kind, center, model.shape_extent[shape])
            ahead = dt * real(PREDICT_STEPS)
            if (v[0] * v[0] + v[1] * v[1]) * dt * dt > real(1.1) * motion.reach[w] * motion.reach[w]:
                ahead = dt * real(FAST_STEPS)
            grow = margin + wp.min(wp.abs(v[2]) * ahead, real(2.0)) * arm
            dx = v[0] * ahead
            dy = v[1] * ahead
            outer = vec4(
                tight[0] + wp.min(dx, real(0.0)) - grow,
                tight[1] + wp.min(dy, real(0.0)) - grow,
                tight[2] + wp.max(dx, real(0.0)) + grow,
                tight[3] + wp.max(dy, real(0.0)) + grow,
            )
            pairs.box[shape] = outer
        find_pairs(w, model.cell_size[w], model, state, pairs)

    return {"update_pairs": update_pairs}


@cache
def box_kernels(dtype: str) -> dict[str, Any]:
    """``bound_shapes`` and ``update_box_pairs``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Boxes = struct_type("boxes", dtype, BOXES)
    module = kernel_module("box_pairs", dtype)
    contiguous = contiguous_groups(dtype)
    functions = pair_functions(dtype)
    shape_box, find_pairs = functions.shape_box, functions.find_pairs

    @wp.func_native(contiguity(BOXES))
    def contiguous_boxes(group: Boxes): ...

    @wp.kernel(module=module, enable_backward=False)
    def bound_shapes(launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes):
        """The box of each shape of a world, larger by the margin."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous_boxes(boxes)
        for shape in range(model.shape_start[w], model.shape_start[w + 1]):
            body = model.shape_body[shape]
            c = wp.cos(state.angle[body])
            s = wp.sin(state.angle[body])
            x = state.position[body]
            kind = model.shape_type[shape]
            center = model.shape_center[shape]
            radius = model.shape_radius[shape] + boxes.margin
            box = shape_box(shape, kind, center, c, s, x, model.vertex_start, model.vertices, radius)
            boxes.lower[shape] = vec2(box[0], box[1])
            boxes.upper[shape] = vec2(box[2], box[3])

    @wp.kernel(module=module, enable_backward=False)
    def update_box_pairs(launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes, pairs: t.Pairs):
        """Rebuild a world's pairs if a box left the one with margin, or a filter changed; else keep them.

        A world with a box that is not finite, or whose lower corner is not the lower one, has no pairs.
        """
        w = wp.tid() + launch.world_offset
        contiguous(pairs)
        contiguous_boxes(boxes)
        state.flags[w] = 0
        keep = pairs.valid[w]
        filters = wp.int64(1)
        smallest = real(0.0)
        farthest = real(0.0)
        good = int(1)
        first = model.shape_start[w]
        bodies = model.body_type.shape[0]
        for shape in range(first, model.shape_start[w + 1]):
            low = boxes.lower[shape]
            high = boxes.upper[shape]
            body = model.shape_body[shape]
            far = wp.max(wp.max(wp.abs(low[0]), wp.abs(low[1])), wp.max(wp.abs(high[0]), wp.abs(high[1])))
            if not (low[0] <= high[0] and low[1] <= high[1]) or not wp.isfinite(far) or body < 0 or body >= bodies:
                good = 0
            else:
                outer = pairs.box[shape]
                if low[0] < outer[0] or low[1] < outer[1] or high[0] > outer[2] or high[1] > outer[3]:
                    keep = 0
                extent = wp.max(high[0] - low[0], high[1] - low[1])
                if shape == first or extent < smallest:
                    smallest = extent
                farthest = wp.max(farthest, far)
                kinds = (wp.int64(model.shape_category[shape]) << wp.int64(32)) | wp.int64(model.shape_mask[shape])
                filters = (filters ^ kinds) * MIX
                filters = (filters ^ (wp.int64(body) * wp.int64(4) + wp.int64(model.body_type[body]))) * MIX
        if good == 0:
            state.flags[w] = INVALID
            pairs.valid[w] = 0
            pairs.count[w] = 0
            return
        if keep == 1 and filters == boxes.filters[w]:
            return
        boxes.filters[w] = filters
        margin = boxes.margin
        for shape in range(first, model.shape_start[w + 1]):
            low = boxes.lower[shape]
            high = boxes.upper[shape]
            pairs.box[shape] = vec4(low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin)
        size = wp.max(smallest + real(2.0) * margin, (farthest + margin) * real(FINEST))
        find_pairs(w, wp.max(size, real(TINY)), model, state, pairs)
        if state.flags[w] != 0:
            pairs.count[w] = 0

    return {"bound_shapes": bound_shapes, "update_box_pairs": update_box_pairs}
