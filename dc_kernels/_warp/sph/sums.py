"""SPH sums over lists of neighbours, and what positions pull from them; native loops for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.groups import struct_type
from dc_kernels._warp.native import native_code
from dc_kernels._warp.sph.smoothing import block_macros
from dc_kernels.sph.fields import LISTS, SUM
from dc_kernels.sph.quantities import CHUNK, Quantity

N_CHUNK = wp.constant(CHUNK)


def _code(dtype: str, name: str) -> str:
    """The native code of a loop over queries."""
    quantities = {f"QUANTITY_{quantity.name}": int(quantity) for quantity in Quantity}
    files = ("prelude.h", "sph/radial.h", "sph/block.h", name)
    return native_code(*files, dtype=dtype, **block_macros(dtype), **quantities)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``sum_neighbors`` and ``pull_neighbors``; a thread takes CHUNK queries."""
    Sum, Lists = struct_type("sum", dtype, SUM), struct_type("lists", dtype, LISTS)
    values = wp.array(dtype=scalar_types(dtype).real, ndim=2)
    module = kernel_module("sph", dtype)

    @wp.func_native(_code(dtype, "sph/sum.h"))
    def sum_range(
        first: wp.int32,
        last: wp.int32,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        value: values,
        out: values,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sum_neighbors(
        chunk_offset: int,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        value: values,
        # Out:
        out: values,
    ):
        """Add up the neighbours' values times W, grad W, lap W, or . grad W (Wu 2018, equations 3.7 and 3.8)."""
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        sum_range(first, last, sum, lists, query, point, value, out)

    @wp.func_native(_code(dtype, "sph/pull.h"))
    def pull_range(
        first: wp.int32,
        last: wp.int32,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        query_value: values,
        value: values,
        out: values,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def pull_neighbors(
        chunk_offset: int,
        sum: Sum,
        lists: Lists,
        query: values,
        point: values,
        query_value: values,
        value: values,
        # Out:
        out: values,
    ):
        """Differentiate sum(query_value . sum_neighbors(value)) by the queries' positions.

        Swapped, the queries are the particles of that sum and the neighbours its queries: by the particles' positions.
        """
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        pull_range(first, last, sum, lists, query, point, query_value, value, out)

    return {"sum_neighbors": sum_neighbors, "pull_neighbors": pull_neighbors}
