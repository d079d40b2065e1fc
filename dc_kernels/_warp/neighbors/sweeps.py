"""Sweeps over sorted cells (``cells``) that find pairs and lists of neighbours, as native snippets for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.neighbors.cells import LANES, snippet

_NEAR = """
#ifdef __AVX512F__
auto pack = [](I v, unsigned bits) -> I {
    return (I)__builtin_ia32_compresssi512_mask(v, (I)0, (unsigned short)bits);
};
#endif
// bits of the lanes j .. j + LANES, those from `last` on left out, that are near the point
auto near = [&](const S* at, size_t stride, L j, L last, const S* own) -> unsigned {
    V d = *(const V*)(at + j) - own[0];
    V square = d * d;
    for (int a = 1; a < DIM; ++a) {
        d = *(const V*)(at + a * stride + j) - own[a];
        square = square + d * d;
    }
    const unsigned bits = __builtin_bit_cast(unsigned short, __builtin_convertvector(square <= limit, B));
    return last - j < LANES ? bits & ((1u << (last - j)) - 1) : bits;
};
// the first point from j on whose column is not below `least`
auto skip = [&](const int* col, L j, L last, int least) -> L {
    while (j < last) {
        const I c = *(const I*)(col + j);
        const unsigned below = __builtin_bit_cast(unsigned short, __builtin_convertvector(c < least, B));
        const int more = __builtin_ctz(~below);
        j += more;
        if (more < LANES) break;
    }
    return j < last ? j : last;
};
"""
_PAIRS = f"""
L out = 0;
const L room = (L)pair.shape[0] - LANES;
auto emit = [&](int own, L j, unsigned bits) {{
    const int more = __builtin_popcount(bits);
    if (out <= room) {{
        int* to = pair.data + 2 * out;
#ifdef __AVX512F__
        const I other = pack(*(const I*)(number.data + j), bits);
        const I mine = own;
        const I low = __builtin_elementwise_min(other, mine), high = __builtin_elementwise_max(other, mine);
        *(I*)to = __builtin_shufflevector(
            low, high, {", ".join(f"{i}, {LANES + i}" for i in range(LANES // 2))});
        *(I*)(to + LANES) = __builtin_shufflevector(
            low, high, {", ".join(f"{i}, {LANES + i}" for i in range(LANES // 2, LANES))});
#else
        for (unsigned b = bits; b; b &= b - 1) {{
            const int other = number.data[j + __builtin_ctz(b)];
            *to++ = other < own ? other : own; *to++ = other < own ? own : other;
        }}
#endif
    }}
    out += more;
}};
const size_t stride = place.shape[1];
for (int w = world_offset; w < world_offset + worlds; ++w) {{
    const L before = out;
    const L* keys = line_key.data + start.data[w];
    const int* starts = line_start.data + (size_t)start.data[w] + w;
    const int lines = line_count.data[w];
    const L layer = line_stride.data[w];
    const L ahead[4] = {{1, layer - 1, layer, layer + 1}};
    int at[4] = {{0, 0, 0, 0}};
    for (int l = 0; l < lines && out <= MAX_FOUND; ++l) {{
        const L a0 = starts[l], a1 = starts[l + 1];
        auto sweep = [&](L b0, L b1, bool same) {{
            for (L i = a0; i < a1 && out <= MAX_FOUND; ++i) {{
                S own[DIM];
                for (int a = 0; a < DIM; ++a) own[a] = place.data[a * stride + i];
                const int c = column.data[i], mine = number.data[i];
                L j = i + 1;
                if (!same) j = b0 = skip(column.data, b0, b1, c - 1);
                for (; j < b1 && column.data[j] <= c + 1; j += LANES)
                    emit(mine, j, near(place.data, stride, j, b1, own));
            }}
        }};
        sweep(a0, a1, true);
        for (int k = 0; k < (DIM == 3 ? 4 : 1); ++k) {{
            while (at[k] < lines && keys[at[k]] < keys[l] + ahead[k]) ++at[k];
            if (at[k] < lines && keys[at[k]] == keys[l] + ahead[k]) sweep(starts[at[k]], starts[at[k] + 1], false);
        }}
    }}
    found.data[w - world_offset] = out - before;
}}
"""
_LISTS = """
L out = 0;
const L room = (L)entry.shape[0] - LANES;
const int BEHIND = DIM == 3 ? 9 : 3;
const size_t stride = place.shape[1], query_stride = query_place.shape[1];
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const L before = out;
    const L* query_keys = query_line_key.data + query_start.data[w];
    const int* query_starts = query_line_start.data + (size_t)query_start.data[w] + w;
    const L* keys = line_key.data + start.data[w];
    const int* starts = line_start.data + (size_t)start.data[w] + w;
    const int lines = line_count.data[w];
    int at[BEHIND];
    L away[BEHIND];
    for (int k = 0; k < BEHIND; ++k) { at[k] = 0; away[k] = k % 3 - 1 + (k / 3 - BEHIND / 6) * line_stride.data[w]; }
    for (int l = 0; l < query_line_count.data[w]; ++l) {
        L from[BEHIND], last[BEHIND];
        int near_lines = 0;
        for (int k = 0; k < BEHIND; ++k) {
            const L wanted = query_keys[l] + away[k];
            while (at[k] < lines && keys[at[k]] < wanted) ++at[k];
            if (at[k] < lines && keys[at[k]] == wanted) {
                from[near_lines] = starts[at[k]]; last[near_lines++] = starts[at[k] + 1];
            }
        }
        for (L i = query_starts[l]; i < query_starts[l + 1] && out <= MAX_FOUND; ++i) {
            S own[DIM];
            for (int a = 0; a < DIM; ++a) own[a] = query_place.data[a * query_stride + i];
            const int c = query_column.data[i], mine = query_number.data[i];
            const L begin = out;
            __builtin_prefetch(list_span.data + 2 * (size_t)query_number.data[i + LANES], 1);
            for (int k = 0; k < near_lines; ++k) {
                from[k] = skip(column.data, from[k], last[k], c - 1);
                for (L j = from[k]; j < last[k] && column.data[j] <= c + 1; j += LANES) {
                    const unsigned bits = near(place.data, stride, j, last[k], own);
                    if (out <= room) {
                        int* to = entry.data + out;
#ifdef __AVX512F__
                        *(I*)to = pack(*(const I*)(number.data + j), bits);
#else
                        for (unsigned b = bits; b; b &= b - 1) *to++ = number.data[j + __builtin_ctz(b)];
#endif
                    }
                    out += __builtin_popcount(bits);
                }
            }
            list_span.data[2 * (size_t)mine] = begin;
            list_span.data[2 * (size_t)mine + 1] = out - begin;
        }
    }
    found.data[w - world_offset] = out - before;
}
"""
_ORDER = """
const int AHEAD = 16;
for (int q = query_offset; q < query_offset + queries; ++q) {
    const L m = list_start.data[q + 1] - list_start.data[q];
    // the lists lie in the order of the sorted queries: each is fetched from anywhere
    if (q + AHEAD < query_offset + queries) __builtin_prefetch(entry.data + list_span.data[2 * (size_t)(q + AHEAD)]);
    const int* from = entry.data + list_span.data[2 * (size_t)q];
    int* to = index.data + list_start.data[q];
    if (m <= 4 * LANES) {
        // a number's place is how many are less; all differ
        I block[4];
        I lane;
        for (int l = 0; l < LANES; ++l) lane[l] = l;
        const int blocks = (int)((m + LANES - 1) / LANES);
        for (int b = 0; b < blocks; ++b) {
            const I all = *(const I*)(from + LANES * b), none = 0x7fffffff;
            block[b] = lane + LANES * b < (int)m ? all : none;
        }
        for (int i = 0; i < m; ++i) {
            int rank = 0;
            for (int b = 0; b < blocks; ++b)
                rank += __builtin_popcount(
                    __builtin_bit_cast(unsigned short, __builtin_convertvector(block[b] < from[i], B)));
            to[rank] = from[i];
        }
        continue;
    }
    for (L i = 0; i < m; ++i) to[i] = from[i];
    // heap sort: the greatest of the first `size` moves to their end
    auto sift = [&](L root, L size) {
        const int moved = to[root];
        for (L child; (child = 2 * root + 1) < size; root = child) {
            if (child + 1 < size && to[child + 1] > to[child]) ++child;
            if (to[child] <= moved) break;
            to[root] = to[child];
        }
        to[root] = moved;
    };
    for (L i = m / 2; i-- > 0;) sift(i, m);
    for (L size = m - 1; size > 0; --size) {
        const int greatest = to[0];
        to[0] = to[size]; to[size] = greatest;
        sift(0, size);
    }
}
"""


@cache
def sweep_functions(dtype: str, dim: int) -> dict[str, Any]:
    """``sweep_pairs``, ``sweep_lists`` and ``order_lists`` of ``neighbors``."""
    real = scalar_types(dtype).real

    @wp.func_native(snippet(dtype, dim, _NEAR, _PAIRS))
    def sweep_pairs(
        world_offset: wp.int32,
        worlds: wp.int32,
        limit: real,
        start: wp.array(dtype=wp.int32),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
        found: wp.array(dtype=wp.int64),
        pair: wp.array2d(dtype=wp.int32),
    ): ...

    @wp.func_native(snippet(dtype, dim, _NEAR, _LISTS))
    def sweep_lists(
        world_offset: wp.int32,
        worlds: wp.int32,
        limit: real,
        query_start: wp.array(dtype=wp.int32),
        query_place: wp.array2d(dtype=real),
        query_number: wp.array(dtype=wp.int32),
        query_column: wp.array(dtype=wp.int32),
        query_line_key: wp.array(dtype=wp.int64),
        query_line_start: wp.array(dtype=wp.int32),
        query_line_count: wp.array(dtype=wp.int32),
        start: wp.array(dtype=wp.int32),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
        list_span: wp.array2d(dtype=wp.int64),
        found: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
    ): ...

    @wp.func_native(snippet(dtype, dim, _ORDER))
    def order_lists(
        query_offset: wp.int32,
        queries: wp.int32,
        list_span: wp.array2d(dtype=wp.int64),
        list_start: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
        index: wp.array(dtype=wp.int32),
    ): ...

    return {"sweep_pairs": sweep_pairs, "sweep_lists": sweep_lists, "order_lists": order_lists}
