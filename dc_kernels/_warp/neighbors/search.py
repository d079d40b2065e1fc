"""Neighbour search: points sorted by cell and swept (``cells``, ``sweeps``), and queries of a tree of boxes."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.neighbors.cells import cell_functions
from dc_kernels._warp.neighbors.sweeps import sweep_functions


@cache
def kernels(dtype: str, dim: int) -> dict[str, Any]:
    """``bound_points``, ``sort_points``, ``sweep_pairs``, ``sweep_lists``, ``order_lists``; one thread a launch.

    A launch takes ``worlds`` worlds from ``world_offset`` on, one after the other.
    """
    real = scalar_types(dtype).real
    module = kernel_module("neighbors", dtype, dim)
    native = {**cell_functions(dtype, dim), **sweep_functions(dtype, dim)}
    native_bound, native_sort = native["bound_points"], native["sort_points"]
    native_pairs, native_lists, native_order = native["sweep_pairs"], native["sweep_lists"], native["order_lists"]

    @wp.kernel(module=module, enable_backward=False)
    def bound_points(
        world_offset: int,
        worlds: int,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        # In, out: the box so far; (inf, -inf) is the empty one.
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
    ):
        """Box of each world's points, and of what it held before."""
        native_bound(world_offset, worlds, start, point, lower, upper)

    @wp.kernel(module=module, enable_backward=False)
    def sort_points(
        world_offset: int,
        worlds: int,
        reach: wp.float64,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
        # Scratch, for one world at a time:
        scratch: wp.array2d(dtype=wp.int64),
        # Out: points by line, then column, then index; a world's lines begin at start[w], their starts at start[w] + w.
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
    ):
        """Points sorted into cells of a side just above ``reach``."""
        native_sort(
            world_offset,
            worlds,
            reach,
            start,
            point,
            lower,
            upper,
            scratch,
            place,
            number,
            column,
            line_key,
            line_start,
            line_count,
            line_stride,
        )

    @wp.kernel(module=module, enable_backward=False)
    def sweep_pairs(
        world_offset: int,
        worlds: int,
        limit: real,
        start: wp.array(dtype=wp.int32),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
        # Out:
        found: wp.array(dtype=wp.int64),
        pair: wp.array2d(dtype=wp.int32),
    ):
        """Pairs at most sqrt(limit) apart, a world's after those of the one before; counts on when there is no room.

        All are stored if those found and LANES more have room.
        """
        native_pairs(
            world_offset,
            worlds,
            limit,
            start,
            place,
            number,
            column,
            line_key,
            line_start,
            line_count,
            line_stride,
            found,
            pair,
        )

    @wp.kernel(module=module, enable_backward=False)
    def sweep_lists(
        world_offset: int,
        worlds: int,
        limit: real,
        query_start: wp.array(dtype=wp.int32),
        query_place: wp.array2d(dtype=real),
        query_number: wp.array(dtype=wp.int32),
        query_column: wp.array(dtype=wp.int32),
        query_line_key: wp.array(dtype=wp.int64),
        query_line_start: wp.array(dtype=wp.int32),
        query_line_count: wp.array(dtype=wp.int32),
        start: wp.array(dtype=wp.int32),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
        # Out:
        # of each query, first entry and number:
        list_span: wp.array2d(dtype=wp.int64),
        found: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
    ):
        """The points at most sqrt(limit) from each query, the lists in the order of the sorted queries.

        Counts on when there is no room; all are stored if those found and LANES more have room.
        """
        native_lists(
            world_offset,
            worlds,
            limit,
            query_start,
            query_place,
            query_number,
            query_column,
            query_line_key,
            query_line_start,
            query_line_count,
            start,
            place,
            number,
            column,
            line_key,
            line_start,
            line_count,
            line_stride,
            list_span,
            found,
            entry,
        )

    @wp.kernel(module=module, enable_backward=False)
    def order_lists(
        query_offset: int,
        queries: int,
        list_span: wp.array2d(dtype=wp.int64),
        list_start: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
        # Out:
        index: wp.array(dtype=wp.int32),
    ):
        """Lists in the order of the queries, each ascending."""
        native_order(
            query_offset,
            queries,
            list_span,
            list_start,
            entry,
            index,
        )

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
