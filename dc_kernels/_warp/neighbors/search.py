"""Cells sorted by place, in native code for the CPU, swept for neighbours; and queries of a tree of boxes.

Cells are squares (cubes) a little larger than the radius, so a point's neighbours lie in its own cell and the 8 (26)
around it. A line is the row of cells along x with one key (row, or layer and row); the points of a line are sorted by
their column. A sweep walks along a line and along a neighbouring one at once and tests LANES points at a time, from
the first column that can hold a neighbour to the last: there is no table of cells, so only occupied lines cost time
and memory, however wide the domain (Teschner et al. 2003 hash the cells for the same end; Green 2010 sorts them).

Lines are grouped by counting when there are few (a dense domain), else their keys are radix sorted and numbered
first. The columns of a line are counted too, or radix sorted where the line has wide gaps. Both sorts keep the order
of the points, so a cell's points come by index. At most 2^30 cells lie along an axis: in a domain wider than 2^30
radii they are larger, which costs time but loses nothing.

Cells are found in float64 with an error of 2^-22 cells at most, which CELL_SLACK of the side allows for. The distance
test is done in the points' dtype and without contraction.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.groups import struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.neighbors.fields import CELLS

LANES = 16  # points tested at once, and the padding behind sorted points and pairs
CELL_SLACK = 2.0**-16
MAX_CELLS = 2.0**30
MAX_FOUND = 2**31 - 1  # a search stops above: the arrays could not be larger
SPARE = 4  # up to so many lines for a point are counted, more are sorted by key; columns alike


def code(dtype: str, dim: int, *names: str) -> str:
    """The native code of headers in ``native/neighbors`` for a scalar type and a number of dimensions."""
    files = ("prelude.h", *(f"neighbors/{name}.h" for name in ("prelude", *names)))
    macros = {"CELL_SLACK": CELL_SLACK, "MAX_CELLS": MAX_CELLS, "MAX_FOUND": MAX_FOUND, "SPARE": SPARE}
    return native_code(*files, dtype=dtype, DIM=dim, LANES=LANES, **macros)


@cache
def kernels(dtype: str, dim: int) -> dict[str, Any]:
    """``bound_points``, ``sort_points``, ``sweep_pairs``, ``sweep_lists``, ``order_lists``; one thread a launch.

    A launch takes ``worlds`` worlds from ``world_offset`` on, one after the other.
    """
    real = scalar_types(dtype).real
    Cells = struct_type("cells", dtype, CELLS)
    integers, longs = wp.array(dtype=wp.int32), wp.array(dtype=wp.int64)
    values, pairs, doubles = (wp.array(dtype=kind, ndim=2) for kind in (real, wp.int32, wp.float64))
    tables = wp.array(dtype=wp.int64, ndim=2)
    module = kernel_module("neighbors", dtype, dim)

    @wp.func_native(code(dtype, dim, "bound"))
    def bound(
        world_offset: wp.int32,
        worlds: wp.int32,
        fresh: wp.int32,
        start: integers,
        point: values,
        lower: doubles,
        upper: doubles,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def bound_points(
        world_offset: int,
        worlds: int,
        fresh: int,
        start: integers,
        point: values,
        # In, out: the box so far; (inf, -inf) is the empty one, NaN that of points that are not finite.
        lower: doubles,
        upper: doubles,
    ):
        """Widen the box of each world by its points, from the empty one where ``fresh`` is 1."""
        bound(world_offset, worlds, fresh, start, point, lower, upper)

    @wp.func_native(code(dtype, dim, "sort"))
    def sort(
        world_offset: wp.int32,
        worlds: wp.int32,
        reach: wp.float64,
        point: values,
        lower: doubles,
        upper: doubles,
        scratch: tables,
        cells: Cells,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sort_points(
        world_offset: int,
        worlds: int,
        reach: wp.float64,
        point: values,
        lower: doubles,
        upper: doubles,
        # Scratch, for one world at a time:
        scratch: tables,
        # Out:
        cells: Cells,
    ):
        """Sort points into cells of a side just above ``reach``."""
        sort(world_offset, worlds, reach, point, lower, upper, scratch, cells)

    @wp.func_native(code(dtype, dim, "near", "pairs"))
    def find_pairs(world_offset: wp.int32, worlds: wp.int32, limit: real, cells: Cells, found: longs, pair: pairs): ...

    @wp.kernel(module=module, enable_backward=False)
    def sweep_pairs(
        world_offset: int,
        worlds: int,
        limit: real,
        cells: Cells,
        # Out:
        found: longs,
        pair: pairs,
    ):
        """Find pairs at most sqrt(limit) apart, world by world; count on when there is no room.

        All are stored if those found and LANES more have room.
        """
        find_pairs(world_offset, worlds, limit, cells, found, pair)

    @wp.func_native(code(dtype, dim, "near", "lists"))
    def find_lists(
        world_offset: wp.int32,
        worlds: wp.int32,
        limit: real,
        queries: Cells,
        cells: Cells,
        list_span: tables,
        found: longs,
        entry: integers,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sweep_lists(
        world_offset: int,
        worlds: int,
        limit: real,
        queries: Cells,
        cells: Cells,
        # Out:
        # of each query, first entry and number:
        list_span: tables,
        found: longs,
        entry: integers,
    ):
        """Find the points at most sqrt(limit) from each query, the lists in the order of the sorted queries.

        Counts on when there is no room; all are stored if those found and LANES more have room.
        """
        find_lists(world_offset, worlds, limit, queries, cells, list_span, found, entry)

    @wp.func_native(code(dtype, dim, "order"))
    def order(
        query_offset: wp.int32,
        queries: wp.int32,
        list_span: tables,
        list_start: longs,
        entry: integers,
        index: integers,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def order_lists(
        query_offset: int,
        queries: int,
        list_span: tables,
        list_start: longs,
        entry: integers,
        # Out:
        index: integers,
    ):
        """Copy the lists in the order of the queries, each ascending."""
        order(query_offset, queries, list_span, list_start, entry, index)

    return {
        "bound_points": bound_points,
        "sort_points": sort_points,
        "sweep_pairs": sweep_pairs,
        "sweep_lists": sweep_lists,
        "order_lists": order_lists,
    }


@cache
def tree_kernels(dtype: str) -> dict[str, Any]:
    """``query_tree``; one thread a query."""
    real = scalar_types(dtype).real
    module = kernel_module("tree", dtype)

    @wp.kernel(module=module, enable_backward=False)
    def query_tree(
        fill: int,
        ahead: int,
        tree: wp.uint64,
        limit: real,
        lower: wp.array(dtype=wp.vec3),
        upper: wp.array(dtype=wp.vec3),
        query: wp.array2d(dtype=real),
        point: wp.array2d(dtype=real),
        list_start: wp.array(dtype=wp.int64),
        # Out:
        list_count: wp.array(dtype=wp.int64),
        index: wp.array(dtype=wp.int32),
    ):
        """Count the points of each query's box that are at most sqrt(limit) away, or store them.

        With ``ahead`` the queries are the points, and only those behind the query in their order count.
        """
        q = wp.tid()
        boxes = wp.bvh_query_aabb(tree, lower[q], upper[q])
        p = int(0)
        n = wp.int64(0)
        while wp.bvh_query_next(boxes, p):
            if ahead == 0 or p > q:
                d = query[q, 0] - point[p, 0]
                square = d * d
                for k in range(1, point.shape[1]):
                    d = query[q, k] - point[p, k]
                    square += d * d
                if square <= limit:
                    if fill == 1:
                        index[int(list_start[q] + n)] = p
                    n += wp.int64(1)
        list_count[q] = n

    return {"query_tree": query_tree}
