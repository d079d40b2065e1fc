"""Cells sorted by place, in native code for the CPU; ``sweeps`` finds neighbours in them.

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

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.native import native_code

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
def cell_functions(dtype: str, dim: int) -> dict[str, Any]:
    """``bound_points`` and ``sort_points`` of ``neighbors``."""
    real = scalar_types(dtype).real

    @wp.func_native(code(dtype, dim, "bound"))
    def bound_points(
        world_offset: wp.int32,
        worlds: wp.int32,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
    ): ...

    @wp.func_native(code(dtype, dim, "sort"))
    def sort_points(
        world_offset: wp.int32,
        worlds: wp.int32,
        reach: wp.float64,
        start: wp.array(dtype=wp.int32),
        point: wp.array2d(dtype=real),
        lower: wp.array2d(dtype=wp.float64),
        upper: wp.array2d(dtype=wp.float64),
        scratch: wp.array2d(dtype=wp.int64),
        place: wp.array2d(dtype=real),
        number: wp.array(dtype=wp.int32),
        column: wp.array(dtype=wp.int32),
        line_key: wp.array(dtype=wp.int64),
        line_start: wp.array(dtype=wp.int32),
        line_count: wp.array(dtype=wp.int32),
        line_stride: wp.array(dtype=wp.int64),
    ): ...

    return {"bound_points": bound_points, "sort_points": sort_points}
