"""Sweeps over sorted cells (``cells``) that find pairs and lists of neighbours, in native code for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.neighbors.cells import code


@cache
def sweep_functions(dtype: str, dim: int) -> dict[str, Any]:
    """``sweep_pairs``, ``sweep_lists`` and ``order_lists`` of ``neighbors``."""
    real = scalar_types(dtype).real

    @wp.func_native(code(dtype, dim, "near", "pairs"))
    def sweep_pairs(
        world_offset: wp.int32,
        worlds: wp.int32,
        limit: real,
        start: wp.array(dtype=wp.int32),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
        found: wp.array(dtype=wp.int64),
        pair: wp.array2d(dtype=wp.int32),
    ): ...

    @wp.func_native(code(dtype, dim, "near", "lists"))
    def sweep_lists(
        world_offset: wp.int32,
        worlds: wp.int32,
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
        list_span: wp.array2d(dtype=wp.int64),
        found: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
    ): ...

    @wp.func_native(code(dtype, dim, "order"))
    def order_lists(
        query_offset: wp.int32,
        queries: wp.int32,
        list_span: wp.array2d(dtype=wp.int64),
        list_start: wp.array(dtype=wp.int64),
        entry: wp.array(dtype=wp.int32),
        index: wp.array(dtype=wp.int32),
    ): ...

    return {"sweep_pairs": sweep_pairs, "sweep_lists": sweep_lists, "order_lists": order_lists}
