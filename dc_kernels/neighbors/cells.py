"""Neighbour search by sorted cells: arrays, growth of capacity and threads around the kernels of ``neighbors``."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from dc_kernels.model.arrays import kernel_arrays
from dc_kernels.neighbors.fields import CELLS
from dc_kernels.runtime.backends import bind, kernel_file, make_kernels
from dc_kernels.runtime.inputs import MAX_INDEX
from dc_kernels.runtime.threads import map_threads

PADDING = 16  # points and entries behind the last that lanes read and write
MAX_FOUND = MAX_INDEX - PADDING  # pairs, or entries of lists, of a call
ROOM = 16  # pairs and entries reserved for a point at first: of memory, only what is written becomes resident
LEAST_ROOM = 1024


def allowed(total: int) -> int:
    """A number of pairs or entries, if arrays can hold it."""
    if total > MAX_FOUND:
        raise ValueError(f"radius finds more than {MAX_FOUND} pairs; it must find fewer")
    return total


def shards_of(counts: np.ndarray, threads: int) -> list[tuple[int, int]]:
    """(first world, worlds) for each thread, with about as many points each; the same results for any division."""
    worlds = len(counts)
    if threads == 1 or worlds < 2:
        return [(0, worlds)] if worlds else []
    done = np.cumsum(counts + 1)
    edges = np.searchsorted(done, done[-1] * np.arange(1, threads) / threads) + 1
    edges = np.unique(np.concatenate([[0], edges, [worlds]]))
    return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]


class SortedCells:
    """Points of all worlds sorted by cell, shard by shard."""

    def __init__(self, radius: float, points: np.ndarray, backend: str) -> None:
        self.backend = backend
        self.reach = float(points.dtype.type(radius))
        self.dtype, self.dim = points.dtype, points.shape[1]
        self.kernels = make_kernels(backend, "neighbors.search", self.dtype.name, self.dim)

    def call(self, name: str, values: dict[str, Any]) -> None:
        """One launch."""
        bind(self.kernels[name], 1, values, "cpu")()

    def boxes(self, worlds: int, *sets: tuple[np.ndarray, np.ndarray]) -> dict[str, Any]:
        """``lower`` and ``upper`` of each world's points of all sets (points, starts)."""
        box = {"lower": np.full((worlds, self.dim), np.inf), "upper": np.full((worlds, self.dim), -np.inf)}
        shared = kernel_arrays(box, self.backend)
        for points, starts in sets:
            arrays = {"start": starts.astype(np.int32), "point": points}
            self.call(
                "bound_points", {"world_offset": 0, "worlds": worlds, **shared, **kernel_arrays(arrays, self.backend)}
            )
        with np.errstate(over="ignore"):
            wide = np.argwhere(box["upper"] - box["lower"] == np.inf)
        if len(wide):
            w, k = wide[0]
            raise ValueError(f"points of world {w} span more than float64 holds on axis {k}; they must span less [m]")
        return shared

    def sorter(self, points: np.ndarray, starts: np.ndarray, box: dict[str, Any]) -> tuple[Any, Any]:
        """The group of the sorted points, and a call that fills it for a shard."""
        n, worlds = len(points), len(starts) - 1
        cells = {
            "start": starts.astype(np.int32),
            "place": np.empty((self.dim, n + PADDING), self.dtype),
            "number": np.empty(n + PADDING, np.int32),
            "column": np.empty(n + PADDING, np.int32),
            "line_key": np.empty(n, np.int64),
            "line_start": np.empty(n + worlds, np.int32),
            "line_count": np.empty(worlds, np.int32),
            "line_stride": np.empty(worlds, np.int64),
        }
        shared = kernel_file(self.backend, "groups").group("cells", self.dtype.name, CELLS, cells)
        point = kernel_arrays({"point": points}, self.backend)

        def sort(first: int, count: int) -> None:
            most = int(np.diff(starts[first : first + count + 1]).max())
            # 8-byte words a point: two keys, two values, a line and four counts of 4 bytes, and a copy of the point
            # with its number and column; a few rows more for worlds of few points
            words = 2 + (2 + 1 + 4) / 2 + math.ceil((self.dtype.itemsize * self.dim + 8) / 8)
            scratch = {"scratch": np.empty((most + 256, math.ceil(words)), np.int64)}
            values = {"world_offset": first, "worlds": count, "reach": self.reach, "cells": shared, **box, **point}
            self.call("sort_points", {**values, **kernel_arrays(scratch, self.backend)})

        return shared, sort

    def fill(self, name: str, output: str, count: int, shape: tuple[int, ...], values: dict[str, Any]) -> Any:
        """What a sweep finds, and how much: the array ``output``, made larger until all and PADDING have room."""
        found = np.zeros(values["worlds"], np.int64)
        room = min(ROOM * count + LEAST_ROOM, MAX_INDEX)
        while True:
            array = np.empty((room, *shape), np.int32)
            self.call(name, {**values, **kernel_arrays({"found": found, output: array}, self.backend)})
            total = allowed(int(found.sum()))
            if total + PADDING <= room:
                return array, total
            room = total + PADDING


def hash_pairs(
    points: np.ndarray, radius: float, limit: Any, starts: np.ndarray, threads: int, backend: str
) -> np.ndarray:
    """The method "hash" of ``neighbor_pairs``; ``limit`` is the largest squared distance."""
    shards = shards_of(np.diff(starts), threads)
    hashed = SortedCells(radius, points, backend)
    cells, sort = hashed.sorter(points, starts, hashed.boxes(len(starts) - 1, (points, starts)))

    def shard(s: int) -> np.ndarray:
        first, count = shards[s]
        sort(first, count)
        values = {"world_offset": first, "worlds": count, "limit": limit, "cells": cells}
        pairs, total = hashed.fill("sweep_pairs", "pair", int(starts[first + count] - starts[first]), (2,), values)
        pairs.resize((total, 2), refcheck=False)  # returns the rest to the system
        return pairs

    found = map_threads(shard, range(len(shards)), threads)
    allowed(sum(map(len, found)))
    return found[0] if len(found) == 1 else np.concatenate([np.empty((0, 2), np.int32), *found])


def hash_lists(
    queries: np.ndarray,
    points: np.ndarray,
    radius: float,
    limit: Any,
    starts: tuple[np.ndarray, np.ndarray],
    threads: int,
    backend: str,
) -> tuple[np.ndarray, np.ndarray]:
    """The method "hash" of ``neighbor_lists``: start and index of the lists; ``starts`` of queries and points."""
    first_query, first_point = starts
    shards = shards_of(np.diff(first_query) + np.diff(first_point), threads)
    hashed = SortedCells(radius, points, backend)
    same = queries is points and np.array_equal(first_query, first_point)
    sets = ((points, first_point),) if same else ((points, first_point), (queries, first_query))
    box = hashed.boxes(len(first_query) - 1, *sets)
    cells, sort_points = hashed.sorter(points, first_point, box)
    query_cells, sort_queries = (cells, None) if same else hashed.sorter(queries, first_query, box)
    span = np.zeros((len(queries), 2), np.int64)
    spans = kernel_arrays({"list_span": span}, backend)
    values = {"limit": limit, "cells": cells, "queries": query_cells, **spans}

    def sweep(s: int) -> np.ndarray:
        first, count = shards[s]
        sort_points(first, count)
        if sort_queries is not None:
            sort_queries(first, count)
        number = int(first_query[first + count] - first_query[first])
        shard = {**values, "world_offset": first, "worlds": count}
        return hashed.fill("sweep_lists", "entry", number, (), shard)[0]  # lanes read the padding too

    entries = map_threads(sweep, range(len(shards)), threads)
    start = np.zeros(len(queries) + 1, np.int64)
    np.cumsum(span[:, 1], out=start[1:])
    index = np.empty(allowed(int(start[-1])), np.int32)
    order = {**spans, **kernel_arrays({"list_start": start, "index": index}, backend)}

    def arrange(s: int) -> None:
        first, count = shards[s]
        begin, end = int(first_query[first]), int(first_query[first + count])
        entry = kernel_arrays({"entry": entries[s]}, backend)
        hashed.call("order_lists", {**order, "query_offset": begin, "queries": end - begin, **entry})

    map_threads(arrange, range(len(shards)), threads)
    return start, index
