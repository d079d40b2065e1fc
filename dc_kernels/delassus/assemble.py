"""W = J M^-1 J^T of contacts and joints, in one pass over the rows of each body."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.runtime.backends import bind, make_kernels, on_numpy

if TYPE_CHECKING:
    from dc_kernels.runtime.launches import Calls


@functools.cache
def _calls(backend: str) -> Calls:
    from dc_kernels.runtime.launches import Calls

    return Calls(make_kernels(backend, "delassus.assemble")["assemble_rows"])


def assemble_rows(
    jacobian: np.ndarray, body: np.ndarray, inverse: np.ndarray, backend: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Multiply J M^-1 J^T for n rows that act on two bodies each.

    Args:
        jacobian: normal and tangential direction of each row at each of its bodies, (n, 2, 2, 3) float64.
        body: its bodies, (n, 2) integers.
        inverse: inverse masses and moments of inertia of these bodies, (n, 2, 3) float64 [1/kg, 1/(kg m^2)].
        backend: of the kernel.

    Returns:
        row_start (n + 1,) int32, column (blocks,) int32 and block (blocks, 2, 2) of a ``DelassusProblem``, columns in
        ascending order; a row that no body of moves has none.
    """
    n = len(body)
    ends = np.ascontiguousarray(body, np.int32).ravel()
    ends = ends - (ends.min() if n else 0)
    count = np.bincount(ends[inverse.any(axis=-1).ravel()])
    most = int((count.astype(np.int64) ** 2).sum())  # each body's rows with each other
    values: dict[str, Any] = {
        "body": ends,
        "jacobian": np.ascontiguousarray(jacobian, np.float64).ravel(),
        "inverse": np.ascontiguousarray(inverse, np.float64).ravel(),
        "body_first": np.empty((int(ends.max()) if n else 0) + 2, np.int32),
        "body_row": np.empty(2 * n, np.int32),
        "row_start": np.empty(n + 1, np.int32),
        "column": np.empty(most, np.int32),
        "block": np.empty(4 * most),
    }
    if on_numpy(backend):
        bind(make_kernels(backend, "delassus.assemble")["assemble_rows"], 1, values, "cpu")()
    else:
        _calls(backend)(values, 1, 1)
    start = values["row_start"]
    blocks = int(start[-1])
    return start, values["column"][:blocks], values["block"][: 4 * blocks].reshape(-1, 2, 2)
