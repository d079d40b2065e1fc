"""Neighbour search by sorted cells: the oracle."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels


def kernels(dtype: str, dim: int) -> Kernels:
    """The kernels of the cells; the arrays bring their scalar type and number of dimensions."""
    return {
        "bound_points": bound_points,
        "sort_points": sort_points,
        "sweep_pairs": sweep_pairs,
        "sweep_lists": sweep_lists,
        "order_lists": order_lists,
    }


def bound_points(
    tid: int, world_offset: int, worlds: int, fresh: int, start: Array, point: Array, lower: Array, upper: Array
) -> None:
    """Box of each world's points, and of what it held before unless it is fresh; NaN where one is not finite."""
    for w in range(world_offset, world_offset + worlds):
        if fresh:
            lower[w], upper[w] = np.inf, -np.inf
        points = point[start[w] : start[w + 1]]
        for p in points:
            lower[w], upper[w] = np.minimum(lower[w], p), np.maximum(upper[w], p)
        if not np.isfinite(points).all():
            lower[w] = upper[w] = np.nan


def sort_points(
    tid: int,
    world_offset: int,
    worlds: int,
    reach: float,
    point: Array,
    lower: Array,
    upper: Array,
    scratch: Array,
    cells: Any,
) -> None:
    """Sort points by line, then column, then index; no scratch is used."""
    for w in range(world_offset, world_offset + worlds):
        first, last = cells.start[w : w + 2]
        cells.line_count[w] = cells.line_stride[w] = 0
        if first == last or not np.isfinite(upper[w] - lower[w]).all():
            continue
        extent = upper[w] - lower[w]
        inverse = 1.0 / np.maximum(reach * (1.0 + 2.0**-16), extent / 2.0**30)
        cell = ((point[first:last].astype(np.float64) - lower[w]) * inverse).astype(np.int64)
        keys = cell[:, 1]
        if point.shape[1] == 3:
            cells.line_stride[w] = int(extent[1] * inverse[1]) + 2
            keys = cell[:, 2] * cells.line_stride[w] + cell[:, 1]
        order = np.lexsort((cell[:, 0], keys))
        cells.number[first:last] = first + order
        cells.column[first:last] = cell[order, 0]
        cells.place[:, first:last] = point[first:last][order].T
        used = np.unique(keys)
        starts = np.searchsorted(keys[order], used)
        cells.line_count[w] = len(used)
        cells.line_key[first : first + len(used)] = used
        cells.line_start[first + w : first + w + len(used) + 1] = [*(first + starts), last]


def _lines(w: int, cells: Any) -> dict[int, range]:
    """Places in the order of the cells, by the key of the line."""
    first = cells.start[w]
    keys = cells.line_key[first : first + cells.line_count[w]]
    starts = cells.line_start[first + w : first + w + cells.line_count[w] + 1]
    return {int(k): range(a, b) for k, (a, b) in zip(keys, itertools.pairwise(starts.tolist()), strict=True)}


def _near(a: Array, b: Array, limit: float) -> bool:
    with np.errstate(over="ignore", under="ignore"):
        d = a - b
        square = d[0] * d[0] + d[1] * d[1]
        return bool((square if len(d) == 2 else square + d[2] * d[2]) <= limit)


def sweep_pairs(tid: int, world_offset: int, worlds: int, limit: float, cells: Any, found: Array, pair: Array) -> None:
    """Test each line against itself, then against those ahead of it; count on when there is no room."""
    out, place = 0, cells.place
    for w in range(world_offset, world_offset + worlds):
        before, stride = out, int(cells.line_stride[w])
        lines = _lines(w, cells)
        for k, points in lines.items():
            for away in (0, 1, stride - 1, stride, stride + 1)[: 5 if len(place) == 3 else 2]:
                others = lines.get(k + away, range(0))
                for i in points:
                    for j in others:
                        if (away != 0 or j > i) and _near(place[:, i], place[:, j], limit):
                            if out < len(pair):
                                pair[out] = sorted((cells.number[i], cells.number[j]))
                            out += 1
        found[w - world_offset] = out - before


def sweep_lists(
    tid: int,
    world_offset: int,
    worlds: int,
    limit: float,
    queries: Any,
    cells: Any,
    list_span: Array,
    found: Array,
    entry: Array,
) -> None:
    """Test each query of a line against the lines around it; count on when there is no room."""
    out, place = 0, cells.place
    for w in range(world_offset, world_offset + worlds):
        before, stride = out, int(cells.line_stride[w])
        layers = (-stride, 0, stride) if len(place) == 3 else (0,)
        lines = _lines(w, cells)
        for k, places in _lines(w, queries).items():
            for i in places:
                q = queries.number[i]
                list_span[q, 0] = out
                for layer in layers:
                    for j in itertools.chain(*(lines.get(k + layer + row, range(0)) for row in (-1, 0, 1))):
                        if _near(queries.place[:, i], place[:, j], limit):
                            if out < len(entry):
                                entry[out] = cells.number[j]
                            out += 1
                list_span[q, 1] = out - list_span[q, 0]
        found[w - world_offset] = out - before


def order_lists(
    tid: int, query_offset: int, queries: int, list_span: Array, list_start: Array, entry: Array, index: Array
) -> None:
    """Lists in the order of the queries, each ascending."""
    for q in range(query_offset, query_offset + queries):
        count = list_start[q + 1] - list_start[q]
        index[list_start[q] : list_start[q + 1]] = np.sort(entry[list_span[q, 0] : list_span[q, 0] + count])
