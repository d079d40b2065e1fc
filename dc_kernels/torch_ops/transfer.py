"""Splat and gather as torch operators, differentiable by values, images, positions; they need the extra ``pipeline``.

Importing this module registers ``deep_contact::splat`` and ``deep_contact::gather`` with torch, so that autograd and
``torch.compile`` see one opaque operator each. Both run in the kernels of ``transfer``, on the tensors' own memory.
With the weights S_ip of ``transfer`` each is the other's adjoint:

    splat   image_i = sum_p S_ip value_p     values: gather of the cotangent
    gather  value_p = sum_i S_ip image_i     image:  splat of the cotangent
    both    place of p:                      sum_c value_pc sum_i (d S_ip / d x_p) image_ci

so every result is written by one thread and its bits do not depend on the number of threads. Places have no derivative
where a point changes the nodes it reaches (bilinear: on the lines between nodes; Gaussian: at r = h): there it is that
of one side. A point beyond the grid that is moved onto it, or that is given to its nearest node, has derivative 0.

Second derivatives: by values and images they exist; a derivative by places has none, and raises.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import BAND
from dc_kernels.grid.splat import (
    TILED_BYTES,
    Splat,
    chunks_of,
    first_and_count,
    points_group,
    stencil_group,
    transfer_kernels,
)
from dc_kernels.grid.stencil import BILINEAR, POLY6, Stencil, check_place
from dc_kernels.model.arrays import kernel_array
from dc_kernels.runtime.backends import argument_names, check_backend, has_kernels
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_bins, check_count, check_places, check_start, check_truth
from dc_kernels.runtime.interop import tensor_array, tensor_integers
from dc_kernels.runtime.launches import Calls
from dc_kernels.runtime.program import Kernel, bind_part
from dc_kernels.torch_ops.tensors import check_devices, check_tensors, flat, flat_batch, given_tensor

torch = require("torch", "pipeline")

_COMMON = (
    "Tensor? start, Tensor? point_bin, int rows, int columns, float spacing, float origin_x, float origin_y, "
    "str kernel, float? h, str normalize, bool nearest, int bins, int threads, str backend"
)


def splat_torch(
    points: Any,
    values: Any,
    grid: Grid,
    stencil: Stencil = POLY6,
    *,
    start: Any = None,
    bins: int = 1,
    point_bin: Any = None,
    threads: int = 1,
    backend: str = "warp",
) -> Any:
    """``transfer.splat`` of tensors, differentiable by points and values.

    Args:
        points: positions relative to the worlds' origins, (n, 2), contiguous on the CPU, float32 or float64, finite; or
            (n, 3), with z ignored; or an equal number for each world, (W, n, 2) or (W, n, 3), without ``start`` [m].
        values: (n, C), of the same dtype, contiguous on the CPU; NaN and inf propagate to nodes nearby; or
            (W, n, C), as the points.
        grid: where the nodes lie.
        stencil: weights of the nodes.
        start: offsets of the worlds' points, (W + 1,) integers; None: one world.
        bins: number of bins that separate points.
        point_bin: bin of each point, (n,) integers; needed for bins > 1.
        threads: number of threads that share worlds, or tiles of a large image.
        backend: backend of the kernels, as in ``transfer``.

    Returns:
        (W, bins C, rows, columns); value c of a point of bin b is in channel b C + c.

    Raises:
        ValueError: an argument, which the error names, has another dtype, device or memory layout (nothing is copied),
            or is out of range.
    """
    check_tensors(points=points, values=values)
    if points.dim() == 3:
        if values.dim() != 3 or values.shape[:2] != points.shape[:2]:
            worlds, count = points.shape[:2]
            raise ValueError(
                f"values has shape {tuple(values.shape)}; it must be ({worlds}, {count}, C), as points are"
            )
        points, start, point_bin = flat_batch(points, start, point_bin)
        values = flat("values", values)
    settings = _settings(grid, stencil, start, bins, point_bin, threads, backend)
    image = torch.ops.deep_contact.splat(points, values, *settings)
    return _share(image, _weights(points, settings), bins) if stencil.normalize == "shepard" else image


def gather_torch(
    image: Any,
    points: Any,
    grid: Grid,
    stencil: Stencil = BILINEAR,
    *,
    reverse: bool = False,
    start: Any = None,
    bins: int = 1,
    point_bin: Any = None,
    threads: int = 1,
    backend: str = "warp",
) -> Any:
    """``transfer.gather`` of tensors, differentiable by image and points.

    Args:
        image: (W, bins C, rows, columns), of the points' dtype, contiguous on the CPU; NaN and inf propagate
            to points nearby.
        points: see ``splat_torch``.
        grid: where the nodes lie.
        stencil: weights of the nodes; not normalized by "shepard".
        reverse: whether to divide the value of a node among the points that reach it (reverse SPH, Engedal 2018);
            needs normalize "particle", and memory for the divided image.
        start: see ``splat_torch``.
        bins: see ``splat_torch``.
        point_bin: see ``splat_torch``.
        threads: see ``splat_torch``.
        backend: see ``splat_torch``.

    Returns:
        (n, C), or (W, n, C) for points (W, n, ...).

    Raises:
        ValueError: as for ``splat_torch``.
    """
    check_place(grid, stencil)
    stencil.check_gather(check_truth("reverse", reverse))
    check_tensors(image=image, points=points)
    batch = points.shape[:2] if points.dim() == 3 else None
    if batch is not None:
        points, start, point_bin = flat_batch(points, start, point_bin)
    settings = _settings(grid, stencil, start, bins, point_bin, threads, backend)
    if reverse:
        image = _share(image, _weights(points, settings), bins)
    value = torch.ops.deep_contact.gather(image, points, *settings)
    return value if batch is None else value.unflatten(0, batch)


def _settings(
    grid: Grid, stencil: Stencil, start: Any, bins: int, point_bin: Any, threads: int, backend: str = "warp"
) -> tuple[Any, ...]:
    """The arguments of ``_COMMON``."""
    check_place(grid, stencil)
    stencil.support(grid.spacing)
    return (
        given_tensor("start", start),
        given_tensor("point_bin", point_bin),
        grid.rows,
        grid.columns,
        grid.spacing,
        *grid.origin,
        stencil.kernel,
        stencil.h,
        stencil.normalize,
        stencil.nearest,
        check_count("bins", bins),
        check_count("threads", threads),
        check_backend(backend),
    )


def _weights(points: Any, settings: tuple[Any, ...]) -> Any:
    """The sum of the points' weights at each node, (W, bins, rows, columns)."""
    return torch.ops.deep_contact.splat(points, points.new_ones((points.shape[0], 1)), *settings)


def _share(image: Any, weight: Any, bins: int) -> Any:
    """Image / weight, 0 where no point reaches; masked before the division, for a 0 / 0 has a gradient NaN."""
    _check_shape(image, weight.shape[0], bins, weight.shape[2:])
    parts = image.unflatten(1, (bins, -1))
    weight = weight.unsqueeze(2)
    reached = weight > 0
    return torch.where(reached, parts / torch.where(reached, weight, 1.0), 0.0).flatten(1, 2)


# ------------------------------------------------------------------ operators


@torch.library.custom_op(
    "deep_contact::splat", mutates_args=(), schema=f"(Tensor points, Tensor values, {_COMMON}) -> Tensor"
)
def _splat(points: Any, values: Any, *settings: Any) -> Any:
    call = _Call(points, settings)
    shape = (call.worlds, call.bins * call.check_values(values), *call.shape)
    large = math.prod(shape[1:]) * values.element_size() > TILED_BYTES
    if large and has_kernels(call.backend, "grid.tiles"):
        image = values.new_zeros(shape)
        call.run_tiled(values, image)
        return image
    image = values.new_empty(shape)
    # all bands are marked, so that each world's thread clears its own part of the image
    touched = torch.ones((call.worlds, -(-call.shape[0] // BAND)), dtype=torch.int32)
    missed = torch.empty(call.worlds, dtype=torch.int32)
    call.run("splat_worlds", value=values, touched=touched, missed=missed, image=image)
    return image


@torch.library.custom_op(
    "deep_contact::gather", mutates_args=(), schema=f"(Tensor image, Tensor points, {_COMMON}) -> Tensor"
)
def _gather(image: Any, points: Any, *settings: Any) -> Any:
    call = _Call(points, settings)
    value = points.new_empty((points.shape[0], call.check_image(image)))
    call.run("gather_points", image=image, value=value)
    return value


@torch.library.custom_op(
    "deep_contact::gather_gradient",
    mutates_args=(),
    schema=f"(Tensor image, Tensor points, Tensor values, {_COMMON}) -> Tensor",
)
def _gather_gradient(image: Any, points: Any, values: Any, *settings: Any) -> Any:
    """Derivative of ``(values * gather(image, points)).sum()`` by the points, as many numbers as they have."""
    call = _Call(points, settings)
    channels = call.check_image(image)
    if call.check_values(values) != channels:
        raise ValueError(f"values has shape {tuple(values.shape)}; it must be ({len(points)}, {channels})")
    gradient = points.new_empty((points.shape[0], 2))
    call.run("gather_gradient", image=image, value=values, gradient=gradient)
    return gradient if points.shape[1] == 2 else torch.nn.functional.pad(gradient, (0, 1))


@_splat.register_fake
def _(points: Any, values: Any, start: Any, *settings: Any) -> Any:
    check_devices(points=points, values=values)
    worlds = 1 if start is None else start.shape[0] - 1
    return values.new_empty((worlds, settings[-3] * values.shape[1], settings[1], settings[2]))


@_gather.register_fake
def _(image: Any, points: Any, *settings: Any) -> Any:
    check_devices(image=image, points=points)
    return points.new_empty((points.shape[0], image.shape[1] // settings[-3]))


@_gather_gradient.register_fake
def _(image: Any, points: Any, *rest: Any) -> Any:
    return torch.empty_like(points)


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    ctx.save_for_backward(*inputs[:4])
    ctx.scalars = inputs[4:]


# A cotangent may be expanded or transposed memory, such as that of a sum, which kernels cannot read: the only copies.


def _splat_backward(ctx: Any, cotangent: Any) -> tuple[Any, ...]:
    points, values, *rest = ctx.saved_tensors
    cotangent = cotangent.contiguous()
    settings = (*rest, *ctx.scalars)
    by_points = by_values = None
    if ctx.needs_input_grad[0]:
        by_points = torch.ops.deep_contact.gather_gradient(cotangent, points, values, *settings)
    if ctx.needs_input_grad[1]:
        by_values = torch.ops.deep_contact.gather(cotangent, points, *settings)
    return by_points, by_values, *(None,) * len(settings)


def _gather_backward(ctx: Any, cotangent: Any) -> tuple[Any, ...]:
    image, points, *rest = ctx.saved_tensors
    cotangent = cotangent.contiguous()
    settings = (*rest, *ctx.scalars)
    by_image = by_points = None
    if ctx.needs_input_grad[0]:
        by_image = torch.ops.deep_contact.splat(points, cotangent, *settings)
    if ctx.needs_input_grad[1]:
        by_points = torch.ops.deep_contact.gather_gradient(image, points, cotangent, *settings)
    return by_image, by_points, *(None,) * len(settings)


_splat.register_autograd(_splat_backward, setup_context=_setup)
_gather.register_autograd(_gather_backward, setup_context=_setup)


def _refuse_second(ctx: Any, cotangent: Any) -> Any:
    raise NotImplementedError(
        "a derivative of splat_torch or gather_torch by points cannot be differentiated again; "
        "second derivatives by values and images can: give points.detach()"
    )


_gather_gradient.register_autograd(_refuse_second)


# ------------------------------------------------------------------ calls


class _Call:
    """One call of the kernels with the points and settings of an operator, which are checked here."""

    def __init__(self, points: Any, settings: tuple[Any, ...]) -> None:
        start, point_bin, *rest, self.bins, self.threads, self.backend = settings
        self.grid, self.stencil, numbers = _settings_of(*rest)
        count = len(check_places("points", tensor_array("points", points)))
        if points.shape[1] == 3:
            points = points[:, :2]
        first, counts, most = _one_world(count) if start is None else _worlds(tensor_integers("start", start), count)
        self.dtype = str(points.dtype).removeprefix("torch.")
        self.shape, self.worlds, self.points = self.grid.shape, len(first), points
        self.point_arrays = {
            "origin": _origins(self.worlds, self.grid, points.dtype),
            "start": first,
            "count": counts,
            "place": points,
            "bin": _bins(self.bins, point_bin, count),
        }
        self.values = {
            "stencil": numbers,
            "bins": self.bins,
            "channel_offset": 0,
            "chunks": chunks_of(most),
            "points": self.point_arrays,
        }

    def check_values(self, values: Any) -> int:
        """C of values (n, C)."""
        tensor_array("values", values)
        count = self.points.shape[0]
        if values.dim() != 2 or values.shape[0] != count or values.shape[1] < 1:
            raise ValueError(f"values has shape {tuple(values.shape)}; it must be ({count}, C) with C >= 1")
        self._check_dtype("values", values)
        return values.shape[1]

    def check_image(self, image: Any) -> int:
        """C of an image (W, bins C, rows, columns)."""
        tensor_array("image", image)
        _check_shape(image, self.worlds, self.bins, self.shape)
        self._check_dtype("image", image)
        return image.shape[1] // self.bins

    def _check_dtype(self, name: str, tensor: Any) -> None:
        if tensor.dtype != self.points.dtype:
            raise ValueError(f"{name} has dtype {tensor.dtype}; points have {self.points.dtype}")

    def run(self, name: str, **tensors: Any) -> None:
        """Launch a kernel on the tensors, each thread on its share of the worlds."""
        if self.backend == "warp":
            _calls(name, self.dtype)({**self.values, **tensors}, self.worlds, self.threads)
            return
        kernel = transfer_kernels(self.backend, self.dtype)[name]
        values = {
            **self.values,
            **{key: kernel_array(tensor.detach().numpy(), self.backend) for key, tensor in tensors.items()},
            "stencil": stencil_group(self.stencil, self.grid, self.backend, self.dtype),
            "points": points_group(self.grid, self.worlds, self.backend, self.dtype, **self._arrays()),
        }
        chunks = self.values["chunks"] if "chunks" in argument_names(kernel) else 1
        bind_part(Kernel(kernel, values, chunks), 0, self.worlds, self.threads)()

    def _arrays(self) -> dict[str, np.ndarray]:
        """The points' tensors by name as numpy, the same memory, for ``points_group``."""
        return {name: tensor.detach().numpy() for name, tensor in self.point_arrays.items() if name != "origin"}

    def run_tiled(self, value: Any, image: Any) -> None:
        """Splat onto a large, zeroed image tile by tile."""
        points = points_group(self.grid, self.worlds, self.backend, self.dtype, **self._arrays())
        given = [kernel_array(tensor.detach().numpy(), self.backend) for tensor in (value, image)]
        options = {"bins": self.bins, "threads": self.threads, "backend": self.backend}
        Splat(self.stencil, self.grid, points, *given, **options)()


@functools.lru_cache(256)
def _settings_of(
    rows: int,
    columns: int,
    spacing: float,
    origin_x: float,
    origin_y: float,
    kernel: Any,
    h: float | None,
    normalize: Any,
    nearest: bool,
) -> tuple[Grid, Stencil, dict[str, Any]]:
    """The grid, the stencil, and its numbers as the kernels take them."""
    grid = Grid(rows=rows, columns=columns, spacing=spacing, origin=(origin_x, origin_y))
    stencil = Stencil(kernel, h=h, normalize=normalize, nearest=nearest)
    return grid, stencil, stencil.arguments(grid)


@functools.cache
def _calls(name: str, dtype: str) -> Calls:
    return Calls(transfer_kernels("warp", dtype)[name])


@functools.lru_cache(256)
def _one_world(count: int) -> tuple[Any, Any, int]:
    """First point, number of points and the largest of these for one world with all points."""
    return _worlds(None, count)


def _worlds(start: np.ndarray | None, count: int) -> tuple[Any, Any, int]:
    first, counts = first_and_count(check_start("start", start, count))
    return torch.from_numpy(first), torch.from_numpy(counts), int(counts.max(initial=0))


@functools.lru_cache(256)
def _origins(worlds: int, grid: Grid, dtype: Any) -> Any:
    """The grid's origin for each world, (W, 2)."""
    return torch.tensor([grid.origin], dtype=dtype).repeat(worlds, 1)


@functools.cache
def _no_bins() -> Any:
    return torch.zeros(1, dtype=torch.int32)


def _bins(bins: int, point_bin: Any, count: int) -> Any:
    if point_bin is None and bins == 1:
        return _no_bins()
    return torch.from_numpy(check_bins(bins, tensor_integers("point_bin", point_bin), count))


# ------------------------------------------------------------------ checks


def _check_shape(image: Any, worlds: int, bins: int, shape: Any) -> None:
    """Raise ValueError unless the image is (W, bins C, rows, columns)."""
    wanted = image.dim() == 4 and image.shape[0] == worlds and tuple(image.shape[2:]) == tuple(shape)
    if not wanted or image.shape[1] < bins or image.shape[1] % bins:
        rows, columns = shape
        raise ValueError(
            f"image has shape {tuple(image.shape)}; it must be ({worlds}, {bins} C, {rows}, {columns}) with C >= 1"
        )
