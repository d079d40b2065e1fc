"""Splat: points -> grid, node by node from the formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.grid.stencil import point_channels, point_offset, stencil_weights
from dc_kernels.grid.layout import BAND


def kernels(dtype: str) -> Kernels:
    """``splat_worlds``, ``mark_bands`` and ``divide_image``; all sums in float64."""
    return {"splat_worlds": splat_worlds, "mark_bands": mark_bands, "divide_image": divide_image}


def splat_worlds(
    tid: int,
    world_offset: int,
    stencil: Any,
    bins: int,
    channel_offset: int,
    points: Any,
    value: Array,
    touched: Array,
    missed: Array,
    image: Array,
) -> None:
    """Add up image_i = sum_p S_ip value_p in one world, after the bands marked by the call before are cleared."""
    w = tid + world_offset
    shape = image.shape[2:]
    count = value.shape[1]
    mine = slice(channel_offset, channel_offset + bins * count)
    for band in np.flatnonzero(touched[w]):
        image[w, mine, band * BAND : (band + 1) * BAND] = 0
    touched[w] = 0
    missed[w] = 0
    total = np.zeros((bins * count, *shape))
    for p in range(points.start[w], points.start[w] + points.count[w]):
        s = stencil_weights(stencil, shape, point_offset(p, w, points))
        missed[w] += s.missed
        touched[w, s.rows // BAND] = 1
        total[point_channels(p, bins, 0, count, points), s.rows, s.columns] += np.outer(
            value[p].astype(float), s.weights
        )
    for band in np.flatnonzero(touched[w]):
        rows = slice(band * BAND, (band + 1) * BAND)
        image[w, mine, rows] += total[:, rows].astype(image.dtype)


def mark_bands(tid: int, world_offset: int, band: Array, touched: Array) -> None:
    """Mark bands that the next splat is to clear too."""
    touched[tid + world_offset] |= band[tid + world_offset]


def divide_image(tid: int, world_offset: int, weight: Array, image: Array) -> None:
    """Divide by the weight where it is > 0, else set 0: channel b C + c by the weight of bin b."""
    w = tid + world_offset
    bins = weight.shape[1]
    by = np.repeat(weight[w], image.shape[1] // bins, axis=0)
    image[w] = np.where(by > 0, image[w] / np.where(by > 0, by, 1), 0)
