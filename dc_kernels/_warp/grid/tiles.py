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
from dc_kernels._warp.grid.stencil import WEIGHTS, grid_code


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

    @wp.func_native(grid_code(dtype, "grid/tiling.h", "grid/visit.h", "grid/count_tiles.h"))
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

    @wp.func_native(grid_code(dtype, "grid/tiling.h", "grid/visit.h", "grid/list_tiles.h"))
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

    @wp.func_native(
        grid_code(dtype, "grid/tiling.h", "grid/tile.h", "grid/points.h", "grid/add.h", *WEIGHTS, "grid/splat_tile.h")
    )
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
