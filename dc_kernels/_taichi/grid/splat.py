"""Splat: points -> grid, one thread a world, and the division by weights.

A world belongs to one thread, which adds its points in the order of their index: nothing is added concurrently, and the
bits are the same for any number of threads, and those of Warp's kernels.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.grid.stencil import grid_types, stencil_functions
from dc_kernels._taichi.lanes import lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.sph.smoothing import WENDLAND
from dc_kernels.grid.layout import BAND
from dc_kernels.solve.rows import LANES

BAND_BITS = BAND.bit_length() - 1


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``splat_worlds``, ``mark_bands`` and ``divide_image``."""
    t, lanes, s = grid_types(dtype), lane_functions(dtype), stencil_functions(dtype)
    real = t.real
    integers, bands = ti.types.ndarray(dtype=ti.i32, ndim=1), ti.types.ndarray(dtype=ti.i32, ndim=2)

    @ti.func
    def clear_bands(w, channels, channel_offset, touched: ti.template(), image: t.image):
        """Set the bands to 0 that the call before touched."""
        rows = image.shape[2]
        columns = image.shape[3]
        plane = rows * columns
        base = (w * image.shape[1] + channel_offset) * plane
        for b in range(touched.shape[1]):
            if touched[w, b] != 0:
                touched[w, b] = 0
                for c in range(channels):
                    at = base + c * plane + b * BAND * columns
                    end = base + c * plane + ti.min((b + 1) * BAND, rows) * columns
                    while at + LANES <= end:
                        lanes.store(image, at, lanes.vector(0.0))
                        at += LANES
                    while at < end:
                        image[0, 0, 0, at] = 0.0
                        at += 1

    @ti.func
    def add_row(at, w, scaled, image: t.image):
        """Add a scaled value to LANES nodes from the flat index ``at`` on."""
        lanes.store(image, at, lanes.load(image, at) + w * scaled)

    @ti.func
    def add_few(place: ti.template(), at, columns, w0, w1, w2, w3, scaled, image: t.image):
        """Add a scaled value to the nodes of a window of one vector and few rows."""
        add_row(at, w0, scaled, image)
        if place.r1 > place.r0:
            add_row(at + columns, w1, scaled, image)
            if place.r1 > place.r0 + 1:
                add_row(at + 2 * columns, w2, scaled, image)
                if place.r1 > place.r0 + 2:
                    add_row(at + 3 * columns, w3, scaled, image)

    @ti.func
    def add_window(code: ti.template(), place: ti.template(), to, scaled, columns, image: t.image):
        """Add a scaled value to the nodes of any window, from the channel at the flat index ``to`` on."""
        for r in range(place.r0, place.r1 + 1):
            for v in range(place.vectors):
                w = s.weight(code, False, place, columns, r, v)
                left = place.first + v * LANES
                for k in ti.static(range(LANES)):
                    if left + k < columns:
                        p = to + r * columns + left + k
                        image[0, 0, 0, p] = image[0, 0, 0, p] + w[k] * scaled

    @kernel
    def splat_worlds(
        tid,
        world_offset: ti.i32,
        stencil: t.Stencil,
        bins: ti.i32,
        channel_offset: ti.i32,
        points: t.Points,
        value: t.values,
        touched: bands,
        missed: integers,
        image: t.image,
    ):
        """Clear what the call before touched in these channels, then add the points of a world."""
        world = tid + world_offset
        channels = value.shape[1]
        rows = image.shape[2]
        columns = image.shape[3]
        clear_bands(world, bins * channels, channel_offset, touched, image)
        plane = rows * columns
        base = (world * image.shape[1] + channel_offset) * plane
        lost = 0
        first = points.start[world]
        end = first + points.count[world]
        while first < end:
            x, y = s.coordinates(points, first, end)
            block = s.block_at(stencil.kernel, stencil, x, y, points.origin[world], rows, columns)
            for j in range(ti.min(end - first, LANES)):
                i = first + j
                place = s.place_of(stencil.kernel, block, j, rows, columns)
                to = base
                if bins > 1:
                    to += points.bin[i] * channels * plane
                few, factor, w0, w1, w2, w3 = s.weigh(stencil.kernel, stencil, place, columns)
                if factor != 0.0:
                    if few:
                        at = to + place.r0 * columns + place.first
                        for c in range(channels):
                            add_few(place, at, columns, w0, w1, w2, w3, value[i, c] * factor, image)
                            at += plane
                    else:
                        for c in range(channels):
                            add_window(stencil.kernel, place, to, value[i, c] * factor, columns, image)
                            to += plane
                    for b in range(place.r0 >> BAND_BITS, (place.r1 >> BAND_BITS) + 1):
                        touched[world, b] = 1
                    if ti.static(stencil.kernel > WENDLAND):
                        if s.outside(place, rows, columns):
                            lost += 1
                else:
                    lost += 1
                    if s.is_finite(place) and stencil.nearest != 0 and stencil.normalize != 0:
                        r = s.nearest_node(place.y, rows)
                        to += r * columns + s.nearest_node(place.x, columns)
                        for c in range(channels):
                            p = to + c * plane
                            image[0, 0, 0, p] = image[0, 0, 0, p] + value[i, c]
                        touched[world, r >> BAND_BITS] = 1
            first += LANES
        missed[world] = lost

    @kernel
    def mark_bands(tid, world_offset: ti.i32, band: bands, touched: bands):
        """Mark bands that the next splat is to clear too."""
        w = tid + world_offset
        for b in range(touched.shape[1]):
            if band[w, b] != 0:
                touched[w, b] = 1

    @kernel
    def divide_image(tid, world_offset: ti.i32, weight: t.image, image: t.image):
        """Divide an image by the weights that it was added with; it is 0 where there are none."""
        w = tid + world_offset
        channels = image.shape[1] // weight.shape[1]
        for c in range(image.shape[1]):
            for r in range(image.shape[2]):
                for n in range(image.shape[3]):
                    by = weight[w, c // channels, r, n]
                    share = real(0.0)
                    if by > 0.0:
                        share = image[w, c, r, n] / by
                    image[w, c, r, n] = share

    return {"splat_worlds": splat_worlds, "mark_bands": mark_bands, "divide_image": divide_image}
