"""Search for the points within a radius of each other, by four methods that find equal pairs.

A pair is found when dx dx + dy dy (+ dz dz) <= r r in the arithmetic of the points' dtype. Every method searches a
little farther if needed and then tests this expression, so all return equal sets, also for points whose
distance is the radius.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np

from dc_kernels.model.arrays import kernel_arrays
from dc_kernels.model.settings import Limits, check_choice, checker
from dc_kernels.neighbors.cells import KEPT, Workspace, allowed, hash_lists, hash_pairs
from dc_kernels.runtime.backends import bind, check_backend, make_kernels
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_count, check_points, check_start
from dc_kernels.runtime.threads import in_main_thread, map_threads, run_apart

_number = checker(Annotated[float, Limits(above=0.0, size=math.sqrt(np.finfo(np.float64).max))])  # its square decides
METHODS = ("hash", "kdtree", "tree", "all")
WAITING = 8  # workspaces that are kept for the next calls
LONG = 30_000  # points from which a search may take more than half a second, if all are neighbours
BLOCK = 1 << 20  # distances at a time in the method "all"
Found = tuple[np.ndarray, np.ndarray]  # one world's (queries, points), indices in the world
Result = TypeVar("Result")
Search = Callable[["np.ndarray | None", np.ndarray, Any], Found]


@dataclass(frozen=True)
class Neighbors:
    """Lists of neighbours in CSR form: query q has ``index[start[q]:start[q + 1]]``, ascending."""

    start: np.ndarray
    """First entry of each query's list and the end of the last, (nq + 1,) int64."""
    index: np.ndarray
    """Points within the radius, numbered over all worlds, (m,) int32."""


def neighbor_pairs(
    points: np.ndarray,
    radius: float,
    *,
    method: str = "hash",
    start: Any = None,
    threads: int = 1,
    backend: str = "warp",
) -> np.ndarray:
    """Return every pair of points of the same world that are at most a radius apart, once.

    Args:
        points: (n, 2) or (n, 3), float32 or float64, C-contiguous [m].
        radius: largest distance, > 0 [m].
        method: "hash" (cells sorted by position), "kdtree" (SciPy's), "tree" (bounding volume hierarchy) or "all"
            (every pair is tested).
        start: first point of each world and the number of points, (W + 1,); None for one world.
        threads: number of Python threads that share the worlds; the result does not depend on it.
        backend: "warp", or for the method "hash" also "taichi" (on one thread) and "numpy", the oracle.

    Returns:
        (m, 2) int32, i < j in each row. The order of the rows differs between methods, but is reproducible for each.

    Raises:
        ValueError: an argument is invalid; the error names argument, index and limit.
        ImportError: "kdtree" is used without SciPy.
    """
    radius, search, threads = _number("radius", radius), _search(method, backend), check_count("threads", threads)
    refuse_recording("neighbor_pairs", "the host sizes what it finds")
    points = check_points("points", points, (2, 3))
    starts = check_start("start", start, len(points))
    limit = square("radius", radius, points.dtype)
    if search is None:

        def by_cells(points: np.ndarray) -> np.ndarray:
            with _workspace(backend) as workspace:
                return hash_pairs(points, radius, limit, starts, threads, workspace)

        return _leaving(by_cells, points)

    def world(w: int) -> np.ndarray:
        first, last = starts[w : w + 2]
        a, b = search(None, points[first:last], limit)
        pairs = np.empty((len(a), 2), np.int32)
        pairs[:, 0], pairs[:, 1] = np.minimum(a, b), np.maximum(a, b)
        pairs += np.int32(first)
        return pairs

    found = map_threads(world, range(len(starts) - 1), threads)
    return np.concatenate(found) if found else np.empty((0, 2), np.int32)


def neighbor_lists(
    queries: np.ndarray,
    points: np.ndarray,
    radius: float,
    *,
    method: str = "hash",
    query_start: Any = None,
    point_start: Any = None,
    threads: int = 1,
    backend: str = "warp",
) -> Neighbors:
    """Return the points within a radius of each query, world by world; a query that is a point too finds itself.

    Args:
        queries: (nq, 2) or (nq, 3), float32 or float64, C-contiguous [m].
        points: (n, 2) or (n, 3) as the queries, of the same dtype [m].
        radius: largest distance, > 0 [m].
        method: as for ``neighbor_pairs``.
        query_start: first query of each world and the number of queries, (W + 1,); None for one world.
        point_start: first point of each world and the number of points.
        threads: as for ``neighbor_pairs``.
        backend: as for ``neighbor_pairs``.

    Raises:
        ValueError: an argument is invalid; the error names argument, index and limit.
        ImportError: "kdtree" is used without SciPy.
    """
    radius, search, threads = _number("radius", radius), _search(method, backend), check_count("threads", threads)
    refuse_recording("neighbor_lists", "the host sizes what it finds")
    queries = check_points("queries", queries, (2, 3))
    points = check_points("points", points, (2, 3))
    for what in ("dtype", "shape"):
        a, b = (getattr(array, what) for array in (queries, points))
        if (a[1:], b[1:]) != (b[1:], a[1:]) if what == "shape" else a != b:
            raise ValueError(f"queries has {what} {a}, points has {what} {b}; they must agree")
    first_query = check_start("query_start", query_start, len(queries), "queries")
    first_point = check_start("point_start", point_start, len(points))
    worlds = len(first_query) - 1
    if len(first_point) != worlds + 1:
        raise ValueError(f"query_start has {worlds} worlds, point_start has {len(first_point) - 1}; they must agree")
    limit = square("radius", radius, points.dtype)
    if search is None:

        def by_cells(queries: np.ndarray, points: np.ndarray) -> Neighbors:
            with _workspace(backend) as workspace:
                found = hash_lists(queries, points, radius, limit, (first_query, first_point), threads, workspace)
            return Neighbors(*found)

        return _leaving(by_cells, queries, points)

    def world(w: int) -> tuple[np.ndarray, np.ndarray]:
        q0, q1 = first_query[w : w + 2]
        p0, p1 = first_point[w : w + 2]
        a, b = search(queries[q0:q1], points[p0:p1], limit)
        order = np.argsort(a.astype(np.int64) * (p1 - p0) + b)
        return np.bincount(a, minlength=q1 - q0), (b[order] + p0).astype(np.int32)

    parts = map_threads(world, range(worlds), threads)
    lists = np.zeros(len(queries) + 1, np.int64)
    np.cumsum(np.concatenate([count for count, _ in parts]) if parts else [], out=lists[1:])
    return Neighbors(lists, np.concatenate([index for _, index in parts]) if parts else np.empty(0, np.int32))


def _leaving(search: Callable[..., Result], *points: np.ndarray) -> Result:
    """What a search of points finds; one that may take seconds is left to end by itself when it is interrupted.

    So an interrupt is not kept waiting. The search goes on with copies, which nobody changes.
    """
    if sum(map(len, points)) < LONG or not in_main_thread():
        return search(*points)
    copies, found = {id(array): array.copy() for array in points}, []
    run_apart(lambda: found.append(search(*(copies[id(array)] for array in points))), lambda ended: None)
    return found[0]


_idle: dict[str, list[Workspace]] = {}  # of each backend: those that wait for a call


@contextlib.contextmanager
def _workspace(backend: str) -> Iterator[Workspace]:
    """Lend a workspace that no other call uses; it waits for the next one unless it is large."""
    idle = _idle.setdefault(backend, [])
    try:
        workspace = idle.pop()
    except IndexError:
        workspace = Workspace(backend)
    yield workspace
    if workspace.nbytes <= KEPT and len(idle) < WAITING:
        idle.append(workspace)


# ---------------------------------------------------------------------- checks


def square(name: str, radius: Any, dtype: np.dtype) -> Any:
    """The largest squared distance, r r in the dtype of the points.

    Raises:
        TypeError, ValueError: naming it, for what is no number > 0, or whose square the dtype does not hold.
    """
    radius = _number(name, radius)
    with np.errstate(over="ignore", under="ignore"):
        square = dtype.type(radius) * dtype.type(radius)
    if not np.finfo(dtype).tiny <= square <= np.finfo(dtype).max:
        raise ValueError(f"{name} is {radius!r}; it must be > 0, and its square a finite, normal {dtype} [m]")
    return square


def _search(method: str, backend: str) -> Search | None:
    """How a method searches one world; None for "hash", which takes all of them."""
    check_choice("method", method, METHODS)
    if check_backend(backend) != "warp" and method != "hash":
        raise ValueError(
            f"backend is {backend!r} and method is {method!r}; only 'hash' has an oracle, and other kernels"
        )
    return {"hash": None, "kdtree": _kdtree, "tree": _tree, "all": _all}[method]


# ---------------------------------------------------------------------- methods for one world


def _within(a: np.ndarray, b: np.ndarray, limit: Any) -> np.ndarray:
    """The test that decides, for points along the last axis."""
    with np.errstate(over="ignore", under="ignore"):
        d = a - b
        square = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]
        if d.shape[-1] == 3:
            square = square + d[..., 2] * d[..., 2]
    return square <= limit


def _all(queries: np.ndarray | None, points: np.ndarray, limit: Any) -> Found:
    """Every pair is tested, in blocks of queries."""
    pairs = queries is None
    rows = points if queries is None else queries
    step = max(1, BLOCK // max(len(points), 1))
    found = []
    for first in range(0, len(rows), step):
        low = first if pairs else 0
        a, b = np.nonzero(_within(rows[first : first + step, None], points[None, low:], limit))
        found.append((a + first, b + low))
    a, b = (np.concatenate([np.empty(0, int), *parts]) for parts in zip(*found)) if found else np.empty((2, 0), int)
    return (a[a < b], b[a < b]) if pairs else (a, b)


def _kdtree(queries: np.ndarray | None, points: np.ndarray, limit: Any) -> Found:
    """A k-d tree (SciPy); it decides in float64 with its own expression, so it is asked for a few ulp more."""
    if not len(points) or (queries is not None and not len(queries)):
        return np.empty(0, int), np.empty(0, int)
    make = require("scipy.spatial", "pipeline").cKDTree
    reach = np.sqrt(float(limit)) * (1.0 + 8.0 * float(np.finfo(limit).eps))
    if queries is None:
        a, b = make(points).query_pairs(reach, output_type="ndarray").T
        keep = _within(points[a], points[b], limit)
    else:
        near = make(queries).sparse_distance_matrix(make(points), reach, output_type="ndarray")
        a, b = near["i"], near["j"]
        keep = _within(queries[a], points[b], limit)
    return a[keep], b[keep]


def _tree(queries: np.ndarray | None, points: np.ndarray, limit: Any) -> Found:
    """A hierarchy of boxes (Warp's); boxes are float32 and in 3D, rounded outwards."""
    import warp as wp

    rows = points if queries is None else queries
    if not len(points) or not len(rows):
        return np.empty(0, int), np.empty(0, int)
    reach = np.sqrt(float(limit)) * (1.0 + 8.0 * float(np.finfo(limit).eps))
    boxes = [
        wp.array(box, dtype=wp.vec3, device="cpu", copy=False) for box in (*_boxes(points, 0.0), *_boxes(rows, reach))
    ]
    tree = wp.Bvh(boxes[0], boxes[1], constructor="median")
    count, first = np.empty(len(rows), np.int64), np.zeros(len(rows) + 1, np.int64)
    index = np.empty(0, np.int32)
    kernel = make_kernels("warp", "neighbors.search", points.dtype.name, factory="tree_kernels")["query_tree"]
    for fill in (0, 1):
        if fill:
            np.cumsum(count, out=first[1:])
            index = np.empty(allowed(int(first[-1])), np.int32)
        arrays = {"query": rows, "point": points, "list_start": first, "list_count": count, "index": index}
        values = {
            "fill": fill,
            "ahead": int(queries is None),
            "tree": tree.id,
            "limit": limit,
            "lower": boxes[2],
            "upper": boxes[3],
            **kernel_arrays(arrays, "warp"),
        }
        bind(kernel, len(rows), values, "cpu")()
    return np.repeat(np.arange(len(rows)), count), index


def _boxes(points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of (n, 3) float32 that hold the points and what is within reach of them."""
    lower, upper = np.zeros((len(points), 3), np.float32), np.zeros((len(points), 3), np.float32)
    if len(points) and np.abs(points).max() + reach > 0.5 * np.finfo(np.float32).max:
        raise ValueError("method is 'tree', whose boxes are float32: a coordinate plus the radius exceeds 1.7e38 [m]")
    for box, shift, end in ((lower, -reach, -np.inf), (upper, reach, np.inf)):
        box[:, : points.shape[1]] = np.nextafter((points + np.float64(shift)).astype(np.float32), np.float32(end))
    return lower, upper
