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

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.grid.stencil import WEIGHTS, grid_code, grid_types
from dc_kernels.grid.layout import TILE_COLUMNS, TILE_ROWS

VISIT = ("grid/tiling.h", "grid/visit.h")
TILE = ("grid/tiling.h", "grid/tile.h", "grid/points.h", "grid/add.h", *WEIGHTS, "grid/splat_tile.h")


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``count_tiles``, ``list_tiles``, ``splat_tiles``."""
    t = grid_types(dtype)
    Stencil, Points, Tiles, values, image_type = t.Stencil, t.Points, t.Tiles, t.values, t.image
    module = kernel_module("splat_tiles", dtype)

    @wp.func_native(grid_code(dtype, *VISIT, "grid/count_tiles.h"))
    def count_chunk(
        world: wp.int32,
        chunk: wp.int32,
        chunks: wp.int32,
        stencil: Stencil,
        points: Points,
        image: image_type,
        tiles: Tiles,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def count_tiles(first_chunk: int, chunks: int, stencil: Stencil, points: Points, image: image_type, tiles: Tiles):
        """Count the points that reach each tile; a thread takes a chunk of a world's points."""
        chunk, world = wp.tid()
        count_chunk(world, first_chunk + chunk, chunks, stencil, points, image, tiles)

    @wp.func_native(grid_code(dtype, *VISIT, "grid/list_tiles.h"))
    def list_chunk(
        world: wp.int32,
        chunk: wp.int32,
        chunks: wp.int32,
        stencil: Stencil,
        points: Points,
        image: image_type,
        tiles: Tiles,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def list_tiles(first_chunk: int, chunks: int, stencil: Stencil, points: Points, image: image_type, tiles: Tiles):
        """List points by tile, from the slots on; a thread takes a chunk of a world's points."""
        chunk, world = wp.tid()
        list_chunk(world, first_chunk + chunk, chunks, stencil, points, image, tiles)

    @wp.func_native(grid_code(dtype, *TILE))
    def splat_tile(
        tile: wp.int32,
        world: wp.int32,
        slot: wp.int32,
        stencil: Stencil,
        bins: wp.int32,
        channel_offset: wp.int32,
        points: Points,
        value: values,
        tiles: Tiles,
        image: image_type,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def splat_tiles(
        tile_offset: int,
        slot_tiles: int,
        first_slot: int,
        stencil: Stencil,
        bins: int,
        channel_offset: int,
        points: Points,
        value: values,
        tiles: Tiles,
        # Out:
        image: image_type,
    ):
        """Add a tile's points in the slot's buffer and copy it to the image; clear a tile that none reaches now."""
        slot, k = wp.tid()
        tile = tile_offset + slot * slot_tiles + k
        if tile < tiles.touched.shape[0]:
            rows, columns = image.shape[2], image.shape[3]
            across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
            world = tile // (across * ((rows + TILE_ROWS - 1) // TILE_ROWS))
            splat_tile(tile, world, first_slot + slot, stencil, bins, channel_offset, points, value, tiles, image)

    return {"count_tiles": count_tiles, "list_tiles": list_tiles, "splat_tiles": splat_tiles}
