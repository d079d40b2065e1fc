"""Splat and gather: values at points to images on a grid, and back.

With the weights S_ip of point p at node i, a splat is ``image_i = sum_p S_ip value_p``, a gather its transpose
``value_p = sum_i S_ip image_i``. What S is, says ``normalize``:

- "particle": S_ip = W(|x_p - x_i|) / sum_j W(|x_p - x_j|) over the nodes in the grid: each point's weights sum to 1, at
  the border too, so a splat conserves the sum of its values and a gather reproduces constants (the theses' way);
- "sum": S_ip = W in 1/m^2, the SPH sum (seed, eq. 3.7), for values m/rho A;
- "shepard" (splat only): the SPH sum divided by that of ones: a weighted average, which reproduces constants.

Stencils "bilinear" (seed, eqs 3.15-3.17) and "bspline" (cubic B-spline, which smooths but reproduces linear fields)
have weights that sum to 1 by themselves, whatever ``normalize`` says; a point outside the grid is moved to its border.
With the radial ones a point outside reaches the nodes within h, if any. A point that reaches none is given to its
nearest node under "particle" (unless ``nearest`` is False) and contributes nothing under "sum".
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import BAND, CHUNK, TILE_COLUMNS, TILE_ROWS
from dc_kernels.model.arrays import aligned_zeros, float_dtype, kernel_array, kernel_arrays, kernel_vectors, to_numpy
from dc_kernels.runtime.backends import Launch, bind, check_backend, make_kernels
from dc_kernels.runtime.inputs import check_array, check_bins, check_count, check_layout, check_points, check_start
from dc_kernels.runtime.interop import host_view
from dc_kernels.runtime.threads import run_shards, shard_worlds
from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import KERNELS, STENCILS, check_support

NORMALIZE = {"sum": 0, "particle": 1}
SUPPORT = 2.0  # default h [spacing]
TILED_BYTES = 2**23  # of a world's channels, beyond which tiles are faster: 6 MB took 49 and 71 ns, 64 MB 250 and 70

Stencil = Literal["poly6", "spiky", "gaussian", "cubic", "wendland", "bilinear", "bspline"]


def transfer_kernels(backend: str, dtype: str) -> Mapping[str, Any]:
    """Kernels by name: splat_worlds, gather_points, gather_gradient, divide_image; for Warp tiles too."""
    table = make_kernels(backend, "grid.transfer", dtype)
    return {**table, **make_kernels(backend, "grid.tiles", dtype)} if backend == "warp" else table


def allocate_image(worlds: int, channels: int, grid: Grid, dtype: Any = "float32") -> np.ndarray:
    """A zeroed image (worlds, channels, rows, columns), its first byte aligned for SIMD loads."""
    return aligned_zeros((worlds, channels, *grid.shape), float_dtype(dtype))


def stencil_scalars(grid: Grid, kernel: str, h: float | None, normalize: str, nearest: bool) -> dict[str, Any]:
    """The scalar arguments of the kernels for a grid and a stencil.

    Raises:
        ValueError: naming the setting, when it is unknown or out of range.
    """
    if kernel not in STENCILS:
        raise ValueError(f"kernel is {kernel!r}; it must be one of {tuple(STENCILS)}")
    if normalize not in NORMALIZE:
        raise ValueError(f"normalize is {normalize!r}; it must be one of {tuple(NORMALIZE)}")
    support = SUPPORT * grid.spacing if h is None else check_support(h)
    if kernel in KERNELS and support > grid.spacing * 2**20:
        raise ValueError(f"h is {h!r} m, {support / grid.spacing:.3g} spacings; it must be at most 2^20 of them")
    return {
        "stencil": STENCILS[kernel],
        "normalize": NORMALIZE[normalize],
        "nearest": int(nearest),
        "spacing": grid.spacing,
        "h": support,
    }


def chunks_of(most: int) -> int:
    """Thread indices for each world, where none has more than ``most`` points."""
    return max(-(-most // CHUNK), 1)


def first_and_count(offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First point and number of points of each world, int32, from their offsets."""
    return offsets[:-1].astype(np.int32), np.diff(offsets).astype(np.int32)


class Splat:
    """A splat bound to its arrays: what they hold may change from call to call, their memory may not.

    Small images are one thread a world, each adding its points to the image; images that a core's cache cannot hold are
    splatted tile by tile. Only what the call before touched is cleared, and only what points reach is written: bands of
    8 rows, or tiles. The bits are the same either way, and for any number of threads.
    """

    def __init__(
        self,
        table: Mapping[str, Any],
        values: Mapping[str, Any],
        *,
        backend: str = "warp",
        threads: int = 1,
        tiled: bool | None = None,
    ) -> None:
        """Allocate what a splat needs beside its arrays.

        Args:
            table: the kernels, of ``transfer_kernels``.
            values: arguments of ``splat_worlds`` by name but ``touched`` and ``missed``; the image starts zeroed.
            backend: of the arrays.
            threads: that worlds or tiles are shared by.
            tiled: None: as the size of the image tells; the oracle has no tiles.
        """
        self.table, self.backend = table, backend
        worlds, _, rows, columns = values["image"].shape
        count, channels = values["value"].shape
        channels *= values["bins"]
        real = to_numpy(values["value"]).dtype
        window = lanes_window(values["stencil"], values["h"] / values["spacing"])
        if tiled is None:
            tiled = backend == "warp" and rows * columns * channels * real.itemsize > TILED_BYTES
        self.tiled = bool(tiled) and columns >= window
        self.threads = threads
        self.missed = np.zeros(worlds, np.int32)
        self.values = {**values, "missed": kernel_array(self.missed, backend)}
        if not self.tiled:
            touched = np.zeros((worlds, -(-rows // BAND)), np.int32)
            self.values["touched"] = kernel_array(touched, backend)
            self._launches = [self._bind("splat_worlds", n, world_offset=w) for w, n in shard_worlds(worlds, threads)]
            return
        tiles = -(-rows // TILE_ROWS) * -(-columns // TILE_COLUMNS)
        self.tile_slot = np.zeros((threads, worlds * tiles), np.int32)
        self.tile_start = np.zeros(worlds * tiles + 1, np.int32)
        self.tile_lost = np.zeros(worlds * tiles, np.int32)
        scratch = aligned_zeros((threads, channels * TILE_ROWS * (TILE_COLUMNS + 2 * window)), real)
        self.values.update(
            tiles=tiles,
            chunks=threads,
            scratch=kernel_array(scratch, backend),
            tile_slot=kernel_array(self.tile_slot, backend),
            tile_start=kernel_array(self.tile_start, backend),
            tile_lost=kernel_array(self.tile_lost, backend),
            tile_touched=kernel_array(np.zeros(worlds * tiles, np.int32), backend),
        )
        self._count = [self._bind("count_tiles", worlds, chunk=chunk) for chunk in range(threads)]
        self._reserve(count + count // 2)

    def _bind(self, name: str, dim: int, **values: Any) -> Launch:
        return bind(self.table[name], dim, {**self.values, **values}, "cpu")

    def _reserve(self, entries: int) -> None:
        """Room for the entries of all tiles, and what is fetched ahead of the last."""
        self.room = entries
        order = np.zeros(entries + TILE_ROWS, np.int32)
        self.values["order"] = kernel_array(order, self.backend)
        threads = self.threads
        self._list = [self._bind("list_tiles", self.values["image"].shape[0], chunk=chunk) for chunk in range(threads)]
        # more shards than threads would need more buffers; tiles are many, and those of a shard lie side by side
        self._launches = [
            self._bind("splat_tiles", count, tile_offset=first, slot=slot)
            for slot, (first, count) in enumerate(shard_worlds(len(self.tile_lost), threads))
        ]

    def __call__(self) -> None:
        """Splat what the arrays hold now; ``missed`` then says how many points of each world reach no node."""
        if not self.tiled:
            run_shards(self._launches, self.threads)
            return
        self.tile_slot.fill(0)
        run_shards(self._count, self.threads)
        # the entries of a tile: those of the first chunk, of the second, ...: ordered by index whatever the chunks
        ends = np.cumsum(self.tile_slot.T.ravel(), dtype=np.int64)
        total = int(ends[-1])
        if total > 2**31 - 1 - TILE_ROWS:
            raise ValueError(f"the points reach {total} tiles in all; there may be 2^31: splat fewer worlds at once")
        starts = np.concatenate([[0], ends[:-1]]).reshape(-1, self.threads)
        self.tile_slot[...] = starts.T
        self.tile_start[:-1] = starts[:, 0]
        self.tile_start[-1] = total
        if total > self.room:
            self._reserve(total + total // 8)
        run_shards(self._list, self.threads)
        run_shards(self._launches, self.threads)
        self.missed[...] = self.tile_lost.reshape(len(self.missed), -1).sum(axis=1)


def lanes_window(stencil: int, support: float) -> int:
    """Columns of the widest window of a point: whole vectors, as ``_warp/stencil.py`` places them."""
    return LANES if stencil >= len(KERNELS) else (int(2 * support) // LANES + 1) * LANES


class Transfer:
    """Points on a grid, checked once: splats and gathers of them are bound to arrays and cost microseconds a call.

    The points may move between calls and values change in place; what was checked is then no longer looked at, and a
    point that is not finite contributes nothing.
    """

    def __init__(
        self,
        points: np.ndarray,
        grid: Grid,
        *,
        h: float | None = None,
        kernel: Stencil = "poly6",
        normalize: Literal["particle", "sum"] = "particle",
        start: Any = None,
        bins: int = 1,
        point_bin: Any = None,
        nearest: bool = True,
        threads: int = 1,
        backend: str = "warp",
    ) -> None:
        """Check the points; arguments as of ``splat``.

        Raises:
            ValueError: naming field, index and limit, for input that is not as described.
        """
        self.points = check_points("points", points)
        self.grid = grid
        self.backend = check_backend(backend)
        self.dtype = self.points.dtype
        self.threads = check_count("threads", threads)
        scalars = stencil_scalars(grid, kernel, h, normalize, nearest)
        first, count = first_and_count(check_start("start", start, len(self.points)))
        self.worlds = len(first)
        self.bins = bins
        self.chunks = chunks_of(int(count.max(initial=0)))
        origin = np.tile(np.asarray(grid.origin, self.dtype), (self.worlds, 1))
        self.table = transfer_kernels(backend, self.dtype.name)
        self.values: dict[str, Any] = {
            **scalars,
            "bins": bins,
            "channel_offset": 0,
            "grid_origin": kernel_vectors(origin, backend),
            "point_start": kernel_array(first, backend),
            "point_count": kernel_array(count, backend),
            "point": kernel_vectors(self.points, backend),
            "point_bin": kernel_array(check_bins(bins, point_bin, len(self.points)), backend),
        }

    def splat(self, values: np.ndarray, image: np.ndarray) -> Splat:
        """What splats ``values`` (n, C) onto ``image`` (W, bins C, rows, columns), which is zero at first.

        Raises:
            ValueError: for arrays of another shape, dtype or memory layout.
        """
        values = _check_channels(values, len(self.points), self.dtype)
        image = check_layout("image", image, self._shape(values.shape[1]), self.dtype)
        return self._bind_splat(values, image)

    def _bind_splat(self, values: np.ndarray, image: np.ndarray) -> Splat:
        arrays = kernel_arrays({"value": values, "image": image}, self.backend)
        return Splat(self.table, {**self.values, **arrays}, backend=self.backend, threads=self.threads)

    def gather(self, image: np.ndarray, values: np.ndarray) -> Launch:
        """What gathers ``image`` at the points into ``values`` (n, C).

        Raises:
            ValueError: for arrays of another shape, dtype or memory layout.
        """
        values = check_layout("values", values, (len(self.points), None), self.dtype)
        image = check_array("image", image, self._shape(values.shape[1]), self.dtype)
        return self._bind("gather_points", self.chunks, image=image, value=values)

    def divide(self, image: np.ndarray, weight: np.ndarray) -> Launch:
        """What divides ``image`` by the weights (W, bins, rows, columns) that reached its nodes; 0 where none did."""
        return self._bind("divide_image", 1, image=image, weight=weight)

    def weights(self) -> np.ndarray:
        """The sum of the points' weights at each node, (W, bins, rows, columns)."""
        image = allocate_image(self.worlds, self.bins, self.grid, self.dtype)
        self._bind_splat(np.ones((len(self.points), 1), self.dtype), image)()
        return image

    def _shape(self, channels: int) -> tuple[int, ...]:
        """Of an image of so many channels a bin."""
        return (self.worlds, self.bins * channels, *self.grid.shape)

    def _bind(self, name: str, chunks: int, **arrays: np.ndarray) -> Launch:
        values = {**self.values, "chunks": chunks}
        values.update(kernel_arrays(arrays, self.backend))
        shards = shard_worlds(self.worlds, self.threads)
        launches = [bind(self.table[name], n * chunks, {**values, "world_offset": w}, "cpu") for w, n in shards]
        return functools.partial(run_shards, launches, self.threads)


def splat(
    points: np.ndarray,
    values: np.ndarray,
    grid: Grid,
    *,
    h: float | None = None,
    kernel: Stencil = "poly6",
    normalize: Literal["particle", "shepard", "sum"] = "particle",
    start: Any = None,
    bins: int = 1,
    point_bin: Any = None,
    nearest: bool = True,
    threads: int = 1,
    backend: str = "warp",
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Values at points as an image.

    Args:
        points: places relative to the worlds' origins, (n, 2), float32 or float64 [m]; like all arrays numpy,
            ``wp.array`` or a torch tensor on the CPU, contiguous, read where it lies.
        values: (n, C), of the same dtype.
        grid: where the nodes lie.
        h: support radius of a radial kernel [m]; None: 2 spacings.
        kernel: name of the stencil.
        normalize: see the module.
        start: offsets of the worlds' points, (W + 1,); None: one world.
        bins: parts of the image that points are kept apart in, such as directions of contact normals.
        point_bin: bin of each point, (n,); needed for bins > 1.
        nearest: give a point that reaches no node to its nearest one, under "particle".
        threads: worlds, or tiles of a large image, are shared by so many threads; the bits do not depend on it.
        backend: "warp", or "numpy": the oracle.
        out: image to write instead of a new one; all of it is overwritten.

    Returns:
        (W, bins C, rows, columns); value c of a point of bin b is in channel b C + c.

    Raises:
        ValueError: naming field, index and limit, for input that is not as described.
    """
    transfer = Transfer(
        points,
        grid,
        h=h,
        kernel=kernel,
        normalize="sum" if normalize == "shepard" else normalize,
        start=start,
        bins=bins,
        point_bin=point_bin,
        nearest=nearest,
        threads=threads,
        backend=backend,
    )
    values = _check_channels(values, len(transfer.points), transfer.dtype)
    if out is None:
        out = allocate_image(transfer.worlds, bins * values.shape[1], grid, transfer.dtype)
    else:
        out = check_layout("out", out, transfer._shape(values.shape[1]), transfer.dtype)
        out.fill(0)
    transfer._bind_splat(values, out)()  # what is checked already is not looked at again
    if normalize == "shepard":
        transfer.divide(out, transfer.weights())()
    return out


def gather(
    image: np.ndarray,
    points: np.ndarray,
    grid: Grid,
    *,
    h: float | None = None,
    kernel: Stencil = "bilinear",
    normalize: Literal["particle", "sum"] = "particle",
    reverse: bool = False,
    start: Any = None,
    bins: int = 1,
    point_bin: Any = None,
    nearest: bool = True,
    threads: int = 1,
    backend: str = "warp",
    out: np.ndarray | None = None,
) -> np.ndarray:
    """An image at points: the transpose of ``splat`` with the same arguments.

    Args:
        image: (W, bins C, rows, columns), of the points' dtype.
        points: see ``splat``, as are the other arguments.
        reverse: share what a node holds among the points that reach it, in proportion to their weights (reverse SPH,
            Engedal 2018): the sum over the image's touched nodes comes back, and points whose supports do not
            overlap get back exactly what they gave. Needs normalize "particle".
        out: array to write instead of a new one.

    Returns:
        (n, C).

    Raises:
        ValueError: naming field, index and limit, for input that is not as described.
    """
    transfer = Transfer(
        points,
        grid,
        h=h,
        kernel=kernel,
        normalize=normalize,
        start=start,
        bins=bins,
        point_bin=point_bin,
        nearest=nearest,
        threads=threads,
        backend=backend,
    )
    image = host_view("image", image)
    if not isinstance(image, np.ndarray) or image.ndim != 4:
        raise ValueError(f"image has shape {getattr(image, 'shape', None)}; it must be (W, bins C, rows, columns)")
    channels = max(image.shape[1] // bins, 1)
    check_array("image", image, transfer._shape(channels), transfer.dtype)
    if reverse and normalize != "particle":
        raise ValueError(f"normalize is {normalize!r}; reverse needs 'particle'")
    if out is None:
        out = np.zeros((len(transfer.points), channels), transfer.dtype)
    else:
        out = check_layout("out", out, (len(transfer.points), channels), transfer.dtype)
    if reverse:
        image = image.copy()  # what the caller's image holds is not ours to change
        transfer.divide(image, transfer.weights())()
    transfer._bind("gather_points", transfer.chunks, image=image, value=out)()
    return out


def _check_channels(values: Any, count: int, dtype: np.dtype) -> np.ndarray:
    values = check_array("values", values, (count, None), dtype)
    if values.shape[1] < 1:
        raise ValueError(f"values has shape {values.shape}; it must have a channel")
    return values
