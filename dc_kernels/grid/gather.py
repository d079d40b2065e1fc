"""Gather as a stage: the kernels that bring an image back to points, bound to their arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.splat import Splat, allocate_image, chunks_of, stencil_group, transfer_kernels
from dc_kernels.grid.stencil import Stencil
from dc_kernels.model.arrays import kernel_array, to_numpy
from dc_kernels.runtime.program import Kernel, Stage


def gather_kernel(
    stencil: Stencil,
    grid: Grid,
    points: Any,
    image: Any,
    value: Any,
    *,
    bins: int = 1,
    most: int,
    backend: str = "warp",
) -> Kernel:
    """Return what gathers an image at points.

    Args:
        stencil: weights of the nodes; not normalized by "shepard".
        grid: of the image.
        points: of ``splat.points_group``.
        image: (W, bins C, rows, columns), as the kernels take it.
        value: (n, C), as the kernels take it: is written.
        bins: parts of the image that points are kept apart in.
        most: points of a world, at most.
        backend: of the arrays.
    """
    dtype, chunks = to_numpy(value).dtype.name, chunks_of(most)
    values = {
        "stencil": stencil_group(stencil, grid, backend, dtype),
        "bins": bins,
        "channel_offset": 0,
        "chunks": chunks,
        "points": points,
        "image": image,
        "value": value,
    }
    return Kernel(transfer_kernels(backend, dtype)["gather_points"], values, chunks)


def weight_stages(
    stencil: Stencil, grid: Grid, points: Any, image: Any, *, count: int, bins: int, backend: str, threads: int
) -> list[Stage]:
    """Return what divides an image by the weights that points reach its nodes with; it is 0 where they are 0.

    Args:
        stencil: weights of the nodes.
        grid: of the image.
        points: of ``splat.points_group``.
        image: (W, bins C, rows, columns), as the kernels take it: is changed.
        count: points in all.
        bins: parts of the image that points are kept apart in.
        backend: of the arrays.
        threads: that worlds are shared by.
    """
    dtype = to_numpy(image).dtype
    weight = kernel_array(allocate_image(image.shape[0], bins, grid, dtype), backend)
    ones = kernel_array(np.ones((count, 1), dtype), backend)
    splat = Splat(stencil, grid, points, ones, weight, bins=bins, backend=backend, threads=threads)
    return [splat, Kernel(splat.table["divide_image"], {"weight": weight, "image": image})]
