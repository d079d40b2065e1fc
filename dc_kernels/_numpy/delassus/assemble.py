"""W = J M^-1 J^T of rows that act on two bodies each, as a product of matrices."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.common import Array, Kernels


def kernels() -> Kernels:
    """``assemble_rows`` by name."""
    return {"assemble_rows": assemble_rows}


def assemble_rows(
    tid: int,
    body: Array,
    jacobian: Array,
    inverse: Array,
    body_first: Array,
    body_row: Array,
    row_start: Array,
    column: Array,
    block: Array,
) -> None:
    """Blocks of each row of W in the order of their columns; no scratch is needed."""
    n = len(body) // 2
    ends, parts, masses = body.reshape(n, 2), jacobian.reshape(n, 2, 2, 3), inverse.reshape(n, 2, 3)
    row_start[0] = blocks = 0
    for i in range(n):
        for k in range(n):
            found, shared = np.zeros((2, 2)), False
            for side in (0, 1):
                for other in (0, 1):
                    if ends[i, side] == ends[k, other] and masses[i, side].any():
                        found += parts[i, side] * masses[i, side] @ parts[k, other].T
                        shared = True
            if shared:
                column[blocks] = k
                block[4 * blocks : 4 * blocks + 4] = found.ravel()
                blocks += 1
        row_start[i + 1] = blocks
