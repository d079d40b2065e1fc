"""W = J M^-1 J^T of rows that act on two bodies each, in compressed rows of blocks; one thread a problem."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.native import native_code


@cache
def kernels() -> dict[str, Any]:
    """``assemble_rows``, in float64."""
    module = kernel_module("assemble", "float64")

    @wp.func_native(native_code("delassus/assemble.h", dtype="float64"))
    def multiply(
        body: wp.array(dtype=wp.int32),
        jacobian: wp.array(dtype=wp.float64),
        inverse: wp.array(dtype=wp.float64),
        body_first: wp.array(dtype=wp.int32),
        body_row: wp.array(dtype=wp.int32),
        row_start: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        block: wp.array(dtype=wp.float64),
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def assemble_rows(
        body: wp.array(dtype=wp.int32),
        jacobian: wp.array(dtype=wp.float64),
        inverse: wp.array(dtype=wp.float64),
        # scratch:
        body_first: wp.array(dtype=wp.int32),
        body_row: wp.array(dtype=wp.int32),
        # out:
        row_start: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        block: wp.array(dtype=wp.float64),
    ):
        """Blocks of each row of W in the order of their columns."""
        multiply(body, jacobian, inverse, body_first, body_row, row_start, column, block)

    return {"assemble_rows": assemble_rows}
