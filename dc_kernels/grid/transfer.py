"""Splat and gather: values at points to images on a grid, and back (``stencil`` describes the weights)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.grid.gather import gather_kernel, weight_stages
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.splat import Splat, allocate_image, first_and_count, points_group
from dc_kernels.grid.stencil import BILINEAR, POLY6, Stencil, check_place
from dc_kernels.model.arrays import kernel_array
from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.backends import Launch, check_backend
from dc_kernels.runtime.capture import clear, recording
from dc_kernels.runtime.inputs import (
    check_array,
    check_bins,
    check_count,
    check_layout,
    check_places,
    check_start,
    check_truth,
    refuse_overlap,
)
from dc_kernels.runtime.interop import host_view
from dc_kernels.runtime.program import Program, Stage
from dc_kernels.runtime.threads import slices_of


class Transfer:
    """Splats and gathers on one grid with one stencil, whose settings are checked once.

    ``splat`` and ``gather`` take points and values with each call. ``at`` binds points: a bound splat or gather then
    takes microseconds.
    """

    def __init__(
        self,
        grid: Grid,
        stencil: Stencil = POLY6,
        *,
        bins: int = 1,
        threads: int = 1,
        backend: str = "warp",
    ) -> None:
        """Check the settings.

        Args:
            grid: grid of the nodes, relative to each world's origin.
            stencil: weights of the nodes.
            bins: number of bins that separate points, such as directions of contact normals.
            threads: number of threads that share worlds, or tiles of a large image; the bits do not depend on it.
            backend: "warp", "taichi", or "numpy", the oracle.

        Raises:
            ValueError: a setting, which the error names, is out of range.
        """
        self.grid, self.stencil = check_place(grid, stencil)
        stencil.support(grid.spacing)
        self.bins, self.threads = check_count("bins", bins), check_count("threads", threads)
        self.backend = check_backend(backend)

    def at(self, points: Any, *, start: Any = None, point_bin: Any = None) -> PointTransfer:
        """Bind points; arguments as of ``splat``."""
        return PointTransfer(self, points, start, point_bin)

    def splat(
        self, points: Any, values: Any, *, start: Any = None, point_bin: Any = None, out: Any = None
    ) -> np.ndarray:
        """Return values at points as an image; arguments, result and errors as of the function ``splat``."""
        bound = self.at(points, start=start, point_bin=point_bin)
        values = bound.check_values(values)
        shape = bound.image_shape(values.shape[1])
        if out is None:
            out = allocate_image(shape[0], shape[1], self.grid, bound.points.dtype)
        else:
            out = check_layout("out", out, shape, bound.points.dtype, writes=True)
            refuse_overlap({"out": out}, {"points": bound.points, "values": values})
            clear(kernel_array(out, self.backend))
        bound.bind_splat(values, out)()  # what is checked already is not looked at again
        return out

    def gather(
        self,
        image: Any,
        points: Any,
        *,
        reverse: bool = False,
        start: Any = None,
        point_bin: Any = None,
        out: Any = None,
    ) -> np.ndarray:
        """Return an image at points; arguments, result and errors as of the function ``gather``."""
        self.stencil.check_gather(check_truth("reverse", reverse))
        bound = self.at(points, start=start, point_bin=point_bin)
        image = host_view("image", image)
        if not isinstance(image, np.ndarray) or image.ndim != 4:
            found = f"has shape {image.shape}" if isinstance(image, np.ndarray) else f"is {shown(image)}"
            raise WrongType(f"image {found}; it must be (W, bins C, rows, columns)")
        channels = max(image.shape[1] // self.bins, 1)
        check_array("image", image, bound.image_shape(channels), bound.points.dtype)
        if out is None:
            out = np.zeros((len(bound.points), channels), bound.points.dtype)
        else:
            out = check_layout("out", out, (len(bound.points), channels), bound.points.dtype, writes=True)
            refuse_overlap({"out": out}, {"points": bound.points, "image": image})
        bound.bind_gather(image, out, reverse)()
        return out


class PointTransfer:
    """Points on a grid, checked once, whose splats and gathers are bound to arrays.

    The points may move between calls, and values may change in place; they are not checked again, and a
    point that is not finite contributes nothing.
    """

    def __init__(self, transfer: Transfer, points: Any, start: Any, point_bin: Any) -> None:
        """Check the points (see ``Transfer.at``)."""
        self.transfer = transfer
        self.points = check_places("points", points)
        first, count = first_and_count(check_start("start", start, len(self.points)))
        self.worlds, self.most = len(first), int(count.max(initial=0))
        self._first, self._count = first, count
        self._bins = check_bins(transfer.bins, point_bin, len(self.points))
        self._group = self._points(first, count)

    def _points(self, first: np.ndarray, count: np.ndarray) -> Any:
        """Return so many points of each world from a first one on as the kernels take them."""
        t = self.transfer
        where = {"start": first, "count": count, "place": self.points, "bin": self._bins}
        return points_group(t.grid, self.worlds, t.backend, self.points.dtype.name, **where)

    def image_shape(self, channels: int) -> tuple[int, ...]:
        """Return the shape of an image of so many channels a bin."""
        return (self.worlds, self.transfer.bins * channels, *self.transfer.grid.shape)

    def check_values(self, values: Any) -> np.ndarray:
        """Return values (n, C) of the points as numpy.

        Raises:
            ValueError: for another shape, dtype or memory layout, or the first that is not finite.
        """
        values = check_array("values", values, (len(self.points), None), self.points.dtype)
        if values.shape[1] < 1:
            raise ValueError(f"values has shape {values.shape}; it must have a channel")
        return values

    def splat(self, values: Any, image: Any) -> Launch:
        """Return what splats ``values`` (n, C) onto ``image`` (W, bins C, rows, columns), which is zero at first.

        Raises:
            ValueError: for arrays of another shape, dtype or memory layout.
        """
        values = self.check_values(values)
        shape = self.image_shape(values.shape[1])
        image = check_layout("image", image, shape, self.points.dtype, writes=True)
        refuse_overlap({"image": image}, {"points": self.points, "values": values})
        return self.bind_splat(values, image)

    def gather(self, image: Any, values: Any, *, reverse: bool = False) -> Launch:
        """Return what gathers ``image`` at the points into ``values`` (n, C).

        Raises:
            ValueError: for arrays of another shape, dtype or memory layout, or a stencil that no gather has.
        """
        self.transfer.stencil.check_gather(check_truth("reverse", reverse))
        values = check_layout("values", values, (len(self.points), None), self.points.dtype, writes=True)
        image = check_array("image", image, self.image_shape(values.shape[1]), self.points.dtype)
        refuse_overlap({"values": values}, {"points": self.points, "image": image})
        return self.bind_gather(image, values, reverse)

    def bind_splat(self, values: np.ndarray, image: np.ndarray) -> Launch:
        """Bind a splat to arrays that are checked."""
        t = self.transfer
        arrays = kernel_array(values, t.backend), kernel_array(image, t.backend)
        splat = Splat(t.stencil, t.grid, self._group, *arrays, bins=t.bins, backend=t.backend, threads=t.threads)
        if t.stencil.normalize != "shepard":
            return splat
        return self._program([splat, *self._weights(arrays[1])])

    def bind_gather(self, image: np.ndarray, values: np.ndarray, reverse: bool) -> Launch:
        """Bind a gather to arrays that are checked."""
        t = self.transfer
        stages: list[Stage] = []
        source = kernel_array(image, t.backend)
        if reverse:
            # a copy, as what the caller's image holds is not ours to change
            shared = np.empty_like(image)
            source = kernel_array(shared, t.backend)
            stages = [lambda: np.copyto(shared, image), *self._weights(source)]
        value = kernel_array(values, t.backend)
        # points that take long are gathered part by part: an interrupt arrives between two
        parts = 1 if recording() else slices_of(values.size * t.stencil.nodes(t.grid.spacing))
        most = -(-self.most // parts)
        for part in range(parts):
            group = self._group
            if parts > 1:
                count = np.clip(self._count - part * most, 0, most)
                group = self._points(self._first + np.minimum(part * most, self._count), count)
            bound = {"bins": t.bins, "most": most, "backend": t.backend}
            stages.append(gather_kernel(t.stencil, t.grid, group, source, value, **bound))
        return self._program(stages, apart=parts > 1)

    def _weights(self, image: Any) -> list[Stage]:
        t = self.transfer
        return weight_stages(
            t.stencil,
            t.grid,
            self._group,
            image,
            count=len(self.points),
            bins=t.bins,
            backend=t.backend,
            threads=t.threads,
        )

    def _program(self, stages: list[Stage], *, apart: bool = False) -> Program:
        t = self.transfer
        return Program(stages, self.worlds, backend=t.backend, threads=t.threads, apart=apart)


def splat(
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
    out: Any = None,
) -> np.ndarray:
    """Splat values at points, and return the image.

    Args:
        points: positions relative to the worlds' origins, (n, 2), or (n, 3) with z ignored, float32 or float64
            [m]; like all arrays numpy, ``wp.array`` or a torch tensor on the CPU, contiguous, read in place.
        values: (n, C), of the same dtype.
        grid: grid of the nodes.
        stencil: weights of the nodes: kernel, support radius, normalization.
        start: offsets of the worlds' points, (W + 1,); None: one world.
        bins: number of bins that separate points, such as directions of contact normals.
        point_bin: bin of each point, (n,); needed for bins > 1.
        threads: number of threads that share worlds, or tiles of a large image; the bits do not depend on it.
        backend: "warp", "taichi", or "numpy", the oracle.
        out: image to write instead of a new one; all of it is overwritten.

    Returns:
        (W, bins C, rows, columns); value c of a point of bin b is in channel b C + c.

    Raises:
        ValueError: an input is not as described; the error names field, index and limit.
    """
    transfer = Transfer(grid, stencil, bins=bins, threads=threads, backend=backend)
    return transfer.splat(points, values, start=start, point_bin=point_bin, out=out)


def gather(
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
    out: Any = None,
) -> np.ndarray:
    """Gather the values of an image at points: the transpose of ``splat`` with the same stencil.

    Args:
        image: (W, bins C, rows, columns), of the points' dtype.
        points: see ``splat``.
        grid: grid of the nodes.
        stencil: weights of the nodes; not normalized by "shepard".
        reverse: whether to divide the value of a node among the points that reach it, in proportion to their weights
            (reverse SPH, Engedal 2018): this preserves the sum over the touched nodes, and points whose supports do
            not overlap get back exactly their splatted values. It needs normalize "particle".
        start: see ``splat``.
        bins: see ``splat``.
        point_bin: see ``splat``.
        threads: see ``splat``.
        backend: see ``splat``.
        out: array to write instead of a new one.

    Returns:
        (n, C).

    Raises:
        ValueError: an input is not as described; the error names field, index and limit.
    """
    transfer = Transfer(grid, stencil, bins=bins, threads=threads, backend=backend)
    return transfer.gather(image, points, reverse=reverse, start=start, point_bin=point_bin, out=out)
