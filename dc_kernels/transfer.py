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

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal

import numpy as np

from .arrays import aligned_zeros, check_values, float_dtype, to_numpy
from .backend import Launch, bind, check_backend, in_turn
from .grid import Grid
from .smoothing import KERNELS, STENCILS
from .types import LANES, TILE_COLUMNS, TILE_ROWS

NORMALIZE = {"sum": 0, "particle": 1}
BAND = 8  # rows of an image that are cleared and marked together
CHUNK = 4096  # points that one thread index gathers
SUPPORT = 2.0  # default h [spacing]
TILED_BYTES = 2**23  # of a world's channels, beyond which tiles are faster: 6 MB took 49 and 71 ns, 64 MB 250 and 70

Stencil = Literal["poly6", "spiky", "gaussian", "cubic", "wendland", "bilinear", "bspline"]


def transfer_kernels(backend: str, dtype: str) -> Mapping[str, Any]:
    """Kernels by name: splat_worlds, gather_points, gather_gradient, divide_image; for Warp tiles too."""
    if check_backend(backend) == "warp":
        from ._warp import tiles, transfer

        return {**transfer.kernels(dtype), **tiles.kernels(dtype)}
    from ._numpy.transfer import kernels

    return kernels(dtype)


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
    support = SUPPORT * grid.spacing if h is None else float(h)
    if not (0.0 < support < float("inf")):
        raise ValueError(f"h is {h!r}; it must be finite and > 0 [m]")
    if kernel in KERNELS and support > grid.spacing * 2**20:
        raise ValueError(f"h is {h!r} m, {support / grid.spacing:.3g} spacings; it must be at most 2^20 of them")
    return {
        "stencil": STENCILS[kernel],
        "normalize": NORMALIZE[normalize],
        "nearest": int(nearest),
        "spacing": grid.spacing,
        "h": support,
    }


def shard_worlds(worlds: int, threads: int) -> list[tuple[int, int]]:
    """First world and number of worlds of each thread's share."""
    edges = np.linspace(0, worlds, min(max(threads, 1), max(worlds, 1)) + 1).astype(int)
    return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]


def run_shards(launches: Sequence[Launch], pool: ThreadPoolExecutor | None) -> None:
    """Run launches that write disjoint memory, on the threads of a pool if there is one."""
    if pool is None or len(launches) == 1:
        in_turn(list(launches))()
    else:
        list(pool.map(lambda launch: launch(), launches))


def kernel_array(array: np.ndarray, backend: str) -> Any:
    """An array as the kernels of a backend take it, the same memory; (n, 2) floats under ``vectors`` become vec2."""
    if backend == "numpy":
        return array
    import warp as wp

    return wp.array(array, dtype=wp.dtype_from_numpy(array.dtype), device="cpu", copy=False)


def kernel_vectors(array: np.ndarray, backend: str) -> Any:
    """An array (n, 2) as the kernels of a backend take it: vec2 for Warp, the same memory."""
    if backend == "numpy":
        return array
    import warp as wp

    dtype = wp.types.vector(2, wp.dtype_from_numpy(array.dtype))
    return wp.array(array, dtype=dtype, shape=(len(array),), device="cpu", copy=False)


def check_points(points: Any, name: str = "points") -> np.ndarray:
    """Points (n, 2) of float32 or float64, contiguous and finite.

    Raises:
        ValueError: naming the field and the first bad index.
    """
    if not isinstance(points, np.ndarray):
        raise ValueError(f"{name} is a {type(points).__name__}; it must be a numpy array (n, 2)")
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{name} has shape {points.shape}; it must be (n, 2)")
    return check_floats(points, name)


def check_floats(array: Any, name: str, shape: tuple[int, ...] | None = None, dtype: Any = None) -> np.ndarray:
    """A contiguous numpy array of float32 or float64 without NaN or inf.

    Raises:
        ValueError: naming the field and what is wrong with it.
    """
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} is a {type(array).__name__}; it must be a numpy array")
    wanted = (np.dtype(np.float32), np.dtype(np.float64)) if dtype is None else (np.dtype(dtype),)
    if array.dtype not in wanted:
        raise ValueError(f"{name} has dtype {array.dtype}; it must be {' or '.join(map(str, wanted))}")
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; it must be {shape}")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} has strides {array.strides}; it must be contiguous")
    if not np.isfinite(array.sum()):  # a sum may overflow, so look again; it costs a tenth of looking at each
        check_values(name, array, array.shape, array.dtype)
    return array


def check_start(start: Any, count: int, name: str = "start") -> tuple[np.ndarray, np.ndarray]:
    """First point and number of points of each world, from offsets (W + 1,); None is one world with all of them.

    Raises:
        ValueError: naming the first bad index.
    """
    if count > 2**31 - 1:
        raise ValueError(f"there are {count} points; there may be 2^31 - 1")
    if start is None:
        return np.zeros(1, np.int32), np.full(1, count, np.int32)
    offsets = np.asarray(start)
    if offsets.ndim != 1 or len(offsets) < 1 or offsets.dtype.kind not in "iu":
        raise ValueError(f"{name} has shape {offsets.shape} and dtype {offsets.dtype}; it must be (W + 1,) integers")
    if offsets[0] != 0 or offsets[-1] != count:
        raise ValueError(f"{name} runs from {offsets[0]} to {offsets[-1]}; it must run from 0 to {count}")
    falls = np.flatnonzero(np.diff(offsets) < 0)
    if len(falls):
        i = int(falls[0])
        raise ValueError(f"{name}[{i + 1}] is {offsets[i + 1]}; it must not be below {name}[{i}] = {offsets[i]}")
    return offsets[:-1].astype(np.int32), np.diff(offsets).astype(np.int32)


def check_bins(bins: int, point_bin: Any, count: int) -> np.ndarray:
    """The bin of each point, int32; a dummy where there is one bin.

    Raises:
        ValueError: for bins < 1, another shape, or a bin out of range.
    """
    if not isinstance(bins, int | np.integer) or bins < 1:
        raise ValueError(f"bins is {bins!r}; it must be an integer of at least 1")
    if point_bin is None:
        if bins > 1:
            raise ValueError(f"bins is {bins}, so point_bin must say which one each point belongs to")
        return np.zeros(1, np.int32)
    array = check_values("point_bin", point_bin, (count,), np.dtype(np.int32))
    bad = np.flatnonzero((array < 0) | (array >= bins))
    if len(bad):
        raise ValueError(f"point_bin[{bad[0]}] is {array[bad[0]]}; it must lie in [0, {bins - 1}]")
    return array if bins > 1 else np.zeros(1, np.int32)


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
        item = 8 if "64" in str(to_numpy(values["value"]).dtype) else 4
        window = lanes_window(values["stencil"], values["h"] / values["spacing"])
        if tiled is None:
            tiled = backend == "warp" and rows * columns * channels * item > TILED_BYTES
        self.tiled = bool(tiled) and columns >= window
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
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
        scratch = aligned_zeros((threads, channels * TILE_ROWS * (TILE_COLUMNS + 2 * window)), np.dtype(f"f{item}"))
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
        threads = len(self._count)
        self._list = [self._bind("list_tiles", self.values["image"].shape[0], chunk=chunk) for chunk in range(threads)]
        # more shards than threads would need more buffers; tiles are many, and those of a shard lie side by side
        self._launches = [
            self._bind("splat_tiles", count, tile_offset=first, slot=slot)
            for slot, (first, count) in enumerate(shard_worlds(len(self.tile_lost), threads))
        ]

    def __call__(self) -> None:
        """Splat what the arrays hold now; ``missed`` then says how many points of each world reach no node."""
        if not self.tiled:
            run_shards(self._launches, self.pool)
            return
        self.tile_slot.fill(0)
        run_shards(self._count, self.pool)
        # the entries of a tile: those of the first chunk, of the second, ...: ordered by index whatever the chunks
        ends = np.cumsum(self.tile_slot.T.ravel(), dtype=np.int64)
        total = int(ends[-1])
        if total > 2**31 - 1 - TILE_ROWS:
            raise ValueError(f"the points reach {total} tiles in all; there may be 2^31: splat fewer worlds at once")
        chunks = len(self.tile_slot)
        starts = np.concatenate([[0], ends[:-1]]).reshape(-1, chunks)
        self.tile_slot[...] = starts.T
        self.tile_start[:-1] = starts[:, 0]
        self.tile_start[-1] = total
        if total > self.room:
            self._reserve(total + total // 8)
        run_shards(self._list, self.pool)
        run_shards(self._launches, self.pool)
        self.missed[...] = self.tile_lost.reshape(len(self.missed), -1).sum(axis=1)


def lanes_window(stencil: int, support: float) -> int:
    """Columns of the widest window of a point: whole vectors, as ``_warp/stencil.py`` places them."""
    return LANES if stencil >= len(KERNELS) else (int(2 * support) // LANES + 1) * LANES


class _Call:
    """Checked arguments of one splat or gather as the kernels take them."""

    def __init__(
        self,
        points: Any,
        grid: Grid,
        scalars: dict[str, Any],
        start: Any,
        bins: int,
        point_bin: Any,
        threads: int,
        backend: str,
    ) -> None:
        self.points = check_points(points)
        self.backend = check_backend(backend)
        self.dtype = self.points.dtype
        if not isinstance(threads, int | np.integer) or threads < 1:
            raise ValueError(f"threads is {threads!r}; it must be an integer of at least 1")
        self.threads = int(threads)
        self.first, self.count = check_start(start, len(points))
        self.worlds = len(self.first)
        self.grid = grid
        origin = np.tile(np.asarray(grid.origin, self.dtype), (self.worlds, 1))
        self.table = transfer_kernels(backend, self.dtype.name)
        self.values: dict[str, Any] = {
            **scalars,
            "bins": bins,
            "channel_offset": 0,
            "grid_origin": kernel_vectors(origin, backend),
            "point_start": kernel_array(self.first, backend),
            "point_count": kernel_array(self.count, backend),
            "point": kernel_vectors(self.points, backend),
            "point_bin": kernel_array(check_bins(bins, point_bin, len(points)), backend),
        }

    def with_arrays(self, **arrays: np.ndarray) -> dict[str, Any]:
        """The kernels' arguments with some more arrays."""
        return {**self.values, **{name: kernel_array(array, self.backend) for name, array in arrays.items()}}

    def splat(self, values: np.ndarray, image: np.ndarray) -> None:
        """Add to a zeroed image."""
        arguments = self.with_arrays(value=values, image=image)
        Splat(self.table, arguments, backend=self.backend, threads=self.threads)()

    def launch(self, name: str, chunks: int = 1, **arrays: np.ndarray) -> None:
        """Run a kernel over all worlds, ``chunks`` threads each."""
        values = {**self.with_arrays(**arrays), "chunks": chunks}
        shards = shard_worlds(self.worlds, self.threads)
        launches = [bind(self.table[name], n * chunks, {**values, "world_offset": w}, "cpu") for w, n in shards]
        with ThreadPoolExecutor(self.threads) as pool:
            run_shards(launches, pool)


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
        points: places relative to the worlds' origins, (n, 2), float32 or float64 [m].
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
    shepard = normalize == "shepard"
    scalars = stencil_scalars(grid, kernel, h, "sum" if shepard else normalize, nearest)
    call = _Call(points, grid, scalars, start, bins, point_bin, threads, backend)
    values = _check_channels(values, len(points), call.dtype)
    shape = (call.worlds, bins * values.shape[1], *grid.shape)
    if out is None:
        out = aligned_zeros(shape, call.dtype)
    else:
        check_floats(out, "out", shape, call.dtype).fill(0)
    call.splat(values, out)
    if shepard:
        weight = aligned_zeros((call.worlds, bins, *grid.shape), call.dtype)
        call.splat(np.ones((len(points), 1), call.dtype), weight)
        call.launch("divide_image", weight=weight, image=out)
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
    scalars = stencil_scalars(grid, kernel, h, normalize, nearest)
    call = _Call(points, grid, scalars, start, bins, point_bin, threads, backend)
    if not isinstance(image, np.ndarray) or image.ndim != 4:
        raise ValueError(f"image has shape {getattr(image, 'shape', None)}; it must be (W, bins C, rows, columns)")
    channels = image.shape[1] // bins
    check_floats(image, "image", (call.worlds, channels * bins, *grid.shape), call.dtype)
    if out is None:
        out = np.zeros((len(points), channels), call.dtype)
    else:
        check_floats(out, "out", (len(points), channels), call.dtype)
    if reverse:
        if normalize != "particle":
            raise ValueError(f"normalize is {normalize!r}; reverse needs 'particle'")
        weight = aligned_zeros((call.worlds, bins, *grid.shape), call.dtype)
        call.splat(np.ones((len(points), 1), call.dtype), weight)
        image = image.copy()  # what the caller's image holds is not ours to change
        call.launch("divide_image", weight=weight, image=image)
    call.launch("gather_points", max(-(-int(call.count.max(initial=0)) // CHUNK), 1), image=image, value=out)
    return out


def _check_channels(values: Any, count: int, dtype: np.dtype) -> np.ndarray:
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.shape[1] < 1:
        raise ValueError(f"values has shape {getattr(values, 'shape', None)}; it must be ({count}, C) with C >= 1")
    return check_floats(values, "values", (count, values.shape[1]), dtype)
