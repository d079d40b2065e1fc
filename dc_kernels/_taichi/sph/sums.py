"""SPH sums over lists of neighbours, and what positions pull from them; eight neighbours at a time in lanes."""

from functools import cache
from types import SimpleNamespace
from typing import Any

from dc_kernels._taichi.common import scalar_types
from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.lanes import lane_functions
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.sph.smoothing import radial_functions
from dc_kernels.solve.rows import LANES
from dc_kernels.sph.fields import LISTS, SUM
from dc_kernels.sph.quantities import CHUNK, Quantity

VALUE, GRADIENT, LAPLACIAN = int(Quantity.VALUE), int(Quantity.GRADIENT), int(Quantity.LAPLACIAN)
BLOCK = 64  # neighbours whose lanes are added up before a sum takes them, as in Warp's kernels


@cache
def neighbor_functions(dtype: str) -> SimpleNamespace:
    """``take``, LANES neighbours of a query with their offsets over h, and ``column``, a column of their values."""
    real, lanes = scalar_types(dtype).real, lane_functions(dtype)
    vector, iota = lanes.vector, lanes.iota
    values = ti.types.ndarray(dtype=real, ndim=2)
    indices = ti.types.vector(LANES, ti.i32)
    Near = ti.types.struct(at=indices, e0=vector, e1=vector, e2=vector, q2=vector, used=vector)

    @ti.func
    def take(inv_h, lists: ti.template(), first, here, end, x, point: values):
        """Neighbours from ``here`` on, and the first one of the block, ``first``, in lanes behind the last.

        ``used`` is 1 for the neighbours and 0 behind the last.
        """
        near = Near()
        for k in ti.static(range(LANES)):
            from_ = first
            if here + k < end:
                from_ = here + k
            i = lists[ti.cast(from_, ti.i32)]
            near.at[k] = i
            near.e0[k] = point[i, 0]
            near.e1[k] = point[i, 1]
        near.e0 = (x[0] - near.e0) * inv_h
        near.e1 = (x[1] - near.e1) * inv_h
        r2 = near.e0 * near.e0 + near.e1 * near.e1
        if point.shape[1] == 3:
            for k in ti.static(range(LANES)):
                near.e2[k] = point[near.at[k], 2]
            near.e2 = (x[2] - near.e2) * inv_h
            r2 = r2 + near.e2 * near.e2
        # the list decides who is within reach; round-off must not
        near.q2 = ti.select(r2 < vector(1.0), r2, vector(1.0))
        near.used = ti.select(iota() < vector(ti.cast(end - here, real)), vector(1.0), vector(0.0))
        return near

    @ti.func
    def masked(near: ti.template(), weight):
        return ti.select(near.used > vector(0.0), weight, vector(0.0))

    @ti.func
    def column(near: ti.template(), value: values, c):
        """Column c of the values of the neighbours."""
        numbers = vector(0.0)
        for k in ti.static(range(LANES)):
            numbers[k] = value[near.at[k], c]
        return numbers

    @ti.func
    def place(query: values, q):
        """A query's coordinates, the third 0 in the plane."""
        z = real(0.0)
        if query.shape[1] == 3:
            z = query[q, 2]
        return ti.Vector([query[q, 0], query[q, 1], z])

    return SimpleNamespace(take=take, masked=masked, column=column, place=place)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``sum_neighbors`` and ``pull_neighbors``; a thread takes CHUNK queries."""
    Sum, Lists = struct_type("sum", dtype, SUM, constants=("kernel", "quantity")), struct_type("lists", dtype, LISTS)
    lanes, radial, n = lane_functions(dtype), radial_functions(dtype), neighbor_functions(dtype)
    real, vector, total = scalar_types(dtype).real, lanes.vector, lanes.total
    values = ti.types.ndarray(dtype=real, ndim=2)

    @kernel
    def sum_neighbors(
        tid,
        chunk_offset: ti.i32,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        value: values,
        out: values,
    ):
        """Add up the neighbours' values times W, grad W, lap W, or . grad W (Wu 2018, equations 3.7 and 3.8)."""
        begin = (tid + chunk_offset) * CHUNK
        dim = point.shape[1]
        channels = value.shape[1]
        if ti.static(sum.quantity != GRADIENT):
            channels = out.shape[1]
        inv_h = 1.0 / sum.h
        for q in range(begin, ti.min(begin + CHUNK, query.shape[0])):
            x = n.place(query, q)
            for c in range(out.shape[1]):
                out[q, c] = 0.0
            first = lists.start[q]
            last = lists.start[q + 1]
            while first < last:
                end = ti.min(first + BLOCK, last)
                for c in range(channels):
                    added = vector(0.0)
                    along_y = vector(0.0)
                    along_z = vector(0.0)
                    here = first
                    while here < end:
                        near = n.take(inv_h, lists.index, first, here, end, x, point)
                        if ti.static(sum.quantity == VALUE):
                            w = n.masked(near, radial.w(sum.kernel, near.q2))
                            added = added + w * n.column(near, value, c)
                        elif ti.static(sum.quantity == LAPLACIAN):
                            f = radial.f(sum.kernel, near.q2)
                            w = ti.cast(dim, real) * f + near.q2 * radial.g(sum.kernel, near.q2)
                            added = added + n.masked(near, w) * n.column(near, value, c)
                        elif ti.static(sum.quantity == GRADIENT):
                            a = n.masked(near, radial.f(sum.kernel, near.q2)) * n.column(near, value, c)
                            added = added + a * near.e0
                            along_y = along_y + a * near.e1
                            along_z = along_z + a * near.e2
                        else:
                            a = near.e0 * n.column(near, value, c * dim) + near.e1 * n.column(near, value, c * dim + 1)
                            if dim == 3:
                                a = a + near.e2 * n.column(near, value, c * dim + 2)
                            added = added + n.masked(near, radial.f(sum.kernel, near.q2)) * a
                        here += LANES
                    if ti.static(sum.quantity == GRADIENT):
                        k = c * dim
                        out[q, k] = out[q, k] + sum.scale * total(added)
                        out[q, k + 1] = out[q, k + 1] + sum.scale * total(along_y)
                        if dim == 3:
                            out[q, k + 2] = out[q, k + 2] + sum.scale * total(along_z)
                    else:
                        out[q, c] = out[q, c] + sum.scale * total(added)
                first = end

    @kernel
    def pull_neighbors(
        tid,
        chunk_offset: ti.i32,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        query_value: values,
        value: values,
        out: values,
    ):
        """Differentiate sum(query_value . sum_neighbors(value)) by the queries' positions.

        Swapped, the queries are the particles of that sum and the neighbours its queries: by the particles' positions.
        """
        begin = (tid + chunk_offset) * CHUNK
        dim = point.shape[1]
        inv_h = 1.0 / sum.h
        channels = value.shape[1]
        scale = sum.scale
        if ti.static(sum.quantity == GRADIENT):
            # one side's values have a component for each axis: the queries', or, if swapped, the neighbours'
            if sum.swapped != 0:
                scale = scale * -1.0
                channels = query_value.shape[1]
        for q in range(begin, ti.min(begin + CHUNK, query.shape[0])):
            x = n.place(query, q)
            for k in range(dim):
                out[q, k] = 0.0
            first = lists.start[q]
            last = lists.start[q + 1]
            while first < last:
                end = ti.min(first + BLOCK, last)
                gx = vector(0.0)
                gy = vector(0.0)
                gz = vector(0.0)
                here = first
                while here < end:
                    near = n.take(inv_h, lists.index, first, here, end, x, point)
                    if ti.static(sum.quantity != GRADIENT):
                        a = vector(0.0)
                        for c in range(channels):
                            a = a + query_value[q, c] * n.column(near, value, c)
                        w = vector(0.0)
                        if ti.static(sum.quantity == VALUE):
                            w = radial.f(sum.kernel, near.q2)
                        else:
                            w = ti.cast(dim + 2, real) * radial.g(sum.kernel, near.q2)
                            w = w + near.q2 * radial.k(sum.kernel, near.q2)
                        a = a * n.masked(near, w)
                        gx = gx + a * near.e0
                        gy = gy + a * near.e1
                        gz = gz + a * near.e2
                    else:
                        sx = vector(0.0)
                        sy = vector(0.0)
                        sz = vector(0.0)
                        for c in range(channels):
                            if sum.swapped != 0:
                                own = query_value[q, c]
                                sx = sx + own * n.column(near, value, c * dim)
                                sy = sy + own * n.column(near, value, c * dim + 1)
                                if dim == 3:
                                    sz = sz + own * n.column(near, value, c * dim + 2)
                            else:
                                a = n.column(near, value, c)
                                sx = sx + query_value[q, c * dim] * a
                                sy = sy + query_value[q, c * dim + 1] * a
                                if dim == 3:
                                    sz = sz + query_value[q, c * dim + 2] * a
                        f = n.masked(near, radial.f(sum.kernel, near.q2))
                        along = near.e0 * sx + near.e1 * sy
                        if dim == 3:
                            along = along + near.e2 * sz
                        along = along * n.masked(near, radial.g(sum.kernel, near.q2))
                        gx = gx + (f * sx + along * near.e0)
                        gy = gy + (f * sy + along * near.e1)
                        gz = gz + (f * sz + along * near.e2)
                    here += LANES
                out[q, 0] = out[q, 0] + scale * total(gx)
                out[q, 1] = out[q, 1] + scale * total(gy)
                if dim == 3:
                    out[q, 2] = out[q, 2] + scale * total(gz)
                first = end

    return {"sum_neighbors": sum_neighbors, "pull_neighbors": pull_neighbors}
