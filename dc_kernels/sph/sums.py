"""SPH sums at any points: a field carried by particles, its gradient and its Laplacian (Wu 2018, equations 3.6-3.8).

    A(x)      = sum_p  m_p / rho_p  A_p  W(|x - x_p|, h)
    grad A(x) = sum_p  m_p / rho_p  A_p  grad W
    lap A(x)  = sum_p  m_p / rho_p  A_p  lap W

These are the plain sums: a constant field is reproduced only as well as sum_p m_p / rho_p W approximates 1, which
fails at the border of the particles. ``torch_ops.sph`` holds differentiable torch operators on these kernels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import kernel_arrays
from dc_kernels.model.settings import check_choice
from dc_kernels.neighbors.search import Neighbors, neighbor_lists
from dc_kernels.runtime.backends import bind, check_backend, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_array, check_count, check_points, check_start
from dc_kernels.runtime.threads import run_shards, shard_worlds, slices_of
from dc_kernels.sph.fields import LISTS, SUM
from dc_kernels.sph.quantities import CHUNK, PUBLIC, Quantity
from dc_kernels.sph.smoothing import KERNELS, scale


def sph_sum(
    queries: np.ndarray,
    points: np.ndarray,
    values: np.ndarray,
    mass: np.ndarray,
    density: np.ndarray,
    h: float,
    *,
    kernel: str = "poly6",
    query_start: Any = None,
    point_start: Any = None,
    quantity: str = "value",
    method: str = "hash",
    threads: int = 1,
    backend: str = "warp",
) -> np.ndarray:
    """Return a field of particles, its gradient or its Laplacian, at query points.

    All arrays are C-contiguous and of one dtype, float32 or float64. Each sum runs over the neighbours in a fixed
    order, so its bits do not depend on ``threads`` nor on the other queries.

    Args:
        queries: query points, (nq, 2) or (nq, 3) [m].
        points: positions of the particles, (n, 2) or (n, 3) [m].
        values: values of the particles, (n, C), in any unit [u].
        mass: (n,), > 0 or 0 [kg].
        density: (n,), > 0 [kg/m^2 in 2D, kg/m^3 in 3D].
        h: support radius, > 0 [m].
        kernel: a key of ``smoothing.KERNELS``.
        query_start: first query of each world and the number of queries, (W + 1,); None for one world.
        point_start: first particle of each world and the number of particles.
        quantity: "value", "gradient" or "laplacian".
        method: method of the neighbour search (``neighbors.METHODS``).
        threads: number of Python threads that share the queries.
        backend: "warp", "taichi", or "numpy" for the oracle.

    Returns:
        (nq, C) [u] for "value", (nq, C, dim) [u/m] for "gradient", (nq, C) [u/m^2] for "laplacian".

    Raises:
        ValueError: an argument is invalid; the error names argument, index and limit.
    """
    queries, points, values, mass, density = check_particles(queries, points, values, mass, density)
    code, threads = check_options(quantity, threads, backend)
    factor = scale(kernel, h, points.shape[1], code.order, points.dtype)
    weighted = values * volume(mass, density)[:, None]
    lists = neighbor_lists(
        queries, points, h, method=method, query_start=query_start, point_start=point_start, threads=threads
    )
    out = sum_lists(lists, queries, points, weighted, h, factor, kernel, code, threads, backend)
    return out.reshape(out_shape(code, len(queries), values.shape[1], points.shape[1]))


def sph_density(
    points: np.ndarray,
    mass: np.ndarray,
    h: float,
    *,
    kernel: str = "poly6",
    start: Any = None,
    method: str = "hash",
    threads: int = 1,
    backend: str = "warp",
) -> np.ndarray:
    """Return the density of each particle, sum_p m_p W(|x - x_p|, h), itself included: (n,) [kg/m^dim].

    Args:
        points: the particles, (n, 2) or (n, 3), float32 or float64, C-contiguous [m].
        mass: (n,), >= 0, of the same dtype [kg].
        h: support radius, > 0 [m].
        kernel: as for ``sph_sum``.
        start: first particle of each world and the number of particles, (W + 1,); None for one world.
        method: as for ``sph_sum``.
        threads: as for ``sph_sum``.
        backend: as for ``sph_sum``.

    Raises:
        ValueError: an argument is invalid; the error names argument, index and limit.
    """
    points = check_points("points", points, (2, 3))
    mass = check_array("mass", mass, (len(points),), points.dtype, low=0.0)
    check_start("start", start, len(points))
    _, threads = check_options("value", threads, backend)
    factor = scale(kernel, h, points.shape[1], 0, points.dtype)
    lists = neighbor_lists(points, points, h, method=method, query_start=start, point_start=start, threads=threads)
    return sum_lists(lists, points, points, mass[:, None], h, factor, kernel, Quantity.VALUE, threads, backend)[:, 0]


# ------------------------------------------------------------------ sums over lists of neighbours


def sum_lists(
    lists: Neighbors,
    queries: np.ndarray,
    points: np.ndarray,
    value: np.ndarray,
    h: float,
    factor: float,
    kernel: str,
    quantity: Quantity,
    threads: int,
    backend: str,
) -> np.ndarray:
    """The kernel ``sum_neighbors``: columns of (n, C) become C (value, laplacian), C dim (gradient) or C / dim."""
    width, dim = value.shape[1], points.shape[1]
    factors = {Quantity.GRADIENT: dim, Quantity.DIVERGENCE: 1 / dim}
    columns = round(width * factors.get(quantity, 1))
    out = np.empty((len(queries), columns), points.dtype)
    arrays = {"query": queries, "point": points, "value": value, "out": out}
    scalars = {"kernel": KERNELS[kernel], "quantity": int(quantity), "swapped": 0, "h": h, "scale": factor}
    _run("sum_neighbors", lists, arrays, scalars, threads, backend)
    return out


def pull_lists(
    lists: Neighbors,
    queries: np.ndarray,
    points: np.ndarray,
    query_value: np.ndarray,
    value: np.ndarray,
    h: float,
    kernel: str,
    quantity: Quantity,
    *,
    swapped: bool,
    threads: int,
    backend: str,
) -> np.ndarray:
    """The kernel ``pull_neighbors``: gradient by the queries' positions, (nq, dim)."""
    factor = scale(kernel, h, points.shape[1], quantity.order + 1, points.dtype)
    out = np.empty_like(queries)
    arrays = {"query": queries, "point": points, "query_value": query_value, "value": value, "out": out}
    scalars = {
        "kernel": KERNELS[kernel],
        "quantity": int(quantity),
        "swapped": int(swapped),
        "h": h,
        "scale": factor,
    }
    _run("pull_neighbors", lists, arrays, scalars, threads, backend)
    return out


def volume(mass: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Volume m / rho of each particle, (n,) [m^dim].

    Raises:
        ValueError: naming the first that overflows.
    """
    with np.errstate(over="ignore"):
        result = mass / density
    bad = np.flatnonzero(~np.isfinite(result))
    if len(bad):
        i = bad[0]
        raise ValueError(f"mass[{i}] / density[{i}] is {mass[i]} / {density[i]}; it must be finite in {mass.dtype}")
    return result


def out_shape(quantity: Quantity, count: Any, channels: Any, dim: int) -> tuple[Any, ...]:
    """Shape of a sum's result."""
    return (count, channels, dim) if quantity == Quantity.GRADIENT else (count, channels)


def _run(
    name: str,
    lists: Neighbors,
    arrays: Mapping[str, np.ndarray],
    scalars: Mapping[str, Any],
    threads: int,
    backend: str,
) -> None:
    """Launch a kernel over all queries, in one part for each thread."""
    refuse_recording("a sum over neighbours", "the host prepares what it reads")
    queries = arrays["query"]
    if not len(queries):
        return
    table = make_kernels(backend, "sph.sums", queries.dtype.name)
    group, dtype = kernel_file(backend, "groups").group, queries.dtype.name
    named = {
        **kernel_arrays(arrays, backend),
        "sum": group("sum", dtype, SUM, scalars),
        "lists": group("lists", dtype, LISTS, {"start": lists.start, "index": lists.index}),
    }
    chunks = -(-len(queries) // CHUNK)
    named["threads"] = threads
    launches = [
        bind(table[name], count, {**named, "chunk_offset": first}, "cpu")
        for first, count in shard_worlds(chunks, max(host_threads(backend, threads), slices_of(len(lists.index))))
    ]
    run_shards(launches, threads)


# ------------------------------------------------------------------ checks


def check_particles(queries: Any, points: Any, values: Any, mass: Any, density: Any) -> tuple[np.ndarray, ...]:
    """The arrays as numpy; ValueError, naming argument, index and limit, for what cannot be summed."""
    queries, points = (check_points(n, a, (2, 3)) for n, a in (("queries", queries), ("points", points)))
    if queries.dtype != points.dtype or queries.shape[1] != points.shape[1]:
        raise ValueError(
            f"queries are {queries.dtype} {queries.shape}, points are {points.dtype} {points.shape}; dtype and "
            "dimension must agree"
        )
    values = check_array("values", values, (len(points), None), points.dtype)
    mass = check_array("mass", mass, (len(points),), points.dtype, low=0.0)
    density = check_array("density", density, (len(points),), points.dtype, low=0.0, closed=False)
    return queries, points, values, mass, density


def check_options(quantity: str, threads: int, backend: str) -> tuple[Quantity, int]:
    """The code of a quantity, and the threads.

    Raises:
        ValueError: for an unknown quantity or backend, or a number of threads below 1.
    """
    check_choice("quantity", quantity, PUBLIC)
    threads = check_count("threads", threads)
    check_backend(backend)
    return PUBLIC[quantity], threads
