"""SPH sums over lists of neighbours, and what positions pull from them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.sph.smoothing import weigh
from dc_kernels.sph.quantities import CHUNK, Quantity


def kernels(dtype: str) -> Kernels:
    """``sum_neighbors`` and ``pull_neighbors``; all arithmetic is float64."""
    return {"sum_neighbors": sum_neighbors, "pull_neighbors": pull_neighbors}


def sum_neighbors(
    tid: int, chunk_offset: int, sum: Any, lists: Any, query: Array, point: Array, value: Array, out: Array
) -> None:
    """Add up the neighbours' values times W, grad W, lap W, or . grad W (Wu 2018, equations 3.7 and 3.8)."""
    dim, h, scale, quantity = point.shape[1], sum.h, sum.scale, sum.quantity
    for q in _queries(tid + chunk_offset, query):
        near = lists.index[lists.start[q] : lists.start[q + 1]]
        e = _offsets(query[q], point[near], h)
        a = value[near].astype(np.float64)
        if quantity == Quantity.VALUE:
            out[q] = scale * (weigh(sum.kernel, "w", e) @ a)
        elif quantity == Quantity.LAPLACIAN:
            out[q] = scale * (weigh(sum.kernel, "laplacian", e) @ a)
        else:
            slope = weigh(sum.kernel, "f", e)[:, None] * e
            if quantity == Quantity.GRADIENT:
                out[q] = scale * (a.T @ slope).ravel()
            else:
                out[q] = scale * np.einsum("jck,jk->c", a.reshape(len(a), out.shape[1], dim), slope)


def pull_neighbors(
    tid: int,
    chunk_offset: int,
    sum: Any,
    lists: Any,
    query: Array,
    point: Array,
    query_value: Array,
    value: Array,
    out: Array,
) -> None:
    """Differentiate sum(query_value . sum_neighbors(value)) by the queries' positions.

    Swapped, the queries are the particles of that sum and the neighbours its queries: by the particles' positions.
    """
    dim, h, scale, quantity = point.shape[1], sum.h, sum.scale, sum.quantity
    for q in _queries(tid + chunk_offset, query):
        near = lists.index[lists.start[q] : lists.start[q + 1]]
        e = _offsets(query[q], point[near], h)
        u, a = query_value[q].astype(np.float64), value[near].astype(np.float64)
        if quantity != Quantity.GRADIENT:
            weight = weigh(sum.kernel, "f" if quantity == Quantity.VALUE else "laplacian_slope", e)
            out[q] = scale * ((weight * (a @ u)) @ e)
            continue
        if sum.swapped:
            both = -np.einsum("c,jck->jk", u, a.reshape(len(a), len(u), dim))
        else:
            both = a @ u.reshape(a.shape[1], dim)
        out[q] = scale * np.einsum("jik,jk->i", weigh(sum.kernel, "hessian", e), both)


def _queries(chunk: int, query: Array) -> range:
    return range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(query)))


def _offsets(x: Array, points: Array, h: float) -> Array:
    """(x - x_p) / h, (n, dim)."""
    return (x.astype(np.float64) - points.astype(np.float64)) / h
