"""Neighbour search by sorted cells: arrays, growth of capacity and threads around the kernels of ``neighbors``."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import kernel_arrays
from dc_kernels.neighbors.fields import CELLS
from dc_kernels.runtime.backends import BACKENDS, bind, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.inputs import MAX_INDEX
from dc_kernels.runtime.threads import map_threads

PADDING = 16  # points and entries behind the last that lanes read and write
MAX_FOUND = MAX_INDEX - PADDING  # pairs, or entries of lists, of a call
ROOM = 16  # pairs and entries reserved for a point at first: of memory, only what is written becomes resident
LEAST_ROOM = 1024
KEPT = 2**24  # bytes of a workspace that may wait for the next call: the searches of some 100 000 points
Shapes = dict[str, tuple[tuple[int, ...], Any]]  # shape and dtype by name
Arrays = dict[str, Any]


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


class Workspace:
    """Arrays and launches of a search that are kept from call to call; one call uses them at a time.

    Arrays are bound anew where shapes change, and their memory grows where it must.
    """

    def __init__(self, backend: str) -> None:
        """Begin without memory."""
        self.backend = backend
        self.room: dict[str, int] = {}  # what searches needed where it was more than they began with
        self._memory: dict[str, np.ndarray] = {}
        self._bound: dict[str, tuple[Shapes, Arrays]] = {}
        self._cells: dict[str, tuple[Any, Any]] = {}
        self._launches: dict[tuple[Any, str], tuple[Any, dict[str, Any]]] = {}

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(map(len, self._memory.values()))

    def launch(self, kernel: Any, place: str, values: Mapping[str, Any]) -> None:
        """Launch a kernel with one thread.

        Args:
            kernel: of the backend.
            place: tells apart the launches of a kernel that threads make at once.
            values: arguments by name: numbers, contiguous numpy arrays and groups; others are passed over.
        """
        if not BACKENDS[self.backend].compiled:
            bind(kernel, 1, values, "cpu")()
            return
        launch: Any
        kept = self._launches.get((kernel, place))
        # a launch is taken again with other numbers and arrays: to make one takes longer than to search 100 points
        if kept is not None and all(values[name] is group for name, group in kept[1].items()):
            launch, groups = kept
            for name in launch.elements:
                if name not in groups:
                    launch.give(name, values[name])
            launch()
            return
        arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        launch = bind(kernel, 1, {**values, **kernel_arrays(arrays, self.backend)}, "cpu")
        given = {name: values[name] for name in launch.elements}
        groups = {name: v for name, v in given.items() if not isinstance(v, np.ndarray | np.generic | int | float)}
        self._launches[kernel, place] = launch, groups
        launch()

    def arrays(self, name: str, shapes: Shapes) -> Arrays:
        """Arrays by name, whose elements are not set; those before of that name are given up.

        Args:
            name: of their memory.
            shapes: shape and dtype of each.
        """
        bound = self._bound.get(name)
        if bound is None or bound[0] != shapes:
            arrays = {key: self._empty(f"{name}.{key}", *shape) for key, shape in shapes.items()}
            bound = self._bound[name] = shapes, arrays
        return bound[1]

    def cells(self, name: str, dtype: np.dtype, shapes: Shapes) -> tuple[Arrays, Any]:
        """Arrays of the group of sorted cells by name, and the group as kernels take it (see ``arrays``)."""
        arrays = self.arrays(name, shapes)
        kept = self._cells.get(name)
        if kept is None or kept[0] is not arrays:
            group = kernel_file(self.backend, "groups").group("cells", dtype.name, CELLS, arrays)
            kept = self._cells[name] = arrays, group
        return arrays, kept[1]

    def _empty(self, name: str, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        size = math.prod(shape) * np.dtype(dtype).itemsize
        memory = self._memory.get(name)
        if memory is None or len(memory) < size:
            memory = self._memory[name] = np.empty(size if memory is None else size + size // 4, np.uint8)
        return memory[:size].view(dtype).reshape(shape)


class SortedCells:
    """Points of all worlds sorted by cell, shard by shard."""

    def __init__(self, radius: float, points: np.ndarray, workspace: Workspace) -> None:
        """Find the kernels.

        Args:
            radius: largest distance [m].
            points: (n, dim), whose dtype and dimension the search has.
            workspace: where its arrays lie, of the backend of the kernels.
        """
        self.backend, self.workspace = workspace.backend, workspace
        self.reach = float(points.dtype.type(radius))
        self.dtype, self.dim = points.dtype, points.shape[1]
        self.kernels = make_kernels(self.backend, "neighbors.search", self.dtype.name, self.dim)

    def call(self, name: str, values: dict[str, Any], place: str = "") -> None:
        """One launch (see ``Workspace.launch``)."""
        self.workspace.launch(self.kernels[name], place, values)

    def boxes(self, worlds: int, *sets: tuple[np.ndarray, np.ndarray]) -> dict[str, Any]:
        """``lower`` and ``upper`` of each world's points of all sets (points, starts)."""
        shape = (worlds, self.dim), np.float64
        box = self.workspace.arrays("box", {"lower": shape, "upper": shape})
        for k, (points, starts) in enumerate(sets):
            arrays = {"start": starts.astype(np.int32), "point": points}
            self.call("bound_points", {"world_offset": 0, "worlds": worlds, "fresh": int(k == 0), **box, **arrays})
        with np.errstate(over="ignore"):
            wide = np.argwhere(box["upper"] - box["lower"] == np.inf)
        if len(wide):
            w, k = wide[0]
            raise ValueError(f"points of world {w} span more than float64 holds on axis {k}; they must span less [m]")
        return box

    def sorted_points(self, starts: np.ndarray, name: str = "points") -> Any:
        """The group of the sorted points of worlds that begin at ``starts``, (W + 1,); its memory goes by the name."""
        n, worlds = int(starts[-1]), len(starts) - 1
        shapes: Shapes = {
            "start": ((worlds + 1,), np.int32),
            "place": ((self.dim, n + PADDING), self.dtype),
            "number": ((n + PADDING,), np.int32),
            "column": ((n + PADDING,), np.int32),
            "line_key": ((n,), np.int64),
            "line_start": ((n + worlds,), np.int32),
            "line_count": ((worlds,), np.int32),
            "line_stride": ((worlds,), np.int64),
        }
        arrays, cells = self.workspace.cells(name, self.dtype, shapes)
        arrays["start"][:] = starts
        return cells

    def sort_values(self, starts: np.ndarray, first: int, count: int, name: str = "points") -> dict[str, Any]:
        """What ``sort_points`` takes for the worlds first .. first + count, but for the points, their box and cells."""
        most = int(np.diff(starts[first : first + count + 1]).max())
        # 8-byte words a point: two keys, two values, a line and four counts of 4 bytes, and a copy of the point
        # with its number and column; a few rows more for worlds of few points
        words = 2 + (2 + 1 + 4) / 2 + math.ceil((self.dtype.itemsize * self.dim + 8) / 8)
        scratch = self.workspace.arrays(f"sort {name} {first}", {"scratch": ((most + 256, math.ceil(words)), np.int64)})
        return {"world_offset": first, "worlds": count, "reach": self.reach, **scratch}

    def sorter(
        self, points: np.ndarray, starts: np.ndarray, box: dict[str, Any], *, name: str = "points"
    ) -> tuple[Any, Any]:
        """The group of the sorted points, and a call that fills it for a shard; its memory goes by the name."""
        cells = self.sorted_points(starts, name)

        def sort(first: int, count: int) -> None:
            values = self.sort_values(starts, first, count, name)
            self.call("sort_points", {**values, **box, "cells": cells, "point": points}, f"{name} {first}")

        return cells, sort

    def fill(
        self, name: str, output: str, count: int, shape: tuple[int, ...], values: dict[str, Any], *, keep: bool
    ) -> tuple[np.ndarray, int]:
        """What a sweep finds, and how much: the array ``output``, made larger until all and PADDING have room.

        It is the caller's own if he keeps it, else it lies in the workspace.
        """
        place = f"{output} {values['world_offset']}"
        found = self.workspace.arrays(f"found {place}", {"found": ((values["worlds"],), np.int64)})
        room = max(min(ROOM * count + LEAST_ROOM, MAX_INDEX), self.workspace.room.get(place, 0))
        while True:
            whole = (room, *shape)
            if keep:
                array = np.empty(whole, np.int32)
            else:
                array = self.workspace.arrays(place, {output: (whole, np.int32)})[output]
            found["found"][:] = 0
            self.call(name, {**values, **found, output: array}, place)
            total = allowed(int(found["found"].sum()))
            if total + PADDING <= room:
                return array, total
            room = self.workspace.room[place] = min(total + total // 8, MAX_FOUND) + PADDING


def shortened(array: np.ndarray, rows: int) -> np.ndarray:
    """The first rows of an array that nobody else has; the memory of the others returns to the system."""
    try:
        array.resize((rows, *array.shape[1:]), refcheck=False)
    except ValueError:  # something keeps a weak reference to it, as a launch of Quadrants does
        return array[:rows].copy()
    return array


def hash_pairs(
    points: np.ndarray,
    radius: float,
    limit: Any,
    starts: np.ndarray,
    threads: int,
    workspace: Workspace,
) -> np.ndarray:
    """The method "hash" of ``neighbor_pairs``; ``limit`` is the largest squared distance."""
    threads = host_threads(workspace.backend, threads)
    shards = shards_of(np.diff(starts), threads)
    hashed = SortedCells(radius, points, workspace)
    cells, sort = hashed.sorter(points, starts, hashed.boxes(len(starts) - 1, (points, starts)))

    def shard(s: int) -> np.ndarray:
        first, count = shards[s]
        sort(first, count)
        values = {"world_offset": first, "worlds": count, "limit": limit, "cells": cells}
        number = int(starts[first + count] - starts[first])
        pairs, total = hashed.fill("sweep_pairs", "pair", number, (2,), values, keep=True)
        return shortened(pairs, total)

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
    workspace: Workspace,
) -> tuple[np.ndarray, np.ndarray]:
    """The method "hash" of ``neighbor_lists``: start and index of the lists; ``starts`` of queries and points."""
    first_query, first_point = starts
    threads = host_threads(workspace.backend, threads)
    shards = shards_of(np.diff(first_query) + np.diff(first_point), threads)
    hashed = SortedCells(radius, points, workspace)
    same = queries is points and np.array_equal(first_query, first_point)
    sets = ((points, first_point),) if same else ((points, first_point), (queries, first_query))
    box = hashed.boxes(len(first_query) - 1, *sets)
    cells, sort_points = hashed.sorter(points, first_point, box)
    query_cells, sort_queries = (cells, None) if same else hashed.sorter(queries, first_query, box, name="queries")
    span = workspace.arrays("spans", {"list_span": ((len(queries), 2), np.int64)})["list_span"]
    span[:] = 0
    values = {"limit": limit, "cells": cells, "queries": query_cells, "list_span": span}

    def sweep(s: int) -> np.ndarray:
        first, count = shards[s]
        sort_points(first, count)
        if sort_queries is not None:
            sort_queries(first, count)
        number = int(first_query[first + count] - first_query[first])
        shard = {**values, "world_offset": first, "worlds": count}
        return hashed.fill("sweep_lists", "entry", number, (), shard, keep=False)[0]  # lanes read the padding too

    entries = map_threads(sweep, range(len(shards)), threads)
    start = np.zeros(len(queries) + 1, np.int64)
    np.cumsum(span[:, 1], out=start[1:])
    index = np.empty(allowed(int(start[-1])), np.int32)
    order = {"list_span": span, "list_start": start, "index": index}

    def arrange(s: int) -> None:
        first, count = shards[s]
        begin, end = int(first_query[first]), int(first_query[first + count])
        values = {**order, "query_offset": begin, "queries": end - begin, "entry": entries[s]}
        hashed.call("order_lists", values, f"{first}")

    map_threads(arrange, range(len(shards)), threads)
    return start, index
