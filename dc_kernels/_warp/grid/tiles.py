"""The splat onto an image larger than a core's cache, tile by tile.

Points are listed by the tiles they reach (a counting sort), a tile's points are added to a buffer of its own in the
order of their index, and the buffer is copied to the image: with 1e6 points in random order a fourth of the time that
adding them to the image takes, whose every access misses the cache. A node gets the same sum in the same order.
Of 62 ns a point, 20 make the lists; tiles of 32 x 32 to 64 x 128 nodes differ by a tenth; listing in vectors of points
gained nothing.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.grid.loops import ADD_RUN, HOME, LOST
from dc_kernels._warp.grid.stencil import SETUP, snippet
from dc_kernels.grid.layout import TILE_COLUMNS, TILE_ROWS

AHEAD = 12  # points that are fetched ahead of their use; 8 to 24 cost the same

# for a tile of every point of a chunk: VISIT
_VISIT = f"""
const int across = (K + {TILE_COLUMNS - 1}) / {TILE_COLUMNS}, tiles = across * ((R + {TILE_ROWS - 1}) / {TILE_ROWS});
int* const slots = tile_slot.data + (size_t)chunk * tile_slot.shape[1] + (size_t)world * tiles;
const int first = point_start.data[world];
const long long count = point_count.data[world];
const int begin = first + (int)(count * chunk / chunks), end = first + (int)(count * (chunk + 1) / chunks);
const bool separable = stencil > 4;
auto range = [&](S u, int nodes, int& lo, int& hi) {{
    if (separable) {{
        lo = (int)clip(u, 0, nodes - 1) - 1;
        hi = lo + 3;
    }} else {{
        u = clip(u, -hs - 2, nodes + hs + 1);
        lo = (int)__builtin_elementwise_ceil(u - hs);
        hi = (int)__builtin_elementwise_floor(u + hs);
        if (lo > hi) lo = hi = nearest_node(u, nodes);
    }}
    lo = lo < 0 ? 0 : (lo > nodes - 1 ? nodes - 1 : lo);
    hi = hi < 0 ? 0 : (hi > nodes - 1 ? nodes - 1 : hi);
}};
for (int i = begin; i < end; ++i) {{
    int c0 = 0, c1 = 0;
    r0 = r1 = 0;
    if (finite(i)) {{
        range(x, K, c0, c1);
        range(y, R, r0, r1);
    }}
    for (int r = r0 / {TILE_ROWS}; r <= r1 / {TILE_ROWS}; ++r)
        for (int c = c0 / {TILE_COLUMNS}; c <= c1 / {TILE_COLUMNS}; ++c) VISIT;
}}
"""

_TILE = f"""
const int across = (K + {TILE_COLUMNS - 1}) / {TILE_COLUMNS}, tiles = across * ((R + {TILE_ROWS - 1}) / {TILE_ROWS});
const int within_world = tile - world * tiles;
const int row_lo = within_world / across * {TILE_ROWS}, col_lo = within_world % across * {TILE_COLUMNS};
const int row_hi = row_lo + {TILE_ROWS} < R ? row_lo + {TILE_ROWS} : R;
const int col_hi = col_lo + {TILE_COLUMNS} < K ? col_lo + {TILE_COLUMNS} : K;
const int begin = tile_start.data[tile], end = tile_start.data[tile + 1];
const size_t nodes = (size_t)R * K;
const int channels = bins * C;
S* const target = image.data + ((size_t)world * image.shape[1] + channel_offset) * nodes;
tile_lost.data[tile] = 0;
if (begin == end) {{
    if (tile_touched.data[tile])
        for (int c = 0; c < channels; ++c)
            for (int r = row_lo; r < row_hi; ++r)
                for (int n = col_lo; n < col_hi; ++n) target[c * nodes + (size_t)r * K + n] = 0;
    tile_touched.data[tile] = 0;
    return;
}}
tile_touched.data[tile] = 1;
// a window reaches into the tile from no farther away than its own width
const int pad = stencil > 4 ? L : ((int)(2 * hs) / L + 1) * L;
const int left = col_lo - pad, row_stride = {TILE_COLUMNS} + 2 * pad;
const size_t channel_stride = (size_t)row_stride * {TILE_ROWS};
S* const buffer = scratch.data + (size_t)slot * scratch.shape[1];
S* const base = buffer - channel_offset * channel_stride;
for (size_t n = 0; n < channels * channel_stride; ++n) buffer[n] = 0;
auto mark = [](int, int) {{}};
auto item = [&](int k) {{
    const size_t next = order.data[k + {AHEAD}];
    __builtin_prefetch(P + 2 * next);
    __builtin_prefetch(value.data + next * C);
    return order.data[k];
}};
"""
_TILE_OUT = """
tile_lost.data[tile] = lost;
for (int c = 0; c < channels; ++c)
    for (int r = row_lo; r < row_hi; ++r) {
        const S* from = buffer + c * channel_stride + (size_t)(r - row_lo) * row_stride + pad;
        S* to = target + c * nodes + (size_t)r * K + col_lo;
        // past the cache where the row is aligned: a sixteenth of the whole
        typedef S A __attribute__((ext_vector_type(L)));
        int n = 0;
        if (((unsigned long long)to & (sizeof(A) - 1)) == 0)
            for (; n + L <= col_hi - col_lo; n += L)
                __builtin_nontemporal_store((A) * (const V*)(from + n), (A*)(to + n));
        for (; n < col_hi - col_lo; ++n) to[n] = from[n];
    }
"""


def _visit(dtype: str, action: str) -> str:
    scalar = {"float32": "float", "float64": "double"}[dtype]
    text = SETUP + _VISIT.replace("VISIT", action)
    return f"#if !defined(__CUDA_ARCH__)\n{text}\n#endif\n".replace("S_TYPE", scalar)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``count_tiles``, ``list_tiles``, ``splat_tiles``."""
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    image_type = wp.array(dtype=real, ndim=4)
    value_type = wp.array(dtype=real, ndim=2)
    integers = wp.array(dtype=wp.int32)
    table = wp.array(dtype=wp.int32, ndim=2)
    vectors = wp.array(dtype=vec2)
    module = kernel_module("transfer_tiles", dtype)

    @wp.func_native(_visit(dtype, "++slots[r * across + c]"))
    def count_chunk(
        world: wp.int32,
        chunk: wp.int32,
        chunks: wp.int32,
        stencil: wp.int32,
        spacing: real,
        h: real,
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        image: image_type,
        tile_slot: table,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def count_tiles(
        chunk: int,
        chunks: int,
        stencil: int,
        spacing: real,
        h: real,
        # Points in:
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        image: image_type,
        # Out:
        tile_slot: table,
    ):
        """Points of a world's chunk that reach each tile; one thread a world."""
        count_chunk(
            wp.tid(),
            chunk,
            chunks,
            stencil,
            spacing,
            h,
            grid_origin,
            point_start,
            point_count,
            point,
            image,
            tile_slot,
        )

    @wp.func_native(_visit(dtype, "order.data[slots[r * across + c]++] = i"))
    def list_chunk(
        world: wp.int32,
        chunk: wp.int32,
        chunks: wp.int32,
        stencil: wp.int32,
        spacing: real,
        h: real,
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        image: image_type,
        tile_slot: table,
        order: integers,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def list_tiles(
        chunk: int,
        chunks: int,
        stencil: int,
        spacing: real,
        h: real,
        # Points in:
        grid_origin: vectors,
        point_start: integers,
        point_count: integers,
        point: vectors,
        image: image_type,
        # In, out:
        tile_slot: table,
        # Out:
        order: integers,
    ):
        """The points of a world's chunk, listed by tile from the slots on."""
        list_chunk(
            wp.tid(),
            chunk,
            chunks,
            stencil,
            spacing,
            h,
            grid_origin,
            point_start,
            point_count,
            point,
            image,
            tile_slot,
            order,
        )

    @wp.func_native(snippet(dtype, LOST + _TILE + HOME, ADD_RUN, _TILE_OUT))
    def splat_tile(
        tile: wp.int32,
        world: wp.int32,
        slot: wp.int32,
        stencil: wp.int32,
        normalize: wp.int32,
        nearest: wp.int32,
        spacing: real,
        h: real,
        bins: wp.int32,
        channel_offset: wp.int32,
        grid_origin: vectors,
        point: vectors,
        value: value_type,
        point_bin: integers,
        tile_start: integers,
        order: integers,
        scratch: value_type,
        tile_touched: integers,
        tile_lost: integers,
        image: image_type,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def splat_tiles(
        tile_offset: int,
        tiles: int,
        slot: int,
        stencil: int,
        normalize: int,
        nearest: int,
        spacing: real,
        h: real,
        bins: int,
        channel_offset: int,
        # Points in:
        grid_origin: vectors,
        point: vectors,
        value: value_type,
        point_bin: integers,
        tile_start: integers,
        order: integers,
        # Scratch:
        scratch: value_type,
        # Image in, out:
        tile_touched: integers,
        tile_lost: integers,
        image: image_type,
    ):
        """Add a tile's points in the slot's buffer and copy it to the image; clear a tile that none reaches now."""
        tile = wp.tid() + tile_offset
        splat_tile(
            tile,
            tile // tiles,
            slot,
            stencil,
            normalize,
            nearest,
            spacing,
            h,
            bins,
            channel_offset,
            grid_origin,
            point,
            value,
            point_bin,
            tile_start,
            order,
            scratch,
            tile_touched,
            tile_lost,
            image,
        )

    return {"count_tiles": count_tiles, "list_tiles": list_tiles, "splat_tiles": splat_tiles}
