"""What a point reaches on a grid and with which weights: the functions that splat and gather are made of.

A point reaches a window of nodes, rows r0 .. r1 and whole vectors of columns from column ``first`` on, which is slid
into the row where it would leave it; nodes beyond h get weight 0, so that no column is tested. Radial weights are
functions of q2 = r^2 / h^2 without their constant; separable ones are products of those of two axes. Lengths are in
spacings. The code of the stencil is compiled in: a kernel for each.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np

from dc_kernels._taichi.common import scalar_types
from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.lanes import lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.sph.smoothing import BILINEAR, GAUSSIAN, WENDLAND, radial_functions
from dc_kernels.grid.fields import POINTS, STENCIL
from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import KERNELS, STENCILS, constant

FEW = 4  # rows of a window whose weights are kept: those of a support of two spacings
CONSTANTS = {STENCILS[name]: constant(name, 2) for name in KERNELS}


@cache
def grid_types(dtype: str) -> SimpleNamespace:
    """Types of the kernels' arguments: scalars, the structs ``Stencil`` and ``Points``, values and images."""
    scalars = scalar_types(dtype)
    return SimpleNamespace(
        **vars(scalars),
        Stencil=struct_type("stencil", dtype, STENCIL, constants=("kernel",)),
        Points=struct_type("points", dtype, POINTS),
        values=ti.types.ndarray(dtype=scalars.real, ndim=2),
        image=ti.types.ndarray(dtype=scalars.real, ndim=4),
    )


@cache
def stencil_functions(dtype: str) -> SimpleNamespace:
    """Functions of points on a grid.

    ``block_at`` takes LANES points by their ``coordinates``, ``place_of`` finds the window of one of them, ``weight``
    and ``gradient`` give LANES weights of a row and their derivatives by the place, ``factor`` what weights of a sum
    are multiplied with, ``weigh`` that of a window and the weights of a small one.
    """
    t, lanes, radial = grid_types(dtype), lane_functions(dtype), radial_functions(dtype)
    real, vector, vec4 = t.real, lanes.vector, t.vec4
    iota = lanes.iota
    sixth = 1.0 / 6.0
    far_outside = 1e37 if dtype == "float32" else 1e300
    # a sum of weights below it is no weight at all
    tiny = float(np.float32(1e-37)) if dtype == "float32" else 1e-300
    Block = ti.types.struct(
        x=vector, y=vector, r0=vector, r1=vector, first=vector, vectors=vector, to_column=vector, to_row=vector,
        inv=real, inv_h2=real,
    )  # fmt: skip
    Place = ti.types.struct(
        x=real, y=real, hit=ti.i32, r0=ti.i32, r1=ti.i32, first=ti.i32, vectors=ti.i32,
        to_column=real, to_row=real, inv_h2=real, wx=vector, sx=vector, wy=vec4, sy=vec4,
    )  # fmt: skip

    @ti.func
    def clip(v, low, high):
        return ti.min(ti.max(v, low), high)

    @ti.func
    def least(a, b):
        """The lesser of two numbers, or of each lane, that are no NaN: one instruction, where ``ti.min`` is three."""
        return ti.select(a < b, a, b)

    @ti.func
    def most(a, b):
        return ti.select(a > b, a, b)

    @ti.func
    def in_spacings(p, origin, inv, far):
        """Coordinates in spacings, NaN and inf kept; what is finite stays so, at most ``far`` away."""
        return least(most((p - origin) * inv, far * -1.0), far) + (p - p)

    @ti.func
    def is_finite(place: ti.template()):
        x = place.x
        y = place.y
        return x - x == 0.0 and y - y == 0.0

    @ti.func
    def nearest_node(u, nodes):
        return ti.cast(clip(u, 0.0, ti.cast(nodes - 1, real)) + 0.5, ti.i32)

    @ti.func
    def outside(place: ti.template(), rows, columns):
        x = place.x
        y = place.y
        return x < 0.0 or y < 0.0 or x > ti.cast(columns - 1, real) or y > ti.cast(rows - 1, real)

    @ti.func
    def linear_axis(v, nodes):
        """First node, weights and their derivatives of an axis with two nodes of weight; ``v``: coordinate."""
        last = ti.cast(nodes - 1, real)
        out = v < 0.0 or v > last
        u = clip(v, 0.0, last)
        begin = ti.min(ti.cast(u, ti.i32), nodes - 2)
        f = u - ti.cast(begin, real)
        slope = ti.select(out, real(0.0), real(1.0))
        return begin, vec4(1.0 - f, f, 0.0, 0.0), vec4(slope * -1.0, slope, 0.0, 0.0)

    @ti.func
    def spline_axis(v, nodes):
        """First node, weights and their derivatives of an axis with four nodes of weight."""
        last = ti.cast(nodes - 1, real)
        out = v < 0.0 or v > last
        u = clip(v, 0.0, last)
        i = ti.min(ti.cast(u, ti.i32), nodes - 2)
        f = u - ti.cast(i, real)
        c = 1.0 - f
        ww = vec4(
            c * c * c * sixth,
            (3.0 * f * f * f - 6.0 * f * f + 4.0) * sixth,
            (3.0 * c * c * c - 6.0 * c * c + 4.0) * sixth,
            f * f * f * sixth,
        )
        ss = vec4(c * c * -0.5, 1.5 * f * f - 2.0 * f, 2.0 * c - 1.5 * c * c, f * f * 0.5)
        begin = ti.max(ti.min(i - 1, nodes - ti.min(nodes, 4)), 0)
        w = vec4(0.0)
        s = vec4(0.0)
        for k in ti.static(range(4)):
            # a ghost node is the linear extrapolation of the two nodes beside it
            node = i - 1 + k
            ghost = ti.select(node < 0, 1, ti.select(node > nodes - 1, -1, 0))
            at = node + ghost - begin
            d = ti.select(out, real(0.0), ss[k])
            own = ww[k]
            if ghost != 0:
                for j in ti.static(range(4)):
                    if j == at + ghost:
                        w[j] = w[j] - own
                        s[j] = s[j] - d
                own = 2.0 * own
                d = 2.0 * d
            for j in ti.static(range(4)):
                if j == at:
                    w[j] = w[j] + own
                    s[j] = s[j] + d
        return begin, w, s

    @ti.func
    def coordinates(points: t.Points, first, end):
        """Coordinates of LANES points from the first on."""
        x = vector(0.0)
        y = vector(0.0)
        for k in ti.static(range(LANES)):
            i = ti.min(first + k, end - 1)
            x[k] = points.place[i, 0]
            y[k] = points.place[i, 1]
        return x, y

    @ti.func
    def block_at(kernel: ti.template(), stencil: t.Stencil, place_x, place_y, origin, rows, columns):
        """LANES points in lanes: one by one their dependent steps would take half of a splat."""
        block = Block()
        block.inv = 1.0 / stencil.spacing
        hs = stencil.h * block.inv
        block.inv_h2 = 1.0 / (hs * hs)
        x = in_spacings(place_x, origin[0], block.inv, vector(far_outside))
        y = in_spacings(place_y, origin[1], block.inv, vector(far_outside))
        block.x = x
        block.y = y
        if ti.static(kernel <= WENDLAND):
            beyond = vector(0.0 - hs - 2.0)
            valid = (x - x == 0.0) & (y - y == 0.0)
            u = ti.select(valid, x, beyond)
            v = ti.select(valid, y, beyond)
            u = least(most(u, beyond), vector(ti.cast(columns, real) + hs + 1.0))
            v = least(most(v, beyond), vector(ti.cast(rows, real) + hs + 1.0))
            c0 = most(ti.ceil(u - hs), vector(0.0))
            c1 = least(ti.floor(u + hs), vector(ti.cast(columns - 1, real)))
            r0 = most(ti.ceil(v - hs), vector(0.0))
            vectors = ti.floor((c1 - c0 + float(LANES)) * (1.0 / LANES))  # 0 or less where there is no column
            right = most(ti.cast(columns, real) - vectors * float(LANES), vector(0.0))
            block.first = least(c0, right)
            block.vectors = vectors
            block.r0 = r0
            block.r1 = least(ti.floor(v + hs), vector(ti.cast(rows - 1, real)))
            block.to_column = block.first - u
            block.to_row = r0 - v
        return block

    @ti.func
    def place_of(kernel: ti.template(), block: ti.template(), j, rows, columns):
        """The window of a block's point; ``hit`` is 0 where it has no nodes."""
        place = Place()
        place.x = block.x[j]
        place.y = block.y[j]
        if ti.static(kernel <= WENDLAND):
            place.inv_h2 = block.inv_h2
            place.first = ti.cast(block.first[j], ti.i32)
            place.vectors = ti.cast(block.vectors[j], ti.i32)
            place.r0 = ti.cast(block.r0[j], ti.i32)
            place.r1 = ti.cast(block.r1[j], ti.i32)
            place.to_column = block.to_column[j]
            place.to_row = block.to_row[j]
            place.hit = ti.cast(place.vectors >= 1 and place.r1 >= place.r0, ti.i32)
        elif is_finite(place):
            place.hit = 1
            place.vectors = 1
            c0 = 0
            r0 = 0
            w = vec4(0.0)
            s = vec4(0.0)
            if ti.static(kernel == BILINEAR):
                r0, w, s = linear_axis(place.y, rows)
                place.r1 = r0 + 1
            else:
                r0, w, s = spline_axis(place.y, rows)
                place.r1 = r0 + ti.min(rows, 4) - 1
            place.r0 = r0
            place.wy = w
            place.sy = s
            if ti.static(kernel == BILINEAR):
                c0, w, s = linear_axis(place.x, columns)
            else:
                c0, w, s = spline_axis(place.x, columns)
            place.first = ti.min(c0, ti.max(columns - LANES, 0))
            lane = iota() - ti.cast(c0 - place.first, real)
            for k in ti.static(range(4)):
                place.wx = ti.select(lane == vector(float(k)), vector(w[k]), place.wx)
                place.sx = ti.select(lane == vector(float(k)), vector(s[k]), place.sx)
        return place

    @ti.func
    def offset(place: ti.template(), v):
        """From the point to LANES columns."""
        return iota() + (place.to_column + ti.cast(v * LANES, real))

    @ti.func
    def inside(place: ti.template(), columns, v, w):
        """Weights without those of nodes beyond the row, which a grid narrower than the window has."""
        n = columns - (place.first + v * LANES)
        return ti.select(iota() < vector(ti.cast(n, real)), w, vector(0.0))

    @ti.func
    def held(q2):
        """All radial functions but the Gaussian are 0 at q = 1 by themselves."""
        return least(q2, vector(1.0))

    @ti.func
    def weight(kernel: ti.template(), whole: ti.template(), place: ti.template(), columns, r, v):
        w = vector(0.0)
        if ti.static(kernel <= WENDLAND):
            dx = offset(place, v)
            dy = place.to_row + ti.cast(r - place.r0, real)
            q2 = dx * dx * place.inv_h2 + dy * dy * place.inv_h2
            w = radial.w(kernel, held(q2))
            if ti.static(kernel == GAUSSIAN):
                w = ti.select(q2 <= vector(1.0), w, vector(0.0))
            if ti.static(not whole):
                w = inside(place, columns, v, w)
        else:
            w = place.wx * place.wy[r - place.r0]
        return w

    @ti.func
    def gradient(kernel: ti.template(), place: ti.template(), columns, r, v):
        """Derivatives of the weights by the two coordinates."""
        gx = vector(0.0)
        gy = vector(0.0)
        if ti.static(kernel <= WENDLAND):
            dx = offset(place, v)
            dy = place.to_row + ti.cast(r - place.r0, real)
            q2 = dx * dx * place.inv_h2 + dy * dy * place.inv_h2
            s = radial.f(kernel, held(q2))
            if ti.static(kernel == GAUSSIAN):
                s = ti.select(q2 <= vector(1.0), s, vector(0.0))
            s = inside(place, columns, v, s) * (place.inv_h2 * -1.0)
            gx = s * dx
            gy = s * dy
        else:
            gx = place.sx * place.wy[r - place.r0]
            gy = place.wx * place.sy[r - place.r0]
        return gx, gy

    @ti.func
    def factor(kernel: ti.template(), stencil: t.Stencil, sum):
        """What weights of a sum are multiplied with; 0 where the sum is no weight at all."""
        value = real(1.0)
        if ti.static(kernel <= WENDLAND):
            value = real(0.0)
            if sum > tiny:
                value = 1.0 / sum
                if stencil.normalize == 0:
                    value = ti.static(CONSTANTS.get(kernel, 1.0)) / (stencil.h * stencil.h)
        return value

    @ti.func
    def weigh(kernel: ti.template(), stencil: t.Stencil, place: ti.template(), columns):
        """Whether a window is one vector of few rows, what weights are multiplied with, and the weights of these rows.

        The second is 0 where the point has no weight.
        """
        few = place.vectors == 1 and place.first + LANES <= columns and place.r1 - place.r0 < FEW
        share = real(0.0)
        w0 = vector(0.0)
        w1 = vector(0.0)
        w2 = vector(0.0)
        w3 = vector(0.0)
        if place.hit != 0:
            added = vector(0.0)
            if few:
                w0 = weight(kernel, True, place, columns, place.r0, 0)
                if place.r1 > place.r0:
                    w1 = weight(kernel, True, place, columns, place.r0 + 1, 0)
                    if place.r1 > place.r0 + 1:
                        w2 = weight(kernel, True, place, columns, place.r0 + 2, 0)
                        if place.r1 > place.r0 + 2:
                            w3 = weight(kernel, True, place, columns, place.r0 + 3, 0)
                added = w0 + w1 + w2 + w3
            elif ti.static(kernel <= WENDLAND):
                for r in range(place.r0, place.r1 + 1):
                    for v in range(place.vectors):
                        added = added + weight(kernel, False, place, columns, r, v)
            share = factor(kernel, stencil, lanes.fold(added))
        return few, share, w0, w1, w2, w3

    functions = (
        coordinates,
        block_at,
        place_of,
        is_finite,
        weight,
        weigh,
        gradient,
        factor,
        outside,
        nearest_node,
        least,
        most,
        in_spacings,
    )
    return SimpleNamespace(far_outside=far_outside, **{function.__name__: function for function in functions})
