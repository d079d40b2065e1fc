"""SPH sums over lists of neighbours, and what positions pull from them; native loops for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.sph.smoothing import block_macros
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
    real = scalar_types(dtype).real
    module = kernel_module("sph", dtype)

    @wp.func_native(_code(dtype, "sph/sum.h"))
    def sum_range(
        first: wp.int32,
        last: wp.int32,
        kernel: wp.int32,
        quantity: wp.int32,
        inv_h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        out: wp.array2d(dtype=real),
    ): ...

    @wp.func_native(_code(dtype, "sph/pull.h"))
    def pull_range(
        first: wp.int32,
        last: wp.int32,
        kernel: wp.int32,
        quantity: wp.int32,
        swapped: wp.int32,
        inv_h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        query_value: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        out: wp.array2d(dtype=real),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def sum_neighbors(
        chunk_offset: int,
        kernel: int,
        quantity: int,
        h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        # out:
        out: wp.array2d(dtype=real),
    ):
        """Seed, equations 3.7 and 3.8: out = sum of the neighbours' values times W, grad W, lap W, or . grad W."""
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        sum_range(
            first, last, kernel, quantity, real(1.0) / h, scale,
            query, neighbor_start, neighbor_index, point, value, out,
        )  # fmt: skip

    @wp.kernel(module=module, enable_backward=False)
    def pull_neighbors(
        chunk_offset: int,
        kernel: int,
        quantity: int,
        swapped: int,
        h: real,
        scale: real,
        query: wp.array2d(dtype=real),
        neighbor_start: wp.array(dtype=wp.int64),
        neighbor_index: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        query_value: wp.array2d(dtype=real),
        value: wp.array2d(dtype=real),
        # out:
        out: wp.array2d(dtype=real),
    ):
        """The gradient of sum(query_value . sum_neighbors(value)) by the queries' positions.

        Swapped, the queries are the particles of that sum and the neighbours its queries: by the particles' positions.
        """
        first = (wp.tid() + chunk_offset) * N_CHUNK
        last = wp.min(first + N_CHUNK, query.shape[0])
        pull_range(
            first, last, kernel, quantity, swapped, real(1.0) / h, scale,
            query, neighbor_start, neighbor_index, point, query_value, value, out,
        )  # fmt: skip

    return {"sum_neighbors": sum_neighbors, "pull_neighbors": pull_neighbors}
