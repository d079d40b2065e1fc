"""Points sorted by line, then column, then index: by counting where there are few, else by their bits.

The scratch is taken as one row of numbers: two keys and two values that are sorted, the line of each point, its column
and index in one number, and two counts, each for as many points as the scratch has rows.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.neighbors.fields import CELLS

CELL_SLACK = 2.0**-16
MAX_CELLS = 2.0**30
SPARE = 2  # up to so many lines for a point are counted, more are sorted by key; columns alike
FEW = 32  # numbers that are sorted by insertion
COLUMN = 32  # bits below the column in the number of a point
VALUE, LINE, RECORD, COUNT = 2, 4, 5, 6  # where these begin in the scratch, in rows


@cache
def sort_functions(dtype: str, dim: int) -> SimpleNamespace:
    """``sort_world``, which sorts the points of a world into ``cells``."""
    Cells = struct_type("cells", dtype, CELLS)
    corner = ti.types.vector(dim, ti.f64)

    @ti.func
    def bits_of(last):
        bits = 1
        while bits < 63 and (last >> ti.cast(bits, ti.i64)) != 0:
            bits += 1
        return bits

    @ti.func
    def sort_keys(m, bits, rows, scratch: ti.template()):
        """Sort m keys below 2^bits with their values; where in both the result begins."""
        start = 0
        value = VALUE * rows
        if m <= FEW:
            for i in range(1, m):
                k = scratch[0, i]
                v = scratch[0, value + i]
                j = i
                while j > 0 and scratch[0, j - 1] > k:
                    scratch[0, j] = scratch[0, j - 1]
                    scratch[0, value + j] = scratch[0, value + j - 1]
                    j -= 1
                scratch[0, j] = k
                scratch[0, value + j] = v
        else:
            digit = ti.select(m < 4096, 8, 11)
            mask = (ti.i64(1) << ti.cast(digit, ti.i64)) - 1
            size = 1 << digit
            digits = COUNT * rows
            shift = 0
            while shift < bits:
                by = ti.cast(shift, ti.i64)
                to = rows - start
                for d in range(size):
                    scratch[0, digits + d] = 0
                for i in range(m):
                    at = digits + ti.cast((scratch[0, start + i] >> by) & mask, ti.i32)
                    scratch[0, at] = scratch[0, at] + 1
                sum = ti.i64(0)
                for d in range(size):
                    c = scratch[0, digits + d]
                    scratch[0, digits + d] = sum
                    sum += c
                for i in range(m):
                    k = scratch[0, start + i]
                    at = digits + ti.cast((k >> by) & mask, ti.i32)
                    slot = ti.cast(scratch[0, at], ti.i32)
                    scratch[0, at] = scratch[0, at] + 1
                    scratch[0, to + slot] = k
                    scratch[0, value + to + slot] = scratch[0, value + start + i]
                start = to
                shift += digit
        return start

    @ti.func
    def cell(point: ti.template(), i, a, low: ti.template(), inverse: ti.template()):
        return ti.cast((ti.cast(point[i, a], ti.f64) - low[a]) * inverse[a], ti.i32)

    @ti.func
    def find_lines(
        w,
        first,
        m,
        layer,
        lines,
        point: ti.template(),
        low: ti.template(),
        inverse: ti.template(),
        scratch: ti.template(),
        cells: Cells,
    ):
        """Give each point its line, and each line its first point; the number of lines."""
        rows = scratch.shape[0]
        line = LINE * rows
        count = COUNT * rows
        used = 0
        counted = lines <= ti.cast(SPARE * rows, ti.i64)
        if counted:
            for k in range(ti.cast(lines, ti.i32)):
                scratch[0, count + k] = 0
        for i in range(m):
            k = ti.cast(cell(point, first + i, 1, low, inverse), ti.i64)
            if ti.static(dim == 3):
                k = ti.cast(cell(point, first + i, 2, low, inverse), ti.i64) * layer + k
            if counted:
                scratch[0, line + i] = k
                at = count + ti.cast(k, ti.i32)
                scratch[0, at] = scratch[0, at] + 1
            else:
                scratch[0, i] = k
                scratch[0, VALUE * rows + i] = ti.cast(i, ti.i64)
        if counted:
            sum = ti.i64(0)
            for k in range(ti.cast(lines, ti.i32)):
                c = scratch[0, count + k]
                scratch[0, count + k] = sum
                if c != 0:
                    cells.line_key[first + used] = ti.cast(k, ti.i64)
                    cells.line_start[first + w + used] = first + ti.cast(sum, ti.i32)
                    used += 1
                sum += c
        else:
            at = sort_keys(m, bits_of(lines - 1), rows, scratch)
            before = ti.i64(-1)
            for i in range(m):
                k = scratch[0, at + i]
                if k != before:
                    cells.line_key[first + used] = k
                    scratch[0, count + used] = ti.cast(i, ti.i64)
                    cells.line_start[first + w + used] = first + i
                    used += 1
                before = k
                scratch[0, line + ti.cast(scratch[0, VALUE * rows + at + i], ti.i32)] = ti.cast(used - 1, ti.i64)
        cells.line_start[first + w + used] = first + m
        return used

    @ti.func
    def put(at, record, first, point: ti.template(), cells: Cells):
        """Store a point in the order of the cells."""
        i = first + ti.cast(record & ti.i64(0xFFFFFFFF), ti.i32)
        for a in ti.static(range(dim)):
            cells.place[a, at] = point[i, a]
        cells.number[at] = i
        cells.column[at] = ti.cast(record >> ti.i64(COLUMN), ti.i32)

    @ti.func
    def sort_line(begin, size, first, point: ti.template(), scratch: ti.template(), cells: Cells):
        """Sort the points of a line by their columns."""
        rows = scratch.shape[0]
        count = COUNT * rows
        records = RECORD * rows + begin - first
        least = scratch[0, records] >> ti.i64(COLUMN)
        most = least
        for i in range(1, size):
            c = scratch[0, records + i] >> ti.i64(COLUMN)
            least = ti.min(least, c)
            most = ti.max(most, c)
        columns = most - least + 1
        if size > 16 and columns <= ti.cast(SPARE * ti.min(size, rows), ti.i64):
            for c in range(ti.cast(columns, ti.i32)):
                scratch[0, count + c] = 0
            for i in range(size):
                at = count + ti.cast((scratch[0, records + i] >> ti.i64(COLUMN)) - least, ti.i32)
                scratch[0, at] = scratch[0, at] + 1
            sum = ti.i64(begin)
            for c in range(ti.cast(columns, ti.i32)):
                n = scratch[0, count + c]
                scratch[0, count + c] = sum
                sum += n
            for i in range(size):
                record = scratch[0, records + i]
                at = count + ti.cast((record >> ti.i64(COLUMN)) - least, ti.i32)
                slot = ti.cast(scratch[0, at], ti.i32)
                scratch[0, at] = scratch[0, at] + 1
                put(slot, record, first, point, cells)
        else:
            for i in range(size):
                record = scratch[0, records + i]
                scratch[0, i] = (record >> ti.i64(COLUMN)) - least
                scratch[0, VALUE * rows + i] = record
            at = sort_keys(size, bits_of(most - least), rows, scratch)
            for i in range(size):
                put(begin + i, scratch[0, VALUE * rows + at + i], first, point, cells)

    @ti.func
    def sort_world(
        w, reach, point: ti.template(), lower: ti.template(), upper: ti.template(), scratch: ti.template(), cells: Cells
    ):
        """Sort the points of a world; one whose box is not finite is left without lines."""
        first = cells.start[w]
        m = cells.start[w + 1] - first
        cells.line_count[w] = 0
        cells.line_stride[w] = ti.i64(0)
        bounded = m > 0
        low = corner(0.0)
        inverse = corner(0.0)
        lines = ti.i64(1)
        layer = ti.i64(0)
        for a in ti.static(range(dim)):
            extent = upper[w, a] - lower[w, a]
            if not extent - extent == 0.0:
                bounded = False
            else:
                low[a] = lower[w, a]
                inverse[a] = 1.0 / ti.max(reach * (1.0 + CELL_SLACK), extent / MAX_CELLS)
                across = ti.cast(extent * inverse[a], ti.i64) + 1
                if ti.static(a > 0):
                    lines = lines * across
                if ti.static(dim == 3 and a == 1):
                    # an empty row behind each layer: the neighbouring keys of a layer's end rows belong to nobody
                    layer = across + 1
                    lines = layer
        if bounded:
            used = find_lines(w, first, m, layer, lines, point, low, inverse, scratch, cells)
            cells.line_count[w] = used
            cells.line_stride[w] = layer
            rows = scratch.shape[0]
            for i in range(m):
                at = COUNT * rows + ti.cast(scratch[0, LINE * rows + i], ti.i32)
                slot = ti.cast(scratch[0, at], ti.i32)
                scratch[0, at] = scratch[0, at] + 1
                column = ti.cast(cell(point, first + i, 0, low, inverse), ti.i64)
                scratch[0, RECORD * rows + slot] = (column << ti.i64(COLUMN)) | ti.cast(i, ti.i64)
            for k in range(used):
                begin = cells.line_start[first + w + k]
                sort_line(begin, cells.line_start[first + w + k + 1] - begin, first, point, scratch, cells)

    return SimpleNamespace(sort_world=sort_world)
