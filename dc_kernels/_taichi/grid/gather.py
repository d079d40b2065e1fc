"""Gather: grid -> points, and its derivative by the points' places; a thread takes a chunk of a world's points."""

from functools import cache
from typing import Any

from dc_kernels._taichi.grid.stencil import grid_types, stencil_functions
from dc_kernels._taichi.lanes import MASK, lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.sph.smoothing import BILINEAR, WENDLAND
from dc_kernels.grid.layout import CHUNK
from dc_kernels.solve.rows import LANES


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``gather_points`` and ``gather_gradient``."""
    t, lanes, s = grid_types(dtype), lane_functions(dtype), stencil_functions(dtype)
    real, vector, vec4 = t.real, lanes.vector, t.vec4
    vectors = ti.types.ndarray(dtype=t.vec2, ndim=1)

    @ti.func
    def load_columns(image: ti.template(), at, left, columns):
        """LANES numbers of a row from column ``left`` on; 0 beyond it."""
        numbers = vector(0.0)
        if columns - left >= LANES:
            numbers = lanes.load(image, at)
        else:
            for k in ti.static(range(LANES)):
                if left + k < columns:
                    numbers[k] = image[0, 0, 0, at + k]
        return numbers

    @ti.func
    def two_nodes(image: ti.template(), at, to):
        """Two neighbouring nodes, and two of another channel."""
        p = at & MASK
        q = to & MASK
        return vec4(image[0, 0, 0, p], image[0, 0, 0, p + 1], image[0, 0, 0, q], image[0, 0, 0, q + 1])

    @ti.func
    def gather_linear(
        world,
        first,
        end,
        stencil: t.Stencil,
        bins,
        channel_offset,
        points: t.Points,
        image: t.image,
        value: t.values,
    ):
        """Bilinear alone has a loop of its own: four nodes of each point."""
        channels = value.shape[1]
        rows = image.shape[2]
        columns = image.shape[3]
        plane = rows * columns
        base = (world * image.shape[1] + channel_offset) * plane
        right = vector(ti.cast(columns - 1, real))
        top = vector(ti.cast(rows - 1, real))
        zero = vector(0.0)
        while first < end:
            x, y = s.coordinates(points, first, end)
            block = s.block_at(BILINEAR, stencil, x, y, points.origin[world], rows, columns)
            known = (block.x - block.x == zero) & (block.y - block.y == zero)
            u = s.least(s.most(ti.select(known, block.x, zero), zero), right)
            v = s.least(s.most(ti.select(known, block.y, zero), zero), top)
            c = s.least(ti.floor(u), right - 1.0)
            r = s.least(ti.floor(v), top - 1.0)
            tx = u - c
            ty = v - r
            w00 = (1.0 - tx) * (1.0 - ty) * ti.select(known, vector(1.0), zero)
            w01 = tx * (1.0 - ty)
            w10 = (1.0 - tx) * ty
            w11 = tx * ty
            for j in range(ti.min(end - first, LANES)):
                i = first + j
                p = base + ti.cast(r[j], ti.i32) * columns + ti.cast(c[j], ti.i32)
                if bins > 1:
                    p += points.bin[i] * channels * plane
                low = vec4(w00[j], w01[j], w00[j], w01[j])
                high = vec4(w10[j], w11[j], w10[j], w11[j])
                k = 0
                while k + 1 < channels:
                    nodes = two_nodes(image, p, p + plane) * low
                    nodes = nodes + two_nodes(image, p + columns, p + plane + columns) * high
                    value[i, k] = nodes[0] + nodes[1]
                    value[i, k + 1] = nodes[2] + nodes[3]
                    k += 2
                    p += 2 * plane
                if k < channels:
                    nodes = two_nodes(image, p, p) * low + two_nodes(image, p + columns, p + columns) * high
                    value[i, k] = nodes[0] + nodes[1]
            first += LANES

    @kernel
    def gather_points(
        tid,
        world_offset: ti.i32,
        chunks: ti.i32,
        stencil: t.Stencil,
        bins: ti.i32,
        channel_offset: ti.i32,
        points: t.Points,
        image: t.image,
        value: t.values,
    ):
        """Gather the image at points: the transpose of the splat with the same stencil."""
        world = world_offset + tid // chunks
        first = points.start[world] + (tid % chunks) * CHUNK
        end = ti.min(first + CHUNK, points.start[world] + points.count[world])
        if ti.static(stencil.kernel == BILINEAR):
            gather_linear(world, first, end, stencil, bins, channel_offset, points, image, value)
        else:
            channels = value.shape[1]
            rows = image.shape[2]
            columns = image.shape[3]
            plane = rows * columns
            base = (world * image.shape[1] + channel_offset) * plane
            while first < end:
                x, y = s.coordinates(points, first, end)
                block = s.block_at(stencil.kernel, stencil, x, y, points.origin[world], rows, columns)
                for j in range(ti.min(end - first, LANES)):
                    i = first + j
                    place = s.place_of(stencil.kernel, block, j, rows, columns)
                    own = base
                    if bins > 1:
                        own += points.bin[i] * channels * plane
                    few, factor, w0, w1, w2, w3 = s.weigh(stencil.kernel, stencil, place, columns)
                    if factor == 0.0:
                        near = s.is_finite(place) and stencil.nearest != 0 and stencil.normalize != 0
                        at = own + s.nearest_node(place.y, rows) * columns + s.nearest_node(place.x, columns)
                        for c in range(channels):
                            node = real(0.0)
                            if near:
                                node = image[0, 0, 0, at + c * plane]
                            value[i, c] = node
                    elif few:
                        at = own + place.r0 * columns + place.first
                        for c in range(channels):
                            found = vector(0.0) + w0 * lanes.load(image, at)
                            if place.r1 > place.r0:
                                found = found + w1 * lanes.load(image, at + columns)
                                if place.r1 > place.r0 + 1:
                                    found = found + w2 * lanes.load(image, at + 2 * columns)
                                    if place.r1 > place.r0 + 2:
                                        found = found + w3 * lanes.load(image, at + 3 * columns)
                            value[i, c] = lanes.fold(found) * factor
                            at += plane
                    else:
                        for c in range(channels):
                            found = vector(0.0)
                            for r in range(place.r0, place.r1 + 1):
                                for v in range(place.vectors):
                                    w = s.weight(stencil.kernel, False, place, columns, r, v)
                                    left = place.first + v * LANES
                                    found = found + w * load_columns(image, own + r * columns + left, left, columns)
                            value[i, c] = lanes.fold(found) * factor
                            own += plane
                first += LANES

    @kernel
    def gather_gradient(
        tid,
        world_offset: ti.i32,
        chunks: ti.i32,
        stencil: t.Stencil,
        bins: ti.i32,
        channel_offset: ti.i32,
        points: t.Points,
        image: t.image,
        value: t.values,
        gradient: vectors,
    ):
        """Differentiate value . gathered image by each point's place: the adjoint of splat and gather by places.

        Where weights are divided by their sum, S = w / sum w: sum_i dS_i a_i = (sum dw a - (sum w a) (sum dw) / sum w)
        / sum w, with a_i = sum_c value_c image_ci.
        """
        world = world_offset + tid // chunks
        first = points.start[world] + (tid % chunks) * CHUNK
        end = ti.min(first + CHUNK, points.start[world] + points.count[world])
        channels = value.shape[1]
        rows = image.shape[2]
        columns = image.shape[3]
        plane = rows * columns
        base = (world * image.shape[1] + channel_offset) * plane
        while first < end:
            x, y = s.coordinates(points, first, end)
            block = s.block_at(stencil.kernel, stencil, x, y, points.origin[world], rows, columns)
            for j in range(ti.min(end - first, LANES)):
                i = first + j
                place = s.place_of(stencil.kernel, block, j, rows, columns)
                gx = real(0.0)
                gy = real(0.0)
                if place.hit != 0:
                    own = base
                    if bins > 1:
                        own += points.bin[i] * channels * plane
                    added = vector(0.0)
                    wa = vector(0.0)
                    dx = vector(0.0)
                    dy = vector(0.0)
                    dxa = vector(0.0)
                    dya = vector(0.0)
                    for r in range(place.r0, place.r1 + 1):
                        for v in range(place.vectors):
                            left = place.first + v * LANES
                            at = own + r * columns + left
                            field = vector(0.0)
                            for c in range(channels):
                                field = field + load_columns(image, at, left, columns) * value[i, c]
                                at += plane
                            w = s.weight(stencil.kernel, False, place, columns, r, v)
                            wx, wy = s.gradient(stencil.kernel, place, columns, r, v)
                            added = added + w
                            wa = wa + w * field
                            dx = dx + wx
                            dy = dy + wy
                            dxa = dxa + wx * field
                            dya = dya + wy * field
                    factor = s.factor(stencil.kernel, stencil, lanes.fold(added))
                    if factor != 0.0:
                        gx = lanes.fold(dxa)
                        gy = lanes.fold(dya)
                        if ti.static(stencil.kernel > WENDLAND):
                            gx = gx * factor
                            gy = gy * factor
                        elif stencil.normalize == 0:
                            gx = gx * factor
                            gy = gy * factor
                        else:
                            sum = lanes.fold(added)
                            mean = lanes.fold(wa) / sum
                            gx = (gx - mean * lanes.fold(dx)) / sum
                            gy = (gy - mean * lanes.fold(dy)) / sum
                gradient[i] = t.vec2(gx * block.inv, gy * block.inv)
            first += LANES

    return {"gather_points": gather_points, "gather_gradient": gather_gradient}
