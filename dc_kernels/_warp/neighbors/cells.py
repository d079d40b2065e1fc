"""Cells sorted by place, as native snippets for the CPU; ``sweeps`` finds neighbours in them.

Cells are squares (cubes) a little larger than the radius, so a point's neighbours lie in its own cell and the 8 (26)
around it. A line is the row of cells along x with one key (row, or layer and row); the points of a line are sorted by
their column. A sweep walks along a line and along a neighbouring one at once and tests LANES points at a time, from
the first column that can hold a neighbour to the last: there is no table of cells, so only occupied lines cost time
and memory, however wide the domain (Teschner et al. 2003 hash the cells for the same end; Green 2010 sorts them).

Lines are grouped by counting when there are few (a dense domain), else their keys are radix sorted and numbered
first. The columns of a line are counted too, or radix sorted where the line has wide gaps. Both sorts keep the order
of the points, so a cell's points come by index. At most 2^30 cells lie along an axis: in a domain wider than 2^30
radii they are larger, which costs time but loses nothing.

Cells are found in float64 with an error of 2^-22 cells at most, which CELL_SLACK of the side allows for. The distance
test is done in the points' dtype and without contraction.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import scalar_types

LANES = 16  # points tested at once, and the padding behind sorted points and pairs
CELL_SLACK = 2.0**-16
MAX_CELLS = 2.0**30
MAX_FOUND = 2**31 - 1  # a search stops above: the arrays could not be larger
SPARE = 4  # up to so many lines for a point are counted, more are sorted by key; columns alike

_TYPES = f"""
#pragma clang fp contract(off)
typedef S_TYPE S;
typedef long long L;
typedef S V __attribute__((ext_vector_type({LANES}), aligned(sizeof(S))));
typedef int I __attribute__((ext_vector_type({LANES}), aligned(4)));
typedef bool B __attribute__((ext_vector_type({LANES})));
"""
_BOUND = """
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const S* p = point.data + (size_t)start.data[w] * DIM;
    const L m = (L)(start.data[w + 1] - start.data[w]) * DIM;
    double* low = lower.data + (size_t)w * DIM;
    double* high = upper.data + (size_t)w * DIM;
    L i = 0;
    if (m >= LANES * DIM) {
        V lo[DIM], hi[DIM];
        for (int k = 0; k < DIM; ++k) lo[k] = hi[k] = *(const V*)(p + LANES * k);
        for (i = LANES * DIM; i + LANES * DIM <= m; i += LANES * DIM) {
            for (int k = 0; k < DIM; ++k) {
                const V v = *(const V*)(p + i + LANES * k);
                lo[k] = __builtin_elementwise_min(lo[k], v);
                hi[k] = __builtin_elementwise_max(hi[k], v);
            }
        }
        for (int k = 0; k < DIM; ++k) {
            for (int l = 0; l < LANES; ++l) {
                const int axis = (LANES * k + l) % DIM;
                if (lo[k][l] < low[axis]) low[axis] = lo[k][l];
                if (hi[k][l] > high[axis]) high[axis] = hi[k][l];
            }
        }
    }
    for (; i < m; ++i) {
        const int axis = i % DIM;
        if (p[i] < low[axis]) low[axis] = p[i];
        if (p[i] > high[axis]) high[axis] = p[i];
    }
}
"""
_SORT = """
typedef unsigned long long U;
struct Record { S p[DIM]; int number, column; };
const size_t rows = scratch.shape[0], words = (sizeof(Record) + sizeof(U) - 1) / sizeof(U);
U* const key = (U*)scratch.data;
Record* const record = (Record*)(key + 2 * rows);
int* const value = (int*)(key + (2 + words) * rows);
int* const line = value + 2 * rows;
int* const count = line + rows;
const L room = SPARE * (L)rows;
const size_t stride = place.shape[1];
// sorts key[..m] below 2^bits, with value; returns where in both the result begins
auto radix = [&](L m, int bits) -> size_t {
    U* const k = key; int* const v = value;
    if (m <= 32) {
        for (L i = 1; i < m; ++i) {
            const U ki = k[i]; const int vi = v[i];
            L j = i;
            for (; j > 0 && k[j - 1] > ki; --j) { k[j] = k[j - 1]; v[j] = v[j - 1]; }
            k[j] = ki; v[j] = vi;
        }
        return 0;
    }
    const int digit = m < 4096 ? 8 : 11;
    size_t from = 0;
    int digits[1 << 11];
    for (int shift = 0; shift < bits; shift += digit) {
        const U* k0 = k + from; const int* v0 = v + from;
        from = rows - from;
        U* k1 = k + from; int* v1 = v + from;
        const U mask = (1 << digit) - 1;
        for (int d = 0; d < 1 << digit; ++d) digits[d] = 0;
        for (L i = 0; i < m; ++i) ++digits[(k0[i] >> shift) & mask];
        for (int d = 0, sum = 0; d < 1 << digit; ++d) { const int c = digits[d]; digits[d] = sum; sum += c; }
        for (L i = 0; i < m; ++i) {
            const int at = digits[(k0[i] >> shift) & mask]++;
            k1[at] = k0[i]; v1[at] = v0[i];
        }
    }
    return from;
};
auto bits_of = [](U last) -> int { return last == 0 ? 1 : 64 - __builtin_clzll(last); };

for (int w = world_offset; w < world_offset + worlds; ++w) {
    const int first = start.data[w];
    const L m = start.data[w + 1] - first;
    line_count.data[w] = 0; line_stride.data[w] = 0;
    if (m == 0) continue;
    double low[DIM], inverse[DIM];
    L cells[DIM];
    for (int a = 0; a < DIM; ++a) {
        const double extent = upper.data[(size_t)w * DIM + a] - lower.data[(size_t)w * DIM + a];
        const double side = reach * (1.0 + CELL_SLACK), least = extent / MAX_CELLS;
        low[a] = lower.data[(size_t)w * DIM + a];
        inverse[a] = 1.0 / (side > least ? side : least);
        cells[a] = (L)(extent * inverse[a]) + 1;
    }
    const S* p = point.data + (size_t)first * DIM;
    auto cell = [&](L i, int a) -> int { return (int)(((double)p[i * DIM + a] - low[a]) * inverse[a]); };
    // an empty row behind each layer: the neighbouring keys of a layer's end rows belong to nobody
    const L layer = DIM == 3 ? cells[1] + 1 : 0;
    auto line_of = [&](L i) -> L { return DIM == 3 ? cell(i, DIM - 1) * layer + cell(i, 1) : cell(i, 1); };
    const L lines = DIM == 3 ? cells[DIM - 1] * layer : cells[1];
    L* const keys = line_key.data + first;
    int* const starts = line_start.data + (size_t)first + w;
    int used = 0;
    if (lines <= room) {
        for (L k = 0; k < lines; ++k) count[k] = 0;
        for (L i = 0; i < m; ++i) { const int k = (int)line_of(i); line[i] = k; ++count[k]; }
        for (L k = 0, sum = 0; k < lines; ++k) {
            const int c = count[k];
            count[k] = (int)sum;
            if (c) { keys[used] = k; starts[used++] = first + (int)sum; }
            sum += c;
        }
    } else {
        for (L i = 0; i < m; ++i) { key[i] = (U)line_of(i); value[i] = (int)i; }
        const size_t at = radix(m, bits_of((U)(lines - 1)));
        const U* k = key + at;
        const int* v = value + at;
        for (L i = 0; i < m; ++i) {
            if (i == 0 || k[i] != k[i - 1]) {
                keys[used] = (L)k[i]; count[used] = (int)i; starts[used++] = first + (int)i;
            }
            line[v[i]] = used - 1;
        }
    }
    starts[used] = first + (int)m;
    line_count.data[w] = used;
    line_stride.data[w] = layer;

    for (L i = 0; i < m; ++i) {
        Record& to = record[count[line[i]]++];
        for (int a = 0; a < DIM; ++a) to.p[a] = p[i * DIM + a];
        to.number = first + (int)i; to.column = cell(i, 0);
    }
    for (int l = 0; l < used; ++l) {
        const L a = starts[l] - first, size = starts[l + 1] - starts[l];
        const Record* from = record + a;
        auto put = [&](L at, const Record& q) {
            at += starts[l];
            for (int k = 0; k < DIM; ++k) place.data[k * stride + at] = q.p[k];
            number.data[at] = q.number; column.data[at] = q.column;
        };
        int least = from[0].column, most = least;
        for (L i = 1; i < size; ++i) {
            const int c = from[i].column;
            least = c < least ? c : least; most = c > most ? c : most;
        }
        const int columns = most - least + 1;
        if (size > 16 && columns <= SPARE * size && columns <= room) {
            for (int c = 0; c < columns; ++c) count[c] = 0;
            for (L i = 0; i < size; ++i) ++count[from[i].column - least];
            for (int c = 0, sum = 0; c < columns; ++c) { const int n = count[c]; count[c] = sum; sum += n; }
            for (L i = 0; i < size; ++i) put(count[from[i].column - least]++, from[i]);
        } else {
            for (L i = 0; i < size; ++i) { key[i] = (U)(from[i].column - least); value[i] = (int)i; }
            const int* v = value + radix(size, bits_of((U)(most - least)));
            for (L i = 0; i < size; ++i) put(i, from[v[i]]);
        }
    }
}
// lanes behind the last point are masked, but they are read
if (world_offset + worlds == start.shape[0] - 1) {
    for (int i = 0; i < LANES; ++i) {
        const size_t at = (size_t)start.data[world_offset + worlds] + i;
        for (int a = 0; a < DIM; ++a) place.data[a * stride + at] = 0;
        number.data[at] = 0; column.data[at] = 0;
    }
}
"""


def snippet(dtype: str, dim: int, *parts: str) -> str:
    """C++ text for a scalar type and a number of dimensions."""
    text = "\n".join((_TYPES, *parts))
    for name, value in (
        ("S_TYPE", {"float32": "float", "float64": "double"}[dtype]),
        ("DIM", dim),
        ("LANES", LANES),
        ("CELL_SLACK", CELL_SLACK),
        ("MAX_CELLS", MAX_CELLS),
        ("MAX_FOUND", MAX_FOUND),
        ("SPARE", SPARE),
    ):
        text = text.replace(name, str(value))
    return f"#if !defined(__CUDA_ARCH__)\n{text}\n#endif\n"


@cache
def cell_functions(dtype: str, dim: int) -> dict[str, Any]:
    """``bound_points`` and ``sort_points`` of ``neighbors``."""
    real = scalar_types(dtype).real

    @wp.func_native(snippet(dtype, dim, _BOUND))
    def bound_points(
        world_offset: wp.int32,
        worlds: wp.int32,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
    ): ...

    @wp.func_native(snippet(dtype, dim, _SORT))
    def sort_points(
        world_offset: wp.int32,
        worlds: wp.int32,
        reach: wp.float64,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
        scratch: wp.array2d(dtype=wp.int64),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
    ): ...

    return {"bound_points": bound_points, "sort_points": sort_points}
