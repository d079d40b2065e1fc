"""The splat onto an image larger than a core's cache, tile by tile.

Points are listed by the tiles they reach (a counting sort), a tile's points are added to a buffer of its own in the
order of their index, and the buffer is copied to the image: a node gets the sum that it has without tiles. Without a
buffer rows of the image displace each other from the cache: 1e6 points on 64 MB took 203 ns each and take 129, of which
70 are saved by loading ahead what the next points and rows need (Warp, whose copy goes past the cache: 98).
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

AHEAD = 2  # rows of the image that are loaded before a tile is copied to them; 2 to 16 cost the same
LINE = 16  # numbers at most that a line of the cache holds


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
        chunk,
        world,
        first_chunk: ti.i32,
        chunks: ti.i32,
        stencil: t.Stencil,
        points: t.Points,
        image: t.image,
        tiles: Tiles,
    ):
        """Count the points that reach each tile; a thread takes a chunk of a world's points."""
        visit(False, world, first_chunk + chunk, chunks, stencil, points, image, tiles)

    @kernel
    def list_tiles(
        chunk,
        world,
        first_chunk: ti.i32,
        chunks: ti.i32,
        stencil: t.Stencil,
        points: t.Points,
        image: t.image,
        tiles: Tiles,
    ):
        """List points by tile, from the slots on; a thread takes a chunk of a world's points."""
        visit(True, world, first_chunk + chunk, chunks, stencil, points, image, tiles)

    @ti.func
    def coordinates(first, end, points: t.Points, tiles: Tiles):
        """Coordinates of LANES points of a tile from the entry ``first`` on."""
        x = vector(0.0)
        y = vector(0.0)
        for k in ti.static(range(LANES)):
            i = tiles.order[ti.min(first + k, end - 1)]
            x[k] = points.place[i, 0]
            y[k] = points.place[i, 1]
        return x, y

    @ti.func
    def first_values(first, end, value: ti.template(), tiles: Tiles):
        """Sum of the first values of LANES points of a tile."""
        v = vector(0.0)
        for k in ti.static(range(LANES)):
            v[k] = value[tiles.order[ti.min(first + k, end - 1)], 0]
        return lanes.total(v)

    @ti.func
    def add_row(at, w, scaled, tiles: Tiles):
        """Add a scaled value to LANES nodes of a buffer from the flat index ``at`` on."""
        lanes.store_row(tiles.scratch, at, lanes.load_row(tiles.scratch, at) + w * scaled)

    @ti.func
    def add_few(begin, last, at, stride, w0, w1, w2, w3, scaled, tiles: Tiles):
        """Add a scaled value to the rows ``begin`` .. ``last`` of a window of one vector and at most four rows."""
        if begin <= 0 <= last:
            add_row(at, w0, scaled, tiles)
        if begin <= 1 <= last:
            add_row(at + stride, w1, scaled, tiles)
        if begin <= 2 <= last:
            add_row(at + 2 * stride, w2, scaled, tiles)
        if begin <= 3 <= last:
            add_row(at + 3 * stride, w3, scaled, tiles)

    @ti.func
    def at_home(place: ti.template(), row_low, row_high, column_low, column_high, rows, columns):
        """1 where a point's nearest node lies in the tile, else 0; a point that is not finite has node 0."""
        r = 0
        c = 0
        if s.is_finite(place):
            r = s.nearest_node(place.y, rows)
            c = s.nearest_node(place.x, columns)
        return ti.cast(row_low <= r < row_high and column_low <= c < column_high, ti.i32)

    @ti.func
    def clear(target, channels, plane, columns, row_low, row_high, column_low, column_high, image: t.image):
        """Set a tile of the image to 0."""
        for c in range(channels):
            for r in range(row_low, row_high):
                row = target + c * plane + r * columns
                n = column_low
                while n + LANES <= column_high:
                    lanes.store(image, row + n, vector(0.0))
                    n += LANES
                while n < column_high:
                    image[0, 0, 0, row + n] = 0.0
                    n += 1

    @ti.func
    def splat_tile(
        tile,
        slot,
        stencil: t.Stencil,
        bins,
        channel_offset,
        points: t.Points,
        value: ti.template(),
        tiles: Tiles,
        image: t.image,
    ):
        """Add a tile's points in the slot's buffer and copy it to the image; clear a tile that none reaches now."""
        channels = value.shape[1]
        rows = image.shape[2]
        columns = image.shape[3]
        plane = rows * columns
        across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
        world_tiles = across * ((rows + TILE_ROWS - 1) // TILE_ROWS)
        world = tile // world_tiles
        target = (world * image.shape[1] + channel_offset) * plane
        row_low = tile % world_tiles // across * TILE_ROWS
        column_low = tile % world_tiles % across * TILE_COLUMNS
        row_high = ti.min(row_low + TILE_ROWS, rows)
        column_high = ti.min(column_low + TILE_COLUMNS, columns)
        # a window reaches into the tile from no farther away than its own width
        pad = LANES
        if ti.static(stencil.kernel <= WENDLAND):
            pad = (ti.cast(2.0 * (stencil.h * (1.0 / stencil.spacing)), ti.i32) // LANES + 1) * LANES
        stride = TILE_COLUMNS + 2 * pad
        layer = stride * TILE_ROWS
        buffer = slot * tiles.scratch.shape[1]
        base = buffer + pad - column_low - row_low * stride
        first = tiles.start[tile]
        end = tiles.start[tile + 1]
        lost = 0
        if first == end and tiles.touched[tile] != 0:
            clear(target, bins * channels, plane, columns, row_low, row_high, column_low, column_high, image)
        tiles.touched[tile] = ti.cast(first < end, ti.i32)
        if first < end:
            for n in range(bins * channels * layer // LANES):
                lanes.store_row(tiles.scratch, buffer + n * LANES, vector(0.0))
            x, y = coordinates(first, end, points, tiles)
            while first < end:
                block = s.block_at(stencil.kernel, stencil, x, y, points.origin[world], rows, columns)
                # what the next points need arrives while these are at work: a number that is stored has been loaded,
                # and the buffer's first lies left of the tile, where none is copied from
                x, y = coordinates(first + LANES, end, points, tiles)
                tiles.scratch[0, buffer] = first_values(first + LANES, end, value, tiles)
                for j in range(ti.min(end - first, LANES)):
                    i = tiles.order[first + j]
                    place = s.place_of(stencil.kernel, block, j, rows, columns)
                    to = base
                    if bins > 1:
                        to += points.bin[i] * channels * layer
                    few, factor, w0, w1, w2, w3 = s.weigh(stencil.kernel, stencil, place, columns)
                    if factor != 0.0:
                        r0 = ti.max(place.r0, row_low)
                        r1 = ti.min(place.r1, row_high - 1)
                        if few:
                            at = to + place.r0 * stride + place.first
                            begin = r0 - place.r0
                            last = r1 - place.r0
                            for c in range(channels):
                                add_few(begin, last, at, stride, w0, w1, w2, w3, value[i, c] * factor, tiles)
                                at += layer
                        else:
                            for r in range(r0, r1 + 1):
                                for v in range(place.vectors):
                                    left = place.first + v * LANES
                                    w = s.weight(stencil.kernel, False, place, columns, r, v)
                                    at = to + r * stride + left
                                    for c in range(channels):
                                        add_row(at, w, value[i, c] * factor, tiles)
                                        at += layer
                        if ti.static(stencil.kernel > WENDLAND):
                            if s.outside(place, rows, columns):
                                lost += at_home(place, row_low, row_high, column_low, column_high, rows, columns)
                    elif at_home(place, row_low, row_high, column_low, column_high, rows, columns) != 0:
                        lost += 1
                        if s.is_finite(place) and stencil.nearest != 0 and stencil.normalize != 0:
                            at = to + s.nearest_node(place.y, rows) * stride + s.nearest_node(place.x, columns)
                            for c in range(channels):
                                tiles.scratch[0, at] = tiles.scratch[0, at] + value[i, c]
                                at += layer
                first += LANES
            for c in range(bins * channels):
                for r in range(row_low, row_high):
                    source = base + c * layer + r * stride
                    to = target + c * plane + r * columns
                    ahead = to + ti.min(AHEAD, row_high - 1 - r) * columns
                    n = column_low
                    seen = image[0, 0, 0, ahead + column_high - 1]
                    while n < column_high:
                        seen = seen + image[0, 0, 0, ahead + n]
                        n += LINE
                    tiles.scratch[0, buffer] = seen
                    n = column_low
                    while n + LANES <= column_high:
                        lanes.store(image, to + n, lanes.load_row(tiles.scratch, source + n))
                        n += LANES
                    while n < column_high:
                        image[0, 0, 0, to + n] = tiles.scratch[0, source + n]
                        n += 1
        tiles.lost[tile] = lost

    @kernel
    def splat_tiles(
        slot,
        k,
        tile_offset: ti.i32,
        slot_tiles: ti.i32,
        first_slot: ti.i32,
        stencil: t.Stencil,
        bins: ti.i32,
        channel_offset: ti.i32,
        points: t.Points,
        value: t.values,
        tiles: Tiles,
        image: t.image,
    ):
        """Add the points of a slot's tiles in its buffer and copy each to the image; clear tiles that none reaches."""
        tile = tile_offset + slot * slot_tiles + k
        if tile < tiles.touched.shape[0]:
            splat_tile(tile, first_slot + slot, stencil, bins, channel_offset, points, value, tiles, image)

    return {"count_tiles": count_tiles, "list_tiles": list_tiles, "splat_tiles": splat_tiles}
