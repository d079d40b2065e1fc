"""Sorted cell list: boxes -> candidate pairs, kept while no box leaves its margin.

A shape lies in the cell of its box's centre, on the level whose cells are just larger than its box
(cells double from level to level), so that sizes may differ by any ratio: a shape looks at the 3 x 3
cells around it on its own level and at the few cells of coarser levels that its box can touch.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate, scalar_types
from dc_kernels.model.enums import BodyType, Flag, ShapeType

STATIC = wp.constant(int(BodyType.STATIC))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
DISC = wp.constant(int(ShapeType.DISC))
PAIR_OVERFLOW = wp.constant(int(Flag.PAIR_OVERFLOW))
PREDICT_STEPS = wp.constant(8.0)  # steps of motion a moving shape's box is stretched by; 2 to 16 cost the same
FAST_STEPS = wp.constant(24.0)  # the same for the few that outrun the world's speculative distance
REACH_GROWTH = wp.constant(1.5)  # a box made for a speculative distance this much larger outlives bodies speeding up
MAX_LEVEL = wp.constant(62)
LARGE_LEVEL = wp.constant(3)  # shapes on this level and above, if they are few, are tested one by one:
MAX_LARGE = wp.constant(16)  # a pile's three walls cost a rebuild a quarter of its time as cells
FINE_LEVELS = wp.constant(wp.int64((1 << 3) - 1))  # bits of the levels below LARGE_LEVEL
Large = wp.types.vector(16, wp.int32)


@wp.func
def bucket_of(cx: int, cy: int, level: int, mask: int):
    """Neighbouring cells of a row lie in neighbouring buckets; rows and levels are spread by odd strides."""
    return (cx + cy * 7919 + level * 104729) & mask


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``update_pairs``; one thread a world."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("broadphase", dtype)

    @wp.func(module=module)
    def shape_box(
        shape: int,
        kind: int,
        center: vec2,
        c: real,
        s: real,
        x: vec2,
        vertex_start: wp.array(dtype=wp.int32),
        vertices: wp.array(dtype=vec2),
        radius: real,
    ):
        """Tight box of a shape, as (low x, low y, high x, high y)."""
        if kind == DISC:
            p = x + rotate(c, s, center)
            return vec4(p[0] - radius, p[1] - radius, p[0] + radius, p[1] + radius)
        first = vertex_start[shape]
        last = vertex_start[shape + 1]
        if kind == SEGMENT:
            last = first + 2
        p = rotate(c, s, vertices[first])
        lx = p[0]
        ly = p[1]
        hx = p[0]
        hy = p[1]
        for i in range(first + 1, last):
            p = rotate(c, s, vertices[i])
            lx = wp.min(lx, p[0])
            ly = wp.min(ly, p[1])
            hx = wp.max(hx, p[0])
            hy = wp.max(hy, p[1])
        return vec4(x[0] + lx - radius, x[1] + ly - radius, x[0] + hx + radius, x[1] + hy + radius)

    @wp.func(module=module)
    def spin_arm(kind: int, center: vec2, extent: real):
        """Bound on the distance from the centre of mass of what a rotation moves."""
        arm = wp.abs(center[0]) + wp.abs(center[1])
        if kind != DISC:
            arm += extent
        return arm

    @wp.func(module=module)
    def accepts(
        a: int,
        b: int,
        box: wp.array(dtype=vec4),
        shape_body: wp.array(dtype=wp.int32),
        body_type: wp.array(dtype=wp.int32),
        shape_category: wp.array(dtype=wp.uint32),
        shape_mask: wp.array(dtype=wp.uint32),
    ):
        """Boxes overlap, bodies differ, one of them is dynamic, and both filters agree."""
        p = box[a]
        q = box[b]
        if p[0] > q[2] or q[0] > p[2] or p[1] > q[3] or q[1] > p[3]:
            return False
        i = shape_body[a]
        j = shape_body[b]
        if i == j or (body_type[i] != DYNAMIC and body_type[j] != DYNAMIC):
            return False
        if (shape_category[a] & shape_mask[b]) == wp.uint32(0) or (shape_category[b] & shape_mask[a]) == wp.uint32(0):
            return False
        return True

    @wp.func(module=module)
    def emit(
        count: int,
        capacity: int,
        first: int,
        a: int,
        b: int,
        shape_body: wp.array(dtype=wp.int32),
        body_type: wp.array(dtype=wp.int32),
        pair_a: wp.array(dtype=wp.int32),
        pair_b: wp.array(dtype=wp.int32),
    ):
        """Store a pair, A static or the lower index; counts on when full so that the host knows what is needed."""
        if count < capacity:
            lo = wp.min(a, b)
            hi = wp.max(a, b)
            if body_type[shape_body[hi]] == STATIC:
                pair_a[first + count] = hi
                pair_b[first + count] = lo
            else:
                pair_a[first + count] = lo
                pair_b[first + count] = hi
        return count + 1

    @wp.func(module=module)
    def counting_sort(
        n: int,
        shapes: int,
        shape_first: int,
        pair_first: int,
        bucket_first: int,
        by_b: bool,
        bucket: wp.array(dtype=wp.int32),
        in_a: wp.array(dtype=wp.int32),
        in_b: wp.array(dtype=wp.int32),
        out_a: wp.array(dtype=wp.int32),
        out_b: wp.array(dtype=wp.int32),
    ):
        """Stable sort of pairs by one of their shapes."""
        for i in range(shapes + 1):
            bucket[bucket_first + i] = 0
        for i in range(pair_first, pair_first + n):
            s = in_a[i]
            if by_b:
                s = in_b[i]
            bucket[bucket_first + s - shape_first + 1] += 1
        for i in range(shapes):
            bucket[bucket_first + i + 1] += bucket[bucket_first + i]
        for i in range(pair_first, pair_first + n):
            s = in_a[i]
            if by_b:
                s = in_b[i]
            slot = bucket[bucket_first + s - shape_first]
            bucket[bucket_first + s - shape_first] = slot + 1
            out_a[pair_first + slot] = in_a[i]
            out_b[pair_first + slot] = in_b[i]

    @wp.kernel(module=module, enable_backward=False)
    def update_pairs(
        world_offset: int,
        margin_factor: real,
        # Model:
        shape_start: wp.array(dtype=wp.int32),
        length_scale: wp.array(dtype=real),
        cell_size: wp.array(dtype=real),
        body_type: wp.array(dtype=wp.int32),
        shape_body: wp.array(dtype=wp.int32),
        shape_type: wp.array(dtype=wp.int32),
        shape_radius: wp.array(dtype=real),
        shape_center: wp.array(dtype=vec2),
        shape_extent: wp.array(dtype=real),
        shape_category: wp.array(dtype=wp.uint32),
        shape_mask: wp.array(dtype=wp.uint32),
        vertex_start: wp.array(dtype=wp.int32),
        vertices: wp.array(dtype=vec2),
        # State in:
        position: wp.array(dtype=vec2),
        angle: wp.array(dtype=real),
        flags: wp.array(dtype=wp.int32),
        step_dt: wp.array(dtype=real),
        reach: wp.array(dtype=real),
        predicted: wp.array(dtype=vec4),
        # Scratch:
        bucket_start: wp.array(dtype=wp.int32),
        bucket: wp.array(dtype=wp.int32),
        cell: wp.array(dtype=wp.vec3i),
        sorted_shape: wp.array(dtype=wp.int32),
        temp_a: wp.array(dtype=wp.int32),
        temp_b: wp.array(dtype=wp.int32),
        # Pairs in, out:
        pair_valid: wp.array(dtype=wp.int32),
        rebuilds: wp.array(dtype=wp.int32),
        box: wp.array(dtype=vec4),
        pair_start: wp.array(dtype=wp.int32),
        pair_count: wp.array(dtype=wp.int32),
        pair_needed: wp.array(dtype=wp.int32),
        pair_a: wp.array(dtype=wp.int32),
        pair_b: wp.array(dtype=wp.int32),
    ):
        """Rebuild a world's pairs if a shape, swept over the step, left its box; else keep them."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        first = shape_start[w]
        last = shape_start[w + 1]
        dt = step_dt[w]
        # half the speculative distance on each side: a pair closer than it is found
        pad = real(0.5) * reach[w]

        keep = pair_valid[w]
        shape = first
        while keep == 1 and shape < last:
            body = shape_body[shape]
            v = predicted[body]
            x = position[body]
            kind = shape_type[shape]
            r = shape_radius[shape]
            center = shape_center[shape]
            c = real(1.0)
            s = real(0.0)
            if kind != DISC or center[0] != real(0.0) or center[1] != real(0.0):
                c = wp.cos(angle[body])
                s = wp.sin(angle[body])
            tight = shape_box(shape, kind, center, c, s, x, vertex_start, vertices, r)
            grow = pad + wp.min(wp.abs(v[2] * dt), real(2.0)) * spin_arm(kind, center, shape_extent[shape])
            outer = box[shape]
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

        rebuilds[w] = rebuilds[w] + 1
        size = cell_size[w]
        margin = margin_factor * length_scale[w] + real(REACH_GROWTH) * pad
        table = bucket_start[w]
        mask = bucket_start[w + 1] - table - 2
        for i in range(table, table + mask + 2):
            bucket[i] = 0
        levels = wp.int64(0)
        large = Large()
        large_count = int(0)
        for shape in range(first, last):
            body = shape_body[shape]
            v = predicted[body]
            kind = shape_type[shape]
            center = shape_center[shape]
            c = real(1.0)
            s = real(0.0)
            if kind != DISC or center[0] != real(0.0) or center[1] != real(0.0):
                c = wp.cos(angle[body])
                s = wp.sin(angle[body])
            tight = shape_box(shape, kind, center, c, s, position[body], vertex_start, vertices, shape_radius[shape])
            arm = spin_arm(kind, center, shape_extent[shape])
            ahead = dt * real(PREDICT_STEPS)
            if (v[0] * v[0] + v[1] * v[1]) * dt * dt > real(1.1) * reach[w] * reach[w]:
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
            box[shape] = outer
            extent = wp.max(outer[2] - outer[0], outer[3] - outer[1])
            level = int(0)
            side = size
            while side < extent and level < MAX_LEVEL:
                side = side * real(2.0)
                level += 1
            levels = levels | (wp.int64(1) << wp.int64(level))
            if level >= LARGE_LEVEL:
                if large_count < MAX_LARGE:
                    large[large_count] = shape
                large_count += 1
            cx = int(wp.floor(real(0.5) * (outer[0] + outer[2]) / side))
            cy = int(wp.floor(real(0.5) * (outer[1] + outer[3]) / side))
            cell[shape] = wp.vec3i(cx, cy, level)
            bucket[table + bucket_of(cx, cy, level, mask) + 1] += 1
        for i in range(table, table + mask + 1):
            bucket[i + 1] += bucket[i]
        # fill from the back: bucket[i] then is the first entry of bucket i, entries in the order of their index
        shape = last - 1
        while shape >= first:
            q = cell[shape]
            slot = table + bucket_of(q[0], q[1], q[2], mask) + 1
            bucket[slot] -= 1
            sorted_shape[first + bucket[slot]] = shape
            shape -= 1

        # the highest level that is looked up by cells
        top = MAX_LEVEL
        if large_count <= MAX_LARGE:
            top = LARGE_LEVEL - 1
            levels = levels & FINE_LEVELS

        pairs = pair_start[w]
        capacity = pair_start[w + 1] - pairs
        n = int(0)
        shapes = last - first
        for shape in range(first, last):
            own = cell[shape]
            level = own[2]
            if top < MAX_LEVEL:
                for i in range(large_count):
                    other = large[i]
                    if (level <= top or other > shape) and accepts(
                        shape, other, box, shape_body, body_type, shape_category, shape_mask
                    ):
                        n = emit(n, capacity, pairs, shape, other, shape_body, body_type, pair_a, pair_b)
            # own level: the forward half of the 3 x 3 cells, so that each pair is met once
            cells = int(5)
            if level > top:
                cells = 0
            for step in range(cells):
                cx = own[0]
                cy = own[1]
                if step == 1:
                    cx += 1
                elif step > 1:
                    cx += step - 3
                    cy += 1
                at = bucket_of(cx, cy, level, mask)
                end = shapes
                if at < mask:
                    end = bucket[table + at + 2]
                for k in range(bucket[table + at + 1], end):
                    other = sorted_shape[first + k]
                    # the bucket may hold other cells too: most of those fail by their boxes already
                    if step > 0 or other > shape:
                        if accepts(shape, other, box, shape_body, body_type, shape_category, shape_mask):
                            q = cell[other]
                            if q[0] == cx and q[1] == cy and q[2] == level:
                                n = emit(n, capacity, pairs, shape, other, shape_body, body_type, pair_a, pair_b)
            # coarser levels: every cell whose shapes' boxes can reach this one
            above = wp.int64(0)
            if level <= top:
                above = levels >> wp.int64(level + 1)
            side = size
            for _ in range(level):
                side = side * real(2.0)
            outer = box[shape]
            upper = level
            while above != wp.int64(0):
                upper += 1
                side = side * real(2.0)
                if (above & wp.int64(1)) != wp.int64(0):
                    half = real(0.5) * side
                    x0 = int(wp.floor((outer[0] - half) / side))
                    x1 = int(wp.floor((outer[2] + half) / side))
                    y0 = int(wp.floor((outer[1] - half) / side))
                    y1 = int(wp.floor((outer[3] + half) / side))
                    for cy in range(y0, y1 + 1):
                        for cx in range(x0, x1 + 1):
                            at = bucket_of(cx, cy, upper, mask)
                            end = shapes
                            if at < mask:
                                end = bucket[table + at + 2]
                            for k in range(bucket[table + at + 1], end):
                                other = sorted_shape[first + k]
                                q = cell[other]
                                if q[0] == cx and q[1] == cy and q[2] == upper:
                                    if accepts(shape, other, box, shape_body, body_type, shape_category, shape_mask):
                                        n = emit(
                                            n, capacity, pairs, shape, other, shape_body, body_type, pair_a, pair_b
                                        )
                above = above >> wp.int64(1)
        pair_needed[w] = n
        if n > capacity:
            flags[w] = flags[w] | PAIR_OVERFLOW
            pair_valid[w] = 0
            return
        counting_sort(n, shapes, first, pairs, table, True, bucket, pair_a, pair_b, temp_a, temp_b)
        counting_sort(n, shapes, first, pairs, table, False, bucket, temp_a, temp_b, pair_a, pair_b)
        pair_count[w] = n
        pair_valid[w] = 1

    return {"update_pairs": update_pairs}
