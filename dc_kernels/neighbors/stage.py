"""Neighbour search as a stage: bound once to an array of points, then called when they have moved."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import kernel_array, kernel_arrays
from dc_kernels.neighbors.cells import PADDING, ROOM, SortedCells, Workspace, allowed, shards_of
from dc_kernels.neighbors.search import square
from dc_kernels.runtime.backends import Launch, bind, check_backend, host_threads
from dc_kernels.runtime.capture import STALE, Recordings, recording
from dc_kernels.runtime.inputs import check_count, check_points, check_slots, check_start
from dc_kernels.runtime.interop import InPlace
from dc_kernels.runtime.sequences import as_one
from dc_kernels.runtime.threads import run_shards


class NeighborSearch(InPlace):
    """Finds pairs of points within a radius at each call, in memory that is allocated once.

        search = dc.NeighborSearch(points, radius=0.1)   # numpy, torch or wp.array, read in place
        search()                                         # call it again when the points have moved
        first, second = search.numpy().T                 # or search.pairs, search.count for kernels

    The pairs of world w are ``pairs[pair_start[w] : pair_start[w] + count[w]]``, in an order that
    depends only on the points. A call within ``wp.ScopedCapture`` becomes part of the graph. Arrays cannot grow in a
    replay: ``check`` afterwards raises if some pairs did not fit. Several Python threads may call one search; the
    calls run one after the other.

    Attributes:
        pairs: (capacity, 2) int32, the lower index first; numbered over all worlds.
        count: number of pairs of each world, (W,) int64; it exceeds the world's capacity if that was too small.
        pair_start: first element of each world's range, (W + 1,) int64.
        layout_version: number that changes whenever ``pairs`` and ``pair_start`` are reallocated.
    """

    def __init__(
        self,
        points: Any,
        radius: float,
        *,
        start: Any = None,
        max_pairs: Any = None,
        threads: int = 1,
        backend: str = "warp",
    ) -> None:
        """Check the arguments and allocate all memory.

        Args:
            points: (n, 2) or (n, 3), float32 or float64, contiguous on the CPU; kept, and read at each call [m].
            radius: largest distance, > 0 [m].
            start: first point of each world and the number of points, (W + 1,); None for one world.
            max_pairs: capacity for pairs of each world, a number or (W,), beyond which an error is raised; None: the
                capacity grows.
            threads: number of Python threads that share the worlds; the result does not depend on it.
            backend: "warp", "taichi" (on one thread), or "numpy" for the oracle.

        Raises:
            ValueError: an argument is invalid; the error names argument, index and limit.
        """
        self.backend = check_backend(backend)
        self.points = check_points("points", points, (2, 3))
        self.dtype = self.points.dtype
        self._kept = points  # whose memory the kernels read
        self._starts = check_start("start", start, len(self.points))
        self._limit = square("radius", radius, self.points.dtype)
        self.threads = host_threads(backend, check_count("threads", threads))
        counts = np.diff(self._starts)
        self.fixed = max_pairs is not None
        self._room = check_slots("max_pairs", max_pairs, len(counts)) if self.fixed else ROOM * counts + ROOM
        self._cells = SortedCells(radius, self.points, Workspace(backend))
        self._found = np.zeros(len(counts), np.int64)
        self._recordings = Recordings()
        self.layout_version = 0
        self._lock = threading.Lock()
        self._bind()

    def _bind(self) -> None:
        """Allocate the arrays of pairs, and bind the launches of each shard of worlds."""
        hashed, starts, backend = self._cells, self._starts, self.backend
        self.count = kernel_array(self._found, backend)
        firsts = np.concatenate([[0], np.cumsum(self._room + PADDING)])  # lanes write behind the last pair too
        allowed(int(firsts[-1]))
        array = np.zeros((int(firsts[-1]), 2), np.int32)
        self.pairs, self.pair_start = kernel_array(array, backend), kernel_array(firsts, backend)
        self._array, self._first = array, firsts
        shape = (len(starts) - 1, hashed.dim), np.float64
        self._box = hashed.workspace.arrays("box", {"lower": shape, "upper": shape})
        shared: dict[str, Any] = {
            **kernel_arrays({**self._box, "point": self.points, "start": starts.astype(np.int32)}, backend),
            "cells": hashed.sorted_points(starts),
            "limit": self._limit,
            "fresh": 1,
        }

        def shard(first: int, count: int) -> list[Launch]:
            values = hashed.sort_values(starts, first, count)
            values["scratch"] = kernel_array(values["scratch"], backend)
            launches = [
                bind(hashed.kernels[name], 1, {**shared, **values}, "cpu") for name in ("bound_points", "sort_points")
            ]
            for w in range(first, first + count):
                out: dict[str, np.ndarray] = {"found": self._found[w : w + 1], "pair": array[firsts[w] : firsts[w + 1]]}
                given = {**shared, **kernel_arrays(out, backend), "world_offset": w, "worlds": 1}
                launches.append(bind(hashed.kernels["sweep_pairs"], 1, given, "cpu"))
            return launches

        shards = shards_of(np.diff(starts), self.threads)
        self._shards = [as_one(shard(first, count)) for first, count in shards]

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {"point": len(self.points), "world": len(self._starts) - 1}

    def __call__(self) -> Any:
        """Find the pairs of the present points and return ``count``.

        Raises:
            OverflowError: a world, which the error names, has more pairs than ``max_pairs``.
            ValueError: a point, which the error names, is not finite, or points are too far apart for float64.
        """
        if recording():
            self._recordings.note()
            run_shards(self._shards, self.threads)
            return self.count
        with self._lock:
            run_shards(self._shards, self.threads)
            while not self._whole():
                self._grow()
                run_shards(self._shards, self.threads)
        return self.count

    def _whole(self) -> bool:
        """Return whether all points were finite and all pairs fit."""
        with np.errstate(over="ignore", invalid="ignore"):  # a box of nothing spans from inf to -inf
            bounded = (self._box["upper"] - self._box["lower"] < np.inf).all()
        return bool(bounded and (self._found <= self._room).all())

    def _grow(self) -> None:
        """Enlarge the worlds whose pairs did not fit; raise an error for other failures."""
        self._explain(self.fixed)
        full = self._found > self._room
        self._room[full] = self._found[full] + self._found[full] // 8
        self.layout_version += 1
        left = self._found
        self._found = self._recordings.renew(left, self._shards)
        self._bind()
        left.fill(STALE)

    def check(self, room: bool = True) -> None:
        """Raise an error for a failure in the last call or replay, as a replay itself cannot raise.

        Args:
            room: whether to raise an error for pairs that did not fit.

        Raises:
            OverflowError, ValueError: see ``__call__``.
            RuntimeError: the replayed graph was recorded before ``layout_version`` changed.
        """
        self._recordings.check(self.layout_version)
        self._explain(room)

    def _explain(self, room: bool) -> None:
        """Raise an error for the failures of the last call."""
        check_points("points", self.points, (2, 3))
        lower, upper = self._box["lower"], self._box["upper"]
        with np.errstate(over="ignore", invalid="ignore"):
            wide = np.argwhere(upper - lower == np.inf)
        if len(wide):
            w, k = wide[0]
            raise ValueError(f"points of world {w} span more than float64 holds on axis {k}; they must span less [m]")
        full = np.flatnonzero(self._found > self._room)
        if room and len(full):
            w = int(full[0])
            raise OverflowError(f"world {w} has {int(self._found[w])} pairs; max_pairs is {int(self._room[w])}")

    def numpy(self) -> np.ndarray:
        """Return a copy of the pairs of all worlds, one world after the other, (m, 2) int32."""
        parts = [self._array[a : a + n] for a, n in zip(self._first, np.minimum(self._found, self._room))]
        return np.concatenate(parts) if parts else np.empty((0, 2), np.int32)
