"""Pairs of boxes by a sorted cell list, and the boxes of shapes.

A box lies in the cell of its centre, on the level whose cells are just larger than it (cells double from level to
level), so that sizes may differ by any ratio: a box looks at the 3 x 3 cells around it on its own level and at the few
cells of coarser levels that it can touch.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate
from dc_kernels._warp.groups import group_types
from dc_kernels.model.enums import BodyType, Flag, ShapeType

STATIC = wp.constant(int(BodyType.STATIC))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
DISC = wp.constant(int(ShapeType.DISC))
PAIR_OVERFLOW = wp.constant(int(Flag.PAIR_OVERFLOW))
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
def pair_functions(dtype: str) -> SimpleNamespace:
    """``shape_box``, and ``find_pairs``, which finds the pairs of boxes, whatever they are the boxes of."""
    t = group_types(dtype)
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
    def overlaps(p: vec4, q: vec4):
        """Whether two boxes, (low x, low y, high x, high y), have a point in common."""
        if p[0] > q[2] or q[0] > p[2] or p[1] > q[3] or q[1] > p[3]:
            return False
        return True

    @wp.func(module=module)
    def may_collide(a: int, b: int, model: t.Model):
        """Whether two shapes' bodies differ, one of them is dynamic, and both filters agree."""
        i = model.shape_body[a]
        j = model.shape_body[b]
        if i == j or (model.body_type[i] != DYNAMIC and model.body_type[j] != DYNAMIC):
            return False
        if (model.shape_category[a] & model.shape_mask[b]) == wp.uint32(0):
            return False
        if (model.shape_category[b] & model.shape_mask[a]) == wp.uint32(0):
            return False
        return True

    @wp.func(module=module)
    def emit(count: int, capacity: int, first: int, a: int, b: int, model: t.Model, pairs: t.Pairs):
        """Store a pair, A static or the lower index; counts on when full so that the host knows what is needed."""
        if count < capacity:
            lo = wp.min(a, b)
            hi = wp.max(a, b)
            if model.body_type[model.shape_body[hi]] == STATIC:
                pairs.shape_a[first + count] = hi
                pairs.shape_b[first + count] = lo
            else:
                pairs.shape_a[first + count] = lo
                pairs.shape_b[first + count] = hi
        return count + 1

    @wp.func(module=module)
    def count_keys(
        n: int,
        shapes: int,
        first_shape: int,
        first_pair: int,
        table: int,
        bucket: wp.array(dtype=wp.int32),
        key: wp.array(dtype=wp.int32),
    ):
        """First half of a counting sort of pairs by the shapes ``key``: where those of each shape will begin."""
        for i in range(shapes + 1):
            bucket[table + i] = 0
        for i in range(first_pair, first_pair + n):
            bucket[table + key[i] - first_shape + 1] += 1
        for i in range(shapes):
            bucket[table + i + 1] += bucket[table + i]

    @wp.func(module=module)
    def move_pairs(
        n: int,
        first_shape: int,
        first_pair: int,
        table: int,
        bucket: wp.array(dtype=wp.int32),
        key: wp.array(dtype=wp.int32),
        in_a: wp.array(dtype=wp.int32),
        in_b: wp.array(dtype=wp.int32),
        out_a: wp.array(dtype=wp.int32),
        out_b: wp.array(dtype=wp.int32),
    ):
        """Second half: each pair to its place; pairs of one shape keep their order."""
        for i in range(first_pair, first_pair + n):
            s = key[i]
            slot = bucket[table + s - first_shape]
            bucket[table + s - first_shape] = slot + 1
            out_a[first_pair + slot] = in_a[i]
            out_b[first_pair + slot] = in_b[i]

    @wp.func(module=module)
    def sort_pairs(n: int, shapes: int, first_shape: int, first_pair: int, table: int, pairs: t.Pairs):
        """Sort a world's pairs by shape A, and by shape B among those of one A."""
        count_keys(n, shapes, first_shape, first_pair, table, pairs.bucket, pairs.shape_b)
        move_pairs(
            n, first_shape, first_pair, table, pairs.bucket, pairs.shape_b,
            pairs.shape_a, pairs.shape_b, pairs.temp_a, pairs.temp_b,
        )  # fmt: skip
        count_keys(n, shapes, first_shape, first_pair, table, pairs.bucket, pairs.temp_a)
        move_pairs(
            n, first_shape, first_pair, table, pairs.bucket, pairs.temp_a,
            pairs.temp_a, pairs.temp_b, pairs.shape_a, pairs.shape_b,
        )  # fmt: skip

    @wp.func(module=module)
    def find_pairs(w: int, size: real, model: t.Model, state: t.State, pairs: t.Pairs):
        """Pairs of a world's shapes whose boxes ``pairs.box`` overlap; ``size``: side of the finest cells [m]."""
        pairs.rebuilds[w] = pairs.rebuilds[w] + 1
        first = model.shape_start[w]
        last = model.shape_start[w + 1]
        table = pairs.bucket_start[w]
        mask = pairs.bucket_start[w + 1] - table - 2
        for i in range(table, table + mask + 2):
            pairs.bucket[i] = 0
        levels = wp.int64(0)
        large = Large()
        large_count = int(0)
        for shape in range(first, last):
            outer = pairs.box[shape]
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
            pairs.cell[shape] = wp.vec3i(cx, cy, level)
            pairs.bucket[table + bucket_of(cx, cy, level, mask) + 1] += 1
        for i in range(table, table + mask + 1):
            pairs.bucket[i + 1] += pairs.bucket[i]
        # fill from the back: bucket[i] then is the first entry of bucket i, entries in the order of their index
        shape = last - 1
        while shape >= first:
            q = pairs.cell[shape]
            slot = table + bucket_of(q[0], q[1], q[2], mask) + 1
            pairs.bucket[slot] -= 1
            pairs.sorted_shape[first + pairs.bucket[slot]] = shape
            shape -= 1

        # the highest level that is looked up by cells
        top = MAX_LEVEL
        if large_count <= MAX_LARGE:
            top = LARGE_LEVEL - 1
            levels = levels & FINE_LEVELS

        first_pair = pairs.start[w]
        capacity = pairs.start[w + 1] - first_pair
        n = int(0)
        shapes = last - first
        for shape in range(first, last):
            own = pairs.cell[shape]
            level = own[2]
            outer = pairs.box[shape]
            if top < MAX_LEVEL:
                for i in range(large_count):
                    other = large[i]
                    if level <= top or other > shape:
                        if overlaps(pairs.box[shape], pairs.box[other]) and may_collide(shape, other, model):
                            n = emit(n, capacity, first_pair, shape, other, model, pairs)
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
                    end = pairs.bucket[table + at + 2]
                for k in range(pairs.bucket[table + at + 1], end):
                    other = pairs.sorted_shape[first + k]
                    # the bucket may hold other cells too: most of those fail by their boxes already
                    if step > 0 or other > shape:
                        if overlaps(pairs.box[shape], pairs.box[other]):
                            q = pairs.cell[other]
                            if q[0] == cx and q[1] == cy and q[2] == level:
                                if may_collide(shape, other, model):
                                    n = emit(n, capacity, first_pair, shape, other, model, pairs)
            # coarser levels: every cell whose shapes' boxes can reach this one
            above = wp.int64(0)
            if level <= top:
                above = levels >> wp.int64(level + 1)
            side = size
            for _ in range(level):
                side = side * real(2.0)
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
                                end = pairs.bucket[table + at + 2]
                            for k in range(pairs.bucket[table + at + 1], end):
                                other = pairs.sorted_shape[first + k]
                                q = pairs.cell[other]
                                if q[0] == cx and q[1] == cy and q[2] == upper:
                                    if overlaps(pairs.box[shape], pairs.box[other]):
                                        if may_collide(shape, other, model):
                                            n = emit(n, capacity, first_pair, shape, other, model, pairs)
                above = above >> wp.int64(1)
        pairs.needed[w] = n
        if n > capacity:
            state.flags[w] = state.flags[w] | PAIR_OVERFLOW
            pairs.valid[w] = 0
            return
        sort_pairs(n, shapes, first, first_pair, table, pairs)
        pairs.count[w] = n
        pairs.valid[w] = 1

    return SimpleNamespace(shape_box=shape_box, find_pairs=find_pairs)
