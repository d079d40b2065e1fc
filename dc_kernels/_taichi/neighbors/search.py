"""Cells sorted by place and swept for neighbours, as in Warp's kernels, whose results in their order are found.

Candidates are tested eight at a time and stored one after the other without a branch, each over the one before if that
was too far. Warp's kernels take sixteen and go from one near candidate to the next by the bits of a number, which
Taichi has no word for: pairs take half as long again here, lists a tenth.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import scalar_types
from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.lanes import MASK, lane_functions
from dc_kernels._taichi.neighbors.sort import sort_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.neighbors.fields import CELLS
from dc_kernels.solve.rows import LANES

PADDING = 16  # points and entries behind the last, which Warp's lanes read and write
MAX_FOUND = 2**31 - 1  # a search stops above: the arrays could not be larger
SHORT = 64  # numbers of a list that are sorted by counting how many are less


@cache
def kernels(dtype: str, dim: int) -> dict[str, Any]:
    """``bound_points``, ``sort_points``, ``sweep_pairs``, ``sweep_lists``, ``order_lists``; one thread a launch.

    A launch takes ``worlds`` worlds from ``world_offset`` on, one after the other.
    """
    real = scalar_types(dtype).real
    Cells = struct_type("cells", dtype, CELLS)
    integers, longs = (ti.types.ndarray(dtype=kind, ndim=1) for kind in (ti.i32, ti.i64))
    values, pairs, doubles, tables = (ti.types.ndarray(dtype=kind, ndim=2) for kind in (real, ti.i32, ti.f64, ti.i64))
    sort_world = sort_functions(dtype, dim).sort_world
    # lines of cells that a sweep looks at beside its own: those ahead of it for pairs, all around it for lists
    ahead, around = (4, 9) if dim == 3 else (1, 3)
    infinity = float("inf")
    lanes, whole = lane_functions(dtype), ti.types.vector(LANES, ti.i32)
    vector, row8, line8 = lanes.vector, lanes.load_row, lanes.load_line

    @ti.func
    def lane():
        return whole(0, 1, 2, 3, 4, 5, 6, 7)

    @kernel
    def bound_points(
        tid,
        world_offset: ti.i32,
        worlds: ti.i32,
        fresh: ti.i32,
        start: integers,
        point: values,
        lower: doubles,
        upper: doubles,
    ):
        """Widen the box of each world by its points, from the empty one where ``fresh`` is 1.

        (inf, -inf) is the empty box, NaN that of points that are not finite.
        """
        for w in range(world_offset, world_offset + worlds):
            odd = real(0.0)  # what is not finite, minus itself, is not 0
            for a in ti.static(range(dim)):
                low = lower[w, a]
                high = upper[w, a]
                if fresh != 0:
                    low = ti.cast(infinity, ti.f64)
                    high = ti.cast(-infinity, ti.f64)
                for i in range(start[w], start[w + 1]):
                    x = ti.cast(point[i, a], ti.f64)
                    odd += point[i, a] - point[i, a]
                    low = ti.select(x < low, x, low)
                    high = ti.select(x > high, x, high)
                lower[w, a] = low
                upper[w, a] = high
            if not odd == 0.0:
                for a in ti.static(range(dim)):
                    lower[w, a] = ti.cast(odd - odd, ti.f64)
                    upper[w, a] = ti.cast(odd - odd, ti.f64)

    @kernel
    def sort_points(
        tid,
        world_offset: ti.i32,
        worlds: ti.i32,
        reach: ti.f64,
        point: values,
        lower: doubles,
        upper: doubles,
        scratch: tables,
        cells: Cells,
    ):
        """Sort points into cells of a side just above ``reach``."""
        for w in range(world_offset, world_offset + worlds):
            sort_world(w, reach, point, lower, upper, scratch, cells)

    @ti.func
    def near_lanes(own: ti.template(), j, last, limit, place: ti.template()):
        """1 for each of LANES sorted points from j on that is near a place, 0 for others and from ``last`` on."""
        at = j & MASK
        square = vector(0.0)
        for a in ti.static(range(dim)):
            d = row8(place, at) - own[a]
            if ti.static(a == 0):
                square = d * d
            else:
                square = square + d * d
            at = (at + place.shape[1]) & MASK
        found = ti.select(square <= limit, whole(1), whole(0))
        return ti.select(lane() < last - j, found, whole(0))

    @ti.func
    def place_of(i, place: ti.template()):
        own = ti.Vector([real(0.0)] * dim)
        for a in ti.static(range(dim)):
            own[a] = place[a, i]
        return own

    @kernel
    def sweep_pairs(tid, world_offset: ti.i32, worlds: ti.i32, limit: real, cells: Cells, found: longs, pair: pairs):
        """Find pairs at most sqrt(limit) apart, world by world; count on when there is no room.

        All are stored if those found and PADDING more have room.
        """
        out = ti.i64(0)
        room = ti.cast(pair.shape[0] - PADDING, ti.i64)
        for w in range(world_offset, world_offset + worlds):
            before = out
            first = cells.start[w]
            lines = cells.line_count[w]
            layer = cells.line_stride[w]
            at = ti.Vector([0] * 4)
            for line in range(lines):
                a0 = cells.line_start[first + w + line]
                a1 = cells.line_start[first + w + line + 1]
                for step in range(ahead + 1):
                    b0 = a0
                    b1 = a1
                    if step > 0:
                        wanted = cells.line_key[first + line] + 1
                        if step > 1:
                            wanted += layer + ti.cast(step - 4, ti.i64)
                        k = at[step - 1]
                        while k < lines and cells.line_key[first + k] < wanted:
                            k += 1
                        at[step - 1] = k
                        b1 = b0
                        if k < lines and cells.line_key[first + k] == wanted:
                            b0 = cells.line_start[first + w + k]
                            b1 = cells.line_start[first + w + k + 1]
                    if b1 > b0 and out <= MAX_FOUND:
                        for i in range(a0, a1):
                            own = place_of(i, cells.place)
                            mine = cells.number[i]
                            c = cells.column[i]
                            j = i + 1
                            if step > 0:
                                while b0 < b1 and cells.column[b0] < c - 1:
                                    b0 += 1
                                j = b0
                            while j < b1 and cells.column[j] <= c + 1:
                                found_here = near_lanes(own, j, b1, limit, cells.place)
                                other = line8(cells.number, j)
                                low = ti.min(other, mine)
                                high = ti.max(other, mine)
                                count = 0
                                if out <= room:
                                    # all are stored without a branch, each where the one before was if that was far
                                    to = ti.cast(out, ti.i32)
                                    for k in ti.static(range(LANES)):
                                        pair[to + count, 0] = low[k]
                                        pair[to + count, 1] = high[k]
                                        count += found_here[k]
                                else:
                                    for k in ti.static(range(LANES)):
                                        count += found_here[k]
                                out += ti.cast(count, ti.i64)
                                j += LANES
            found[w - world_offset] = out - before

    @kernel
    def sweep_lists(
        tid,
        world_offset: ti.i32,
        worlds: ti.i32,
        limit: real,
        queries: Cells,
        cells: Cells,
        list_span: tables,
        found: longs,
        entry: integers,
    ):
        """Find the points at most sqrt(limit) from each query, the lists in the order of the sorted queries.

        Of each query ``list_span`` is the first entry and the number. Counts on when there is no room; all are stored
        if those found and PADDING more have room.
        """
        out = ti.i64(0)
        room = ti.cast(entry.shape[0] - PADDING, ti.i64)
        for w in range(world_offset, world_offset + worlds):
            before = out
            first = cells.start[w]
            first_query = queries.start[w]
            lines = cells.line_count[w]
            layer = cells.line_stride[w]
            at = ti.Vector([0] * 16)
            begin = ti.Vector([0] * 16)
            end = ti.Vector([0] * 16)
            for line in range(queries.line_count[w]):
                near = 0
                for k in range(around):
                    wanted = queries.line_key[first_query + line] + ti.cast(k % 3 - 1, ti.i64)
                    wanted += ti.cast(k // 3 - around // 6, ti.i64) * layer
                    n = at[k]
                    while n < lines and cells.line_key[first + n] < wanted:
                        n += 1
                    at[k] = n
                    if n < lines and cells.line_key[first + n] == wanted:
                        begin[near] = cells.line_start[first + w + n]
                        end[near] = cells.line_start[first + w + n + 1]
                        near += 1
                for i in range(
                    queries.line_start[first_query + w + line], queries.line_start[first_query + w + line + 1]
                ):
                    if out <= MAX_FOUND:
                        own = place_of(i, queries.place)
                        c = queries.column[i]
                        mine = queries.number[i]
                        list_span[mine, 0] = out
                        whole = out
                        for k in range(near):
                            j = begin[k]
                            last = end[k]
                            while j < last and cells.column[j] < c - 1:
                                j += 1
                            begin[k] = j
                            while j < last and cells.column[j] <= c + 1:
                                found_here = near_lanes(own, j, last, limit, cells.place)
                                other = line8(cells.number, j)
                                count = 0
                                if out <= room:
                                    to = ti.cast(out, ti.i32)
                                    for n in ti.static(range(LANES)):
                                        entry[to + count] = other[n]
                                        count += found_here[n]
                                else:
                                    for n in ti.static(range(LANES)):
                                        count += found_here[n]
                                out += ti.cast(count, ti.i64)
                                j += LANES
                        list_span[mine, 1] = out - whole
            found[w - world_offset] = out - before

    @ti.func
    def sift(root, size, to, index: ti.template()):
        """Move a number of a heap down to where none above it is less."""
        moved = index[to + root]
        child = 2 * root + 1
        going = child < size
        at = root
        while going:
            if child + 1 < size and index[to + child + 1] > index[to + child]:
                child += 1
            if index[to + child] <= moved:
                going = False
            else:
                index[to + at] = index[to + child]
                at = child
                child = 2 * at + 1
                going = child < size
        index[to + at] = moved

    @kernel
    def order_lists(
        tid,
        query_offset: ti.i32,
        queries: ti.i32,
        list_span: tables,
        list_start: longs,
        entry: integers,
        index: integers,
    ):
        """Copy the lists in the order of the queries, each ascending."""
        for q in range(query_offset, query_offset + queries):
            m = ti.cast(list_start[q + 1] - list_start[q], ti.i32)
            begin = ti.cast(list_span[q, 0], ti.i32)
            to = ti.cast(list_start[q], ti.i32)
            if m <= SHORT:
                # a number's place is how many are less; all differ
                block = 0
                while block < m:
                    own = ti.Vector([0] * LANES)
                    less = ti.Vector([0] * LANES)
                    at = (begin + block) & MASK
                    for k in ti.static(range(LANES)):
                        own[k] = entry[at + k]
                    for i in range(begin, begin + m):
                        less = less + ti.select(own > entry[i], 1, 0)
                    for k in ti.static(range(LANES)):
                        if block + k < m:
                            index[to + less[k]] = own[k]
                    block += LANES
            else:
                for i in range(m):
                    index[to + i] = entry[begin + i]
                for i in range(m // 2):
                    sift(m // 2 - 1 - i, m, to, index)
                for i in range(m - 1):
                    size = m - 1 - i
                    greatest = index[to]
                    index[to] = index[to + size]
                    index[to + size] = greatest
                    sift(0, size, to, index)

    return {
        "bound_points": bound_points,
        "sort_points": sort_points,
        "sweep_pairs": sweep_pairs,
        "sweep_lists": sweep_lists,
        "order_lists": order_lists,
    }
