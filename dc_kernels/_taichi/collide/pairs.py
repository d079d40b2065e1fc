"""Pairs of boxes by a sorted cell list, and the boxes of shapes.

A box lies in the cell of its centre, on the level whose cells are just larger than it (cells double from level to
level), so that sizes may differ by any ratio: a box looks at the 3 x 3 cells around it on its own level and at the few
cells of coarser levels that it can touch.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.common import rotate
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.enums import BodyType, Flag, ShapeType

STATIC = int(BodyType.STATIC)
DYNAMIC = int(BodyType.DYNAMIC)
SEGMENT = int(ShapeType.SEGMENT)
DISC = int(ShapeType.DISC)
PAIR_OVERFLOW = int(Flag.PAIR_OVERFLOW)
MAX_LEVEL = 62
LARGE_LEVEL = 3  # shapes on this level and above, if they are few, are tested one by one:
MAX_LARGE = 16  # a pile's three walls cost a rebuild a quarter of its time as cells
FINE_LEVELS = (1 << 3) - 1  # bits of the levels below LARGE_LEVEL


@ti.func
def bucket_of(cx, cy, level, mask):
    """Neighbouring cells of a row lie in neighbouring buckets; rows and levels are spread by odd strides."""
    return (cx + cy * 7919 + level * 104729) & mask


@ti.func
def overlaps(p, q):
    """Whether two boxes, (low x, low y, high x, high y), have a point in common."""
    return not ((p[0] > q[2]) | (q[0] > p[2]) | (p[1] > q[3]) | (q[1] > p[3]))  # all four, without a branch


@ti.func
def count_keys(n, shapes, first_shape, first_pair, table, bucket: ti.template(), key: ti.template()):
    """First half of a counting sort of pairs by the shapes ``key``: where those of each shape will begin."""
    for i in range(shapes + 1):
        bucket[table + i] = 0
    for i in range(first_pair, first_pair + n):
        at = table + key[i] - first_shape + 1
        bucket[at] = bucket[at] + 1
    for i in range(shapes):
        bucket[table + i + 1] = bucket[table + i + 1] + bucket[table + i]


@ti.func
def move_pairs(
    n,
    first_shape,
    first_pair,
    table,
    bucket: ti.template(),
    key: ti.template(),
    in_a: ti.template(),
    in_b: ti.template(),
    out_a: ti.template(),
    out_b: ti.template(),
):
    """Second half: each pair to its place; pairs of one shape keep their order."""
    for i in range(first_pair, first_pair + n):
        s = key[i]
        slot = bucket[table + s - first_shape]
        bucket[table + s - first_shape] = slot + 1
        out_a[first_pair + slot] = in_a[i]
        out_b[first_pair + slot] = in_b[i]


@cache
def pair_functions(dtype: str) -> SimpleNamespace:
    """``shape_box``, and ``find_pairs``, which finds the pairs of boxes, whatever they are the boxes of."""
    t = group_types(dtype)
    vec4 = t.vec4

    @ti.func
    def shape_box(shape, kind, center, c, s, x, vertex_start: ti.template(), vertices: ti.template(), radius):
        """Tight box of a shape, as (low x, low y, high x, high y)."""
        box = vec4(0.0, 0.0, 0.0, 0.0)
        if kind == DISC:
            p = x + rotate(c, s, center)
            box = vec4(p[0] - radius, p[1] - radius, p[0] + radius, p[1] + radius)
        else:
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
                q = rotate(c, s, vertices[i])
                lx = ti.min(lx, q[0])
                ly = ti.min(ly, q[1])
                hx = ti.max(hx, q[0])
                hy = ti.max(hy, q[1])
            box = vec4(x[0] + lx - radius, x[1] + ly - radius, x[0] + hx + radius, x[1] + hy + radius)
        return box

    @ti.func
    def may_collide(a, b, model: t.Model):
        """Whether two shapes' bodies differ, one of them is dynamic, and both filters agree."""
        i = model.shape_body[a]
        j = model.shape_body[b]
        return (
            i != j
            and (model.body_type[i] == DYNAMIC or model.body_type[j] == DYNAMIC)
            and (model.shape_category[a] & model.shape_mask[b]) != ti.u32(0)
            and (model.shape_category[b] & model.shape_mask[a]) != ti.u32(0)
        )

    @ti.func
    def emit(count, capacity, first, a, b, model: t.Model, out_a: ti.template(), out_b: ti.template()):
        """Store a pair, A static or the lower index; counts on when full so that the host knows what is needed."""
        if count < capacity:
            lo = ti.min(a, b)
            hi = ti.max(a, b)
            if model.body_type[model.shape_body[hi]] == STATIC:
                out_a[first + count] = hi
                out_b[first + count] = lo
            else:
                out_a[first + count] = lo
                out_b[first + count] = hi
        return count + 1

    @ti.func
    def find_pairs(
        w,
        size,
        model: t.Model,
        state: t.State,
        pairs: t.Pairs,
        near_a: ti.template(),
        near_b: ti.template(),
        near_count: ti.template(),
        more_a: ti.template(),
        more_b: ti.template(),
    ):
        """Pairs of a world's shapes whose boxes ``pairs.box`` overlap, sorted by (A, B), into ``near_a``, ``near_b``.

        ``size``: side of the finest cells [m]; ``more_a`` and ``more_b`` are scratch.
        """
        pairs.rebuilds[w] = pairs.rebuilds[w] + 1
        first = model.shape_start[w]
        last = model.shape_start[w + 1]
        table = pairs.bucket_start[w]
        mask = pairs.bucket_start[w + 1] - table - 2
        for i in range(table, table + mask + 2):
            pairs.bucket[i] = 0
        levels = ti.i64(0)
        large = ti.Vector([0] * 16)
        large_count = 0
        for shape in range(first, last):
            outer = pairs.box[shape]
            extent = ti.max(outer[2] - outer[0], outer[3] - outer[1])
            level = 0
            side = size
            while side < extent and level < MAX_LEVEL:
                side = side * 2.0
                level += 1
            levels = levels | (ti.i64(1) << ti.i64(level))
            if level >= LARGE_LEVEL:
                if large_count < MAX_LARGE:
                    large[large_count] = shape
                large_count += 1
            cx = ti.i32(ti.floor(0.5 * (outer[0] + outer[2]) / side))
            cy = ti.i32(ti.floor(0.5 * (outer[1] + outer[3]) / side))
            pairs.cell[shape, 0] = cx
            pairs.cell[shape, 1] = cy
            pairs.cell[shape, 2] = level
            at = table + bucket_of(cx, cy, level, mask) + 1
            pairs.bucket[at] = pairs.bucket[at] + 1
        for i in range(table, table + mask + 1):
            pairs.bucket[i + 1] = pairs.bucket[i + 1] + pairs.bucket[i]
        # fill from the back: bucket[i] then is the first entry of bucket i, entries in the order of their index
        back = last - 1
        while back >= first:
            slot = table + bucket_of(pairs.cell[back, 0], pairs.cell[back, 1], pairs.cell[back, 2], mask) + 1
            pairs.bucket[slot] = pairs.bucket[slot] - 1
            pairs.sorted_shape[first + pairs.bucket[slot]] = back
            back -= 1

        # the highest level that is looked up by cells
        top = MAX_LEVEL
        if large_count <= MAX_LARGE:
            top = LARGE_LEVEL - 1
            levels = levels & ti.i64(FINE_LEVELS)

        first_pair = pairs.start[w]
        capacity = pairs.start[w + 1] - first_pair
        n = 0
        shapes = last - first
        for shape in range(first, last):
            own_x = pairs.cell[shape, 0]
            own_y = pairs.cell[shape, 1]
            level = pairs.cell[shape, 2]
            outer = pairs.box[shape]
            if top < MAX_LEVEL:
                for i in range(large_count):
                    other = large[i]
                    if level <= top or other > shape:
                        if overlaps(outer, pairs.box[other]) and may_collide(shape, other, model):
                            n = emit(n, capacity, first_pair, shape, other, model, more_a, more_b)
            # own level: the forward half of the 3 x 3 cells, so that each pair is met once
            cells = 5
            if level > top:
                cells = 0
            for step in range(cells):
                cx = own_x
                cy = own_y
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
                        if overlaps(outer, pairs.box[other]):
                            if pairs.cell[other, 0] == cx and pairs.cell[other, 1] == cy:
                                if pairs.cell[other, 2] == level and may_collide(shape, other, model):
                                    n = emit(n, capacity, first_pair, shape, other, model, more_a, more_b)
            # coarser levels: every cell whose shapes' boxes can reach this one
            above = ti.i64(0)
            if level <= top:
                above = levels >> ti.i64(level + 1)
            side = size
            for _ in range(level):
                side = side * 2.0
            upper = level
            while above != ti.i64(0):
                upper += 1
                side = side * 2.0
                if (above & ti.i64(1)) != ti.i64(0):
                    half = 0.5 * side
                    x0 = ti.i32(ti.floor((outer[0] - half) / side))
                    x1 = ti.i32(ti.floor((outer[2] + half) / side))
                    y0 = ti.i32(ti.floor((outer[1] - half) / side))
                    y1 = ti.i32(ti.floor((outer[3] + half) / side))
                    for cy in range(y0, y1 + 1):
                        for cx in range(x0, x1 + 1):
                            at = bucket_of(cx, cy, upper, mask)
                            end = shapes
                            if at < mask:
                                end = pairs.bucket[table + at + 2]
                            for k in range(pairs.bucket[table + at + 1], end):
                                other = pairs.sorted_shape[first + k]
                                if pairs.cell[other, 0] == cx and pairs.cell[other, 1] == cy:
                                    if pairs.cell[other, 2] == upper and overlaps(outer, pairs.box[other]):
                                        if may_collide(shape, other, model):
                                            n = emit(n, capacity, first_pair, shape, other, model, more_a, more_b)
                above = above >> ti.i64(1)
        pairs.needed[w] = n
        if n > capacity:
            state.flags[w] = state.flags[w] | PAIR_OVERFLOW
            pairs.valid[w] = 0
            near_count[w] = 0
        else:
            # by shape B, then by shape A
            count_keys(n, shapes, first, first_pair, table, pairs.bucket, more_b)
            move_pairs(n, first, first_pair, table, pairs.bucket, more_b, more_a, more_b, pairs.temp_a, pairs.temp_b)
            count_keys(n, shapes, first, first_pair, table, pairs.bucket, pairs.temp_a)
            move_pairs(
                n, first, first_pair, table, pairs.bucket, pairs.temp_a, pairs.temp_a, pairs.temp_b, near_a, near_b
            )
            near_count[w] = n
            pairs.valid[w] = 1

    return SimpleNamespace(shape_box=shape_box, find_pairs=find_pairs)
