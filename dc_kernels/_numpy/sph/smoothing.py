"""A neighbour's weight by term, from the host's radial functions (``dc_kernels.sph.smoothing``)."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels.sph.smoothing import KERNELS, radial

_NAMES = {code: name for name, code in KERNELS.items()}


def weigh(kernel: int, term: str, e: Array) -> Array:
    """One term for each offset e (n, dim) over h: (n,), or for "hessian" f I + g e e^T, (n, dim, dim).

    What a neighbour list holds is within reach; round-off must not take it out.
    """
    dim = e.shape[1]
    q = np.minimum(np.sqrt((e * e).sum(axis=1)), 1.0)
    v = radial(_NAMES[kernel], q)
    if term == "w":
        return v.w
    if term == "f":
        return v.f
    if term == "laplacian":
        return dim * v.f + q * q * v.g
    if term == "laplacian_slope":
        return (dim + 2) * v.g + q * q * v.k
    return v.f[:, None, None] * np.eye(dim) + v.g[:, None, None] * e[:, :, None] * e[:, None, :]
