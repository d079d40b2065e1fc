"""Boxes -> candidate pairs, kept while no box leaves its margin (the pairs: ``pairs``)."""

from functools import cache
from typing import Any

from dc_kernels._taichi.collide.pairs import DISC, overlaps, pair_functions
from dc_kernels._taichi.groups import group_types, struct_type
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.collide.fields import BOXES
from dc_kernels.model.enums import Flag

INVALID = int(Flag.INVALID)
PREDICT_STEPS = 8.0  # steps of motion that a moving shape's box with margin is made for
FAST_STEPS = 4.0  # where a step takes the shape beyond the speculative distance: longer boxes would meet too many
REACH_GROWTH = 1.5  # a box made for a speculative distance this much larger outlives bodies speeding up
SOON = 0.5  # of the margin: what is as close to leaving its box when others do is given a new one, too
MOST = 2  # where more than one in so many shapes has left its box, all are given a new one
FINEST = 2.0**-29  # of the farthest coordinate: cells are counted in int32
TINY = 1e-30
MIX = 0x2545F4914F6CDD1D  # an odd number whose multiples spread over all bits (Vigna 2016)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``update_pairs``; one thread a world."""
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    functions = pair_functions(dtype)
    shape_box, find_pairs = functions.shape_box, functions.find_pairs

    @ti.func
    def spin_arm(kind, center, extent):
        """Bound on the distance from the centre of mass of what a rotation moves."""
        arm = ti.abs(center[0]) + ti.abs(center[1])
        if kind != DISC:
            arm += extent
        return arm

    @ti.func
    def turned_box(shape, model: t.Model, state: t.State):
        """Tight box of a shape where its body is; a disc about its centre of mass needs no angle."""
        body = model.shape_body[shape]
        kind = model.shape_type[shape]
        center = model.shape_center[shape]
        c = real(1.0)
        s = real(0.0)
        if kind != DISC or center[0] != 0.0 or center[1] != 0.0:
            c = ti.cos(state.angle[body])
            s = ti.sin(state.angle[body])
        x = state.position[body]
        return shape_box(shape, kind, center, c, s, x, model.vertex_start, model.vertices, model.shape_radius[shape])

    @ti.func
    def swept_box(shape, dt, steps, margin, model: t.Model, state: t.State, motion: t.Motion):
        """What a shape covers that moves on for some steps, larger by a margin on each side.

        The last of the steps counts as far as a gap may lie that it closes along its normal: such gaps end on the
        circle whose diameter is the way of the step.
        """
        box = turned_box(shape, model, state)
        v = motion.predicted[model.shape_body[shape]]
        x = v[0] * dt
        y = v[1] * dt
        way = ti.sqrt(x * x + y * y)
        before = steps - real(1.0)
        arm = spin_arm(model.shape_type[shape], model.shape_center[shape], model.shape_extent[shape])
        grow = margin + ti.min(ti.abs(v[2] * dt) * steps, 2.0) * arm
        return vec4(
            box[0] + 0.5 * (x - way) + ti.min(x * before, 0.0) - grow,
            box[1] + 0.5 * (y - way) + ti.min(y * before, 0.0) - grow,
            box[2] + 0.5 * (x + way) + ti.max(x * before, 0.0) + grow,
            box[3] + 0.5 * (y + way) + ti.max(y * before, 0.0) + grow,
        )

    @ti.func
    def is_candidate(a, b, pairs: t.Pairs):
        """1 where the swept boxes of two shapes overlap: added to the number of pairs, it needs no branch."""
        return ti.cast(overlaps(pairs.swept[a], pairs.swept[b]), ti.i32)

    @ti.func
    def put(n, a, b, pairs: t.Pairs):
        pairs.shape_a[n] = a
        pairs.shape_b[n] = b

    @ti.func
    def cull(w, pairs: t.Pairs):
        """Of the pairs that are kept those whose boxes, swept over the step, overlap.

        Four are looked at before any is stored: where an array lies is looked up anew after each store.
        """
        start = pairs.start[w]
        end = start + pairs.near_count[w]
        n = start
        i = start
        while i + 4 <= end:
            a0 = pairs.near_a[i]
            a1 = pairs.near_a[i + 1]
            a2 = pairs.near_a[i + 2]
            a3 = pairs.near_a[i + 3]
            b0 = pairs.near_b[i]
            b1 = pairs.near_b[i + 1]
            b2 = pairs.near_b[i + 2]
            b3 = pairs.near_b[i + 3]
            n1 = n + is_candidate(a0, b0, pairs)
            n2 = n1 + is_candidate(a1, b1, pairs)
            n3 = n2 + is_candidate(a2, b2, pairs)
            n4 = n3 + is_candidate(a3, b3, pairs)
            put(n, a0, b0, pairs)
            put(n1, a1, b1, pairs)
            put(n2, a2, b2, pairs)
            put(n3, a3, b3, pairs)
            n = n4
            i += 4
        while i < end:
            a = pairs.near_a[i]
            b = pairs.near_b[i]
            put(n, a, b, pairs)
            n += is_candidate(a, b, pairs)
            i += 1
        pairs.count[w] = n - start

    @kernel
    def update_pairs(
        tid,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
    ):
        """Candidate pairs of a world: those whose boxes, swept over the step, overlap.

        They are taken from the pairs whose boxes with margin overlap, which are kept. Where a swept box has left its
        box with margin, the shape is given a new one; all are, if most have left. All pairs are found anew then.
        """
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            first = model.shape_start[w]
            last = model.shape_start[w + 1]
            dt = motion.step_dt[w]
            # half the speculative distance on each side: a pair closer than it is found
            pad = 0.5 * motion.reach[w]

            left = 0
            for at in range(first, last):
                box = swept_box(at, dt, real(1.0), pad, model, state, motion)
                pairs.swept[at] = box
                outer = pairs.box[at]
                if not (box[0] >= outer[0] and box[1] >= outer[1] and box[2] <= outer[2] and box[3] <= outer[3]):
                    left += 1
            if left > 0:
                left = 0
                spare = SOON * (config.margin * model.length_scale[w])
                for at in range(first, last):
                    box = pairs.swept[at]
                    outer = pairs.box[at]
                    low = box[0] >= outer[0] + spare and box[1] >= outer[1] + spare
                    if not (low and -box[2] >= -outer[2] + spare and -box[3] >= -outer[3] + spare):
                        pairs.left[first + left] = at
                        left += 1
            if pairs.valid[w] == 0 or left > (last - first) // MOST:
                left = last - first
                for at in range(first, last):
                    pairs.left[at] = at
            if pairs.valid[w] == 0 or left > 0:
                margin = config.margin * model.length_scale[w] + REACH_GROWTH * pad
                for i in range(first, first + left):
                    shape = pairs.left[i]
                    v = motion.predicted[model.shape_body[shape]]
                    steps = real(PREDICT_STEPS)
                    if (v[0] * v[0] + v[1] * v[1]) * dt * dt > 1.1 * motion.reach[w] * motion.reach[w]:
                        steps = real(FAST_STEPS)
                    pairs.box[shape] = swept_box(shape, dt, steps, margin, model, state, motion)
                find_pairs(
                    w, model.cell_size[w], model, state, pairs,
                    pairs.near_a, pairs.near_b, pairs.near_count, pairs.shape_a, pairs.shape_b,
                )  # fmt: skip
            if state.flags[w] == 0:
                cull(w, pairs)

    return {"update_pairs": update_pairs}


@cache
def box_kernels(dtype: str) -> dict[str, Any]:
    """``bound_shapes`` and ``update_box_pairs``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Boxes = struct_type("boxes", dtype, BOXES)
    functions = pair_functions(dtype)
    shape_box, find_pairs = functions.shape_box, functions.find_pairs

    @kernel
    def bound_shapes(tid, launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes):
        """The box of each shape of a world, larger by the margin."""
        w = tid + launch.world_offset
        for shape in range(model.shape_start[w], model.shape_start[w + 1]):
            body = model.shape_body[shape]
            c = ti.cos(state.angle[body])
            s = ti.sin(state.angle[body])
            x = state.position[body]
            kind = model.shape_type[shape]
            center = model.shape_center[shape]
            radius = model.shape_radius[shape] + boxes.margin
            box = shape_box(shape, kind, center, c, s, x, model.vertex_start, model.vertices, radius)
            boxes.lower[shape] = vec2(box[0], box[1])
            boxes.upper[shape] = vec2(box[2], box[3])

    @kernel
    def update_box_pairs(tid, launch: t.Launch, model: t.Model, state: t.State, boxes: Boxes, pairs: t.Pairs):
        """Rebuild a world's pairs if a box left the one with margin, or a filter changed; else keep them.

        A world with a box that is not finite, or whose lower corner is not the lower one, has no pairs.
        """
        w = tid + launch.world_offset
        state.flags[w] = 0
        left = 0
        filters = ti.i64(1)
        smallest = real(0.0)
        farthest = real(0.0)
        good = 1
        first = model.shape_start[w]
        bodies = model.body_type.shape[0]
        for shape in range(first, model.shape_start[w + 1]):
            low = boxes.lower[shape]
            high = boxes.upper[shape]
            body = model.shape_body[shape]
            far = ti.max(ti.max(ti.abs(low[0]), ti.abs(low[1])), ti.max(ti.abs(high[0]), ti.abs(high[1])))
            ordered = low[0] <= high[0] and low[1] <= high[1]
            if not ordered or not (far - far == 0.0) or body < 0 or body >= bodies:
                good = 0
            else:
                outer = pairs.box[shape]
                if not (low[0] >= outer[0] and low[1] >= outer[1] and high[0] <= outer[2] and high[1] <= outer[3]):
                    pairs.left[first + left] = shape
                    left += 1
                extent = ti.max(high[0] - low[0], high[1] - low[1])
                if shape == first or extent < smallest:
                    smallest = extent
                farthest = ti.max(farthest, far)
                kinds = (ti.i64(model.shape_category[shape]) << ti.i64(32)) | ti.i64(model.shape_mask[shape])
                filters = (filters ^ kinds) * ti.i64(MIX)
                filters = (filters ^ (ti.i64(body) * ti.i64(4) + ti.i64(model.body_type[body]))) * ti.i64(MIX)
        if good == 0:
            state.flags[w] = INVALID
            pairs.valid[w] = 0
            pairs.count[w] = 0
        elif left > 0 or pairs.valid[w] == 0 or filters != boxes.filters[w]:
            last = model.shape_start[w + 1]
            if pairs.valid[w] == 0 or filters != boxes.filters[w] or left > (last - first) // MOST:
                left = last - first
                for shape in range(first, last):
                    pairs.left[shape] = shape
            boxes.filters[w] = filters
            margin = boxes.margin
            for i in range(first, first + left):
                shape = pairs.left[i]
                low = boxes.lower[shape]
                high = boxes.upper[shape]
                pairs.box[shape] = vec4(low[0] - margin, low[1] - margin, high[0] + margin, high[1] + margin)
            size = ti.max(smallest + 2.0 * margin, (farthest + margin) * real(FINEST))
            find_pairs(
                w, ti.max(size, real(TINY)), model, state, pairs,
                pairs.shape_a, pairs.shape_b, pairs.count, pairs.near_a, pairs.near_b,
            )  # fmt: skip

    return {"bound_shapes": bound_shapes, "update_box_pairs": update_box_pairs}
