"""The splat onto an image larger than a core's cache, tile by tile, on one thread.

Points are listed by the tiles they reach (a counting sort), and a tile's points are added in the order of their index:
a node gets the sum that it has without tiles. Nodes beyond the tile are loaded and stored as they are. Warp's kernels
add a tile in a buffer of its own, without which rows of an image displace each other from the cache: 300 000 points on
64 MB take two to three times as long here, and four times without tiles.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.grid.stencil import grid_types, stencil_functions
from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.lanes import lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.sph.smoothing import WENDLAND
from dc_kernels.grid.fields import TILES
from dc_kernels.grid.layout import TILE_COLUMNS, TILE_ROWS
from dc_kernels.solve.rows import LANES


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``count_tiles``, ``list_tiles``, ``splat_tiles``."""
    t, lanes, s = grid_types(dtype), lane_functions(dtype), stencil_functions(dtype)
    real, vector = t.real, lanes.vector
    Tiles = struct_type("tiles", dtype, TILES)

    @ti.func
    def reach(code: ti.template(), u, hs, nodes):
        """The first and the last node of an axis that a point may reach."""
        low = 0
        high = 0
        if ti.static(code > WENDLAND):
            low = ti.cast(s.least(s.most(u, real(0.0)), ti.cast(nodes - 1, real)), ti.i32) - 1
            high = low + 3
        else:
            v = s.least(s.most(u, 0.0 - hs - 2.0), ti.cast(nodes, real) + hs + 1.0)
            low = ti.cast(ti.ceil(v - hs), ti.i32)
            high = ti.cast(ti.floor(v + hs), ti.i32)
            if low > high:
                low = s.nearest_node(v, nodes)
                high = low
        return ti.min(ti.max(low, 0), nodes - 1), ti.min(ti.max(high, 0), nodes - 1)

    @ti.func
    def visit(
        listing: ti.template(),
        world,
        chunk,
        chunks,
        stencil: t.Stencil,
        points: t.Points,
        image: t.image,
        tiles: Tiles,
    ):
        """Count the points of a world's chunk in the slots of the tiles that they reach, or list them there."""
        rows = image.shape[2]
        columns = image.shape[3]
        across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
        first_tile = world * across * ((rows + TILE_ROWS - 1) // TILE_ROWS)
        inv = 1.0 / stencil.spacing
        hs = stencil.h * inv
        origin = points.origin[world]
        count = ti.cast(points.count[world], ti.i64)
        begin = points.start[world] + ti.cast(count * chunk // chunks, ti.i32)
        end = points.start[world] + ti.cast(count * (chunk + 1) // chunks, ti.i32)
        for i in range(begin, end):
            x = s.in_spacings(points.place[i, 0], origin[0], inv, real(s.far_outside))
            y = s.in_spacings(points.place[i, 1], origin[1], inv, real(s.far_outside))
            c0 = 0
            c1 = 0
            r0 = 0
            r1 = 0
            if x - x == 0.0 and y - y == 0.0:
                c0, c1 = reach(stencil.kernel, x, hs, columns)
                r0, r1 = reach(stencil.kernel, y, hs, rows)
            for r in range(r0 // TILE_ROWS, r1 // TILE_ROWS + 1):
                for c in range(c0 // TILE_COLUMNS, c1 // TILE_COLUMNS + 1):
                    tile = first_tile + r * across + c
                    at = tiles.slot[chunk, tile]
                    if ti.static(listing):
                        tiles.order[at] = i
                    tiles.slot[chunk, tile] = at + 1

    @kernel
    def count_tiles(
        tid, chunk: ti.i32, chunks: ti.i32, stencil: t.Stencil, points: t.Points, image: t.image, tiles: Tiles
    ):
        """Count the points of a world's chunk that reach each tile; one thread a world."""
        visit(False, tid, chunk, chunks, stencil, points, image, tiles)

    @kernel
    def list_tiles(
        tid, chunk: ti.i32, chunks: ti.i32, stencil: t.Stencil, points: t.Points, image: t.image, tiles: Tiles
    ):
        """List the points of a world's chunk by tile, from the slots on."""
        visit(True, tid, chunk, chunks, stencil, points, image, tiles)

    @kernel
    def splat_tiles(
        tid,
        tile_offset: ti.i32,
        world_tiles: ti.i32,
        slot: ti.i32,
        stencil: t.Stencil,
        bins: ti.i32,
        channel_offset: ti.i32,
        points: t.Points,
        value: t.values,
        tiles: Tiles,
        image: t.image,
    ):
        """Clear a tile that points reach or reached at the call before, and add its points."""
        tile = tid + tile_offset
        world = tile // world_tiles
        channels = value.shape[1]
        rows = image.shape[2]
        columns = image.shape[3]
        plane = rows * columns
        base = (world * image.shape[1] + channel_offset) * plane
        across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
        row_low = (tile - world * world_tiles) // across * TILE_ROWS
        column_low = (tile - world * world_tiles) % across * TILE_COLUMNS
        row_high = ti.min(row_low + TILE_ROWS, rows)
        column_high = ti.min(column_low + TILE_COLUMNS, columns)
        first = tiles.start[tile]
        end = tiles.start[tile + 1]
        lost = 0
        if first < end or tiles.touched[tile] != 0:
            for c in range(bins * channels):
                for r in range(row_low, row_high):
                    row = base + c * plane + r * columns
                    n = column_low
                    while n + LANES <= column_high:
                        lanes.store(image, row + n, vector(0.0))
                        n += LANES
                    while n < column_high:
                        image[0, 0, 0, row + n] = 0.0
                        n += 1
        tiles.touched[tile] = ti.cast(first < end, ti.i32)
        while first < end:
            x = vector(0.0)
            y = vector(0.0)
            for k in ti.static(range(LANES)):
                i = tiles.order[ti.min(first + k, end - 1)]
                x[k] = points.place[i, 0]
                y[k] = points.place[i, 1]
            block = s.block_at(stencil.kernel, stencil, x, y, points.origin[world], rows, columns)
            for j in range(ti.min(end - first, LANES)):
                i = tiles.order[first + j]
                place = s.place_of(stencil.kernel, block, j, rows, columns)
                known = s.is_finite(place)
                r_near = 0
                c_near = 0
                if known:
                    r_near = s.nearest_node(place.y, rows)
                    c_near = s.nearest_node(place.x, columns)
                home = row_low <= r_near < row_high and column_low <= c_near < column_high
                to = base
                if bins > 1:
                    to += points.bin[i] * channels * plane
                factor = s.weigh(stencil.kernel, stencil, place, columns)[1]
                if factor != 0.0:
                    for r in range(ti.max(place.r0, row_low), ti.min(place.r1, row_high - 1) + 1):
                        for v in range(place.vectors):
                            left = place.first + v * LANES
                            lane = lanes.iota() + ti.cast(left, real)
                            w = s.weight(stencil.kernel, False, place, columns, r, v)
                            mine = (lane >= ti.cast(column_low, real)) & (lane < ti.cast(column_high, real))
                            at = to + r * columns + left
                            for c in range(channels):
                                before = lanes.load(image, at)
                                lanes.store(image, at, ti.select(mine, before + w * (value[i, c] * factor), before))
                                at += plane
                    if ti.static(stencil.kernel > WENDLAND):
                        if home and s.outside(place, rows, columns):
                            lost += 1
                elif home:
                    lost += 1
                    if known and stencil.nearest != 0 and stencil.normalize != 0:
                        at = to + r_near * columns + c_near
                        for c in range(channels):
                            image[0, 0, 0, at] = image[0, 0, 0, at] + value[i, c]
                            at += plane
            first += LANES
        tiles.lost[tile] = lost

    return {"count_tiles": count_tiles, "list_tiles": list_tiles, "splat_tiles": splat_tiles}
