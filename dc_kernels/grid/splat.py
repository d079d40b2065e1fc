"""Splat as a stage: bound to its arrays once, then called; small images world by world, large ones tile by tile."""

from __future__ import annotations

import functools
import threading
from typing import Any

import numpy as np

from dc_kernels.grid.fields import POINTS, STENCIL, TILES
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import BAND, CHUNK, TILE_COLUMNS, TILE_ROWS
from dc_kernels.grid.stencil import Stencil
from dc_kernels.model.arrays import kernel_array, to_numpy
from dc_kernels.model.dtypes import aligned_zeros, float_dtype
from dc_kernels.runtime.backends import BACKENDS, Launch, bind, has_kernels, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.capture import HOST, recording, refuse_recording
from dc_kernels.runtime.memory import check_memory
from dc_kernels.runtime.program import Kernel, Stage
from dc_kernels.runtime.threads import run_shards, shard_worlds, slices_of

LONG = 8  # slices of work, beyond which a splat goes by tiles whatever the size of its image
MOST_REACHED = 1e8  # entries of tiles, up to which it does so
FINER = 4  # launches for a slice: a weight may take 8 ns
MOST_COUNTED = 2**24  # numbers by which entries of tiles are counted in parts
TILED_BYTES = 2**23  # of a world's channels, beyond which tiles are faster: 6 MB took 49 and 71 ns, 64 MB 250 and 70


def transfer_kernels(backend: str, dtype: str) -> dict[str, Any]:
    """Look up splat_worlds, gather_points, gather_gradient, divide_image, and those of tiles where there are."""
    files = ["grid.splat", "grid.gather", *(["grid.tiles"] if has_kernels(backend, "grid.tiles") else [])]
    return {name: kernel for file in files for name, kernel in make_kernels(backend, file, dtype).items()}


def allocate_image(worlds: int, channels: int, grid: Grid, dtype: Any = "float32") -> np.ndarray:
    """Return a zeroed image (worlds, channels, rows, columns), its first byte aligned for SIMD loads."""
    real = float_dtype(dtype)
    rows, columns = grid.shape
    what = f"an image of {worlds} worlds, {channels} channels, {rows} rows and {columns} columns of the grid"
    check_memory(what, float(worlds) * channels * rows * columns * real.itemsize)
    return aligned_zeros((worlds, channels, rows, columns), real)


def chunks_of(most: int) -> int:
    """Return the thread indices for each world of a gather, where none has more than ``most`` points."""
    return max(-(-most // CHUNK), 1)


def first_and_count(offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first point and number of points of each world, int32, from their offsets."""
    return offsets[:-1].astype(np.int32), np.diff(offsets).astype(np.int32)


def stencil_group(stencil: Stencil, grid: Grid, backend: str, dtype: str) -> Any:
    """Return a stencil on a grid as the kernels of a backend take it.

    Raises:
        ValueError: when its support is too large for the grid.
    """
    return kernel_file(backend, "groups").group("stencil", dtype, STENCIL, stencil.arguments(grid))


def points_group(grid: Grid, worlds: int, backend: str, dtype: str, **arrays: Any) -> Any:
    """Return points on a grid as the kernels of a backend take them.

    Args:
        grid: relative to each world's origin.
        worlds: how many there are.
        backend: of the kernels.
        dtype: of the places.
        arrays: the fields of ``grid.fields.POINTS`` but ``origin``, or arrays of the backend; no ``bin``: one bin.
    """
    origin = np.tile(np.asarray(grid.origin, dtype), (worlds, 1))
    values = {"origin": origin, "bin": np.zeros(1, np.int32), **arrays}
    return kernel_file(backend, "groups").group("points", dtype, POINTS, values)


class Splat:
    """A splat bound to its arrays: what they hold may change from call to call, their memory may not.

    Small images are one thread a world, each adding its points to the image; images that a core's cache cannot hold are
    splatted tile by tile. Only what the call before touched is cleared, and only what points reach is written: bands of
    8 rows, or tiles. The bits are the same either way, and for any number of threads.

    Attributes:
        missed: points of each world that reached no node in the last call, (W,).
        touched: what holds values, (W, bands); None with tiles.
    """

    def __init__(
        self,
        stencil: Stencil,
        grid: Grid,
        points: Any,
        value: Any,
        image: Any,
        *,
        bins: int = 1,
        channel_offset: int = 0,
        backend: str = "warp",
        threads: int = 1,
        tiled: bool | None = None,
    ) -> None:
        """Allocate what a splat needs beside its arrays.

        Args:
            stencil: weights of the nodes.
            grid: of the image.
            points: of ``points_group``.
            value: (n, C), as the kernels take it.
            image: (W, at least channel_offset + bins C, rows, columns), as the kernels take it; zeroed.
            bins: parts of the image that points are kept apart in.
            channel_offset: first channel that is written.
            backend: of the arrays.
            threads: that worlds or tiles are shared by.
            tiled: None: as the size of the image tells, but not in a recording; the oracle has no tiles.
        """
        dtype = to_numpy(value).dtype
        self.table, self.backend = transfer_kernels(backend, dtype.name), backend
        worlds, _, rows, columns = image.shape
        count, channels = value.shape
        channels *= bins
        window = stencil.window(grid.spacing)
        nodes = stencil.nodes(grid.spacing)
        self._slices = slices_of(count * channels * nodes)
        reached = count * (window / TILE_COLUMNS + 1.0) * (window / TILE_ROWS + 1.0)
        if tiled is None:
            # what takes long goes by tiles, which threads share, unless points reach too many
            tiled = rows * columns * channels * dtype.itemsize > TILED_BYTES
            tiled |= self._slices > LONG and reached < MOST_REACHED
            # tiles are counted on the host
            tiled = tiled and "splat_tiles" in self.table and not recording()
        self.tiled = bool(tiled) and columns >= window
        self.missed = np.zeros(worlds, np.int32)
        self.values: dict[str, Any] = {
            "stencil": stencil_group(stencil, grid, backend, dtype.name),
            "bins": bins,
            "channel_offset": channel_offset,
            "points": points,
            "value": value,
            "missed": kernel_array(self.missed, backend),
            "image": image,
        }
        self.touched: Any = None
        self._slots, self.threads = threads, host_threads(backend, threads)
        self._own = threads // self.threads  # that a launch shares itself
        self._lock = threading.Lock()
        self._most = 0  # points of a world that one launch adds; 0: all
        if not self.tiled:
            if BACKENDS[backend].compiled and self._slices > 1 and not recording():
                self._most = -(-count // (FINER * self._slices))
                self._points = points
                self._part = {name: to_numpy(getattr(points, name)).copy() for name in ("start", "count")}
                part = {name: getattr(points, name) for name in POINTS} | self._part
                self.values["points"] = kernel_file(backend, "groups").group("points", dtype.name, POINTS, part)
            self.touched = kernel_array(np.zeros((worlds, -(-rows // BAND)), np.int32), backend)
            self.values["touched"] = self.touched
            shards = shard_worlds(worlds, max(self.threads, 1 if recording() else self._slices))
            self._launches = [self._bind("splat_worlds", n, world_offset=w) for w, n in shards]
            return
        self._tile_rows, self._tile_columns = -(-rows // TILE_ROWS), -(-columns // TILE_COLUMNS)
        tiles = self._tile_rows * self._tile_columns
        self._parts = max(threads, min(FINER * slices_of(reached), MOST_COUNTED // max(worlds * tiles, 1)))
        self._entry = channels * min(nodes, float(TILE_ROWS * TILE_COLUMNS))
        options: dict[str, Any] = {"bins": bins, "channel_offset": channel_offset, "backend": backend, "tiled": False}
        self._make_untiled = functools.partial(Splat, stencil, grid, points, value, image, threads=threads, **options)
        self._untiled: Splat | None = None
        self.tiles = {
            "slot": np.zeros((self._parts, worlds * tiles), np.int32),
            "start": np.zeros(worlds * tiles + 1, np.int32),
            "lost": np.zeros(worlds * tiles, np.int32),
            "touched": np.zeros(worlds * tiles, np.int32),
            "scratch": aligned_zeros((threads, channels * TILE_ROWS * (TILE_COLUMNS + 2 * window)), dtype),
        }
        span = -(-worlds * tiles // threads)
        self.values.update(slot_tiles=span, chunks=self._parts)
        self._reserve(count + count // 2)

    @property
    def per_world(self) -> Kernel | None:
        """The kernel that does all of this with a thread a world; None with tiles, and where it takes long."""
        return None if self.tiled or self._most else Kernel(self.table["splat_worlds"], self.values)

    def clear_also(self, world: np.ndarray, row: np.ndarray, column: np.ndarray) -> Stage:
        """Return what makes the next call clear these nodes, (n,) each, whatever reached them in the call before."""
        if self.tiled:
            tile = row // TILE_ROWS * self._tile_columns + column // TILE_COLUMNS
            found = np.unique(world * self._tile_rows * self._tile_columns + tile)
            return functools.partial(self.tiles["touched"].__setitem__, found, 1)
        band = np.zeros(self.touched.shape, np.int32)
        band[world, row // BAND] = 1
        values = {"band": kernel_array(band, self.backend), "touched": self.touched}
        return Kernel(self.table["mark_bands"], values)

    def _bind(self, name: str, dim: int | tuple[int, int], **values: Any) -> Launch:
        return bind(self.table[name], dim, {"threads": self._own, **self.values, **values}, "cpu")

    def _reserve(self, entries: int) -> None:
        """Make room for the entries of all tiles, and what is fetched ahead of the last."""
        self.room = entries
        arrays = {**self.tiles, "order": np.zeros(entries + TILE_ROWS, np.int32)}
        dtype = self.tiles["scratch"].dtype.name
        self.values["tiles"] = kernel_file(self.backend, "groups").group("tiles", dtype, TILES, arrays)
        worlds, own = len(self.missed), self._own
        self._count, self._list = (
            [self._bind(name, (min(own, self._parts - k), worlds), first_chunk=k) for k in range(0, self._parts, own)]
            for name in ("count_tiles", "list_tiles")
        )
        # more slots than threads would need more buffers; tiles are many, and those of a slot lie side by side
        tiles = len(self.tiles["lost"])
        span = self.values["slot_tiles"]
        parts = shard_worlds(span, FINER * self._slices)
        self._edges = np.array([first + part for first in range(0, tiles, span) for part, _ in parts])
        self._edges = self._edges[self._edges < tiles]
        # slice by slice, each by all threads
        self._tiled = [
            [
                self._bind("splat_tiles", (self._own, n), tile_offset=slot * span + part, first_slot=slot)
                for slot in range(0, self._slots, self._own)
            ]
            for part, n in parts
        ]

    def __call__(self) -> None:
        """Splat what the arrays hold now; ``missed`` then says how many points of each world reach no node.

        Raises:
            ValueError: for a splat by tiles whose points reach 2^31 tiles or more in all.
            RuntimeError: for a splat by tiles in a recording.
        """
        if self._most:
            with self._lock:  # two calls at once would add other points than theirs
                self._splat_parts()
            return
        if not self.tiled:
            run_shards(self._launches, self.threads)
            return
        refuse_recording("a splat by tiles", f"{HOST}; one that is bound in the recording has none")
        with self._lock:  # two calls at once would count into the same tiles
            self._splat_tiles()

    def _splat_parts(self) -> None:
        """Add so many points of each world at a time, in their order: an interrupt arrives between two parts."""
        refuse_recording("a splat that takes long", f"{HOST}; one that is bound in the recording is one launch")
        start, count = (to_numpy(getattr(self._points, name)) for name in ("start", "count"))
        touched, missed = to_numpy(self.touched), np.zeros_like(self.missed)
        reached = np.zeros_like(touched)
        try:
            for first in range(0, max(int(count.max(initial=0)), 1), self._most):
                self._part["start"][:] = start + np.minimum(first, count)
                self._part["count"][:] = np.clip(count - first, 0, self._most)
                run_shards(self._launches, self.threads)
                missed += self.missed
                reached |= touched
                touched[:] = 0  # else the next part would clear what this one has added
        finally:
            touched |= reached
        self.missed[...] = missed

    def _splat_untiled(self) -> None:
        """Splat part by part onto an image that is cleared, and that the next splat by tiles clears as a whole."""
        if self._untiled is None:
            self._untiled = self._make_untiled()
        first, channels = self.values["channel_offset"], self.values["bins"] * self.values["value"].shape[1]
        to_numpy(self.values["image"])[:, first : first + channels] = 0
        to_numpy(self._untiled.touched)[:] = 0
        self.tiles["touched"][:] = 1
        self._untiled()
        self.missed[...] = self._untiled.missed

    def _splat_tiles(self) -> None:
        slot, start = self.tiles["slot"], self.tiles["start"]
        slot.fill(0)
        run_shards(self._count, self.threads)
        # the entries of a tile: those of the first chunk, of the second, ...: ordered by index whatever the chunks
        ends = np.cumsum(slot.T.ravel(), dtype=np.int64)
        total = int(ends[-1])
        if total > 2**31 - 1 - TILE_ROWS:
            raise ValueError(f"the points reach {total} tiles in all; there may be 2^31: splat fewer worlds at once")
        starts = np.concatenate([[0], ends[:-1]]).reshape(-1, self._parts)
        slot[...] = starts.T
        start[:-1] = starts[:, 0]
        start[-1] = total
        if slices_of(float(np.diff(start[self._edges], append=total).max()) * self._entry) > 1:
            self._splat_untiled()  # too many reach one tile for an interrupt to wait until it is done
            return
        if total > self.room:
            self._reserve(total + total // 8)
        run_shards(self._list, self.threads)
        for launches in self._tiled:
            run_shards(launches, self.threads)
        self.missed[...] = self.tiles["lost"].reshape(len(self.missed), -1).sum(axis=1)
