"""Gather: grid -> points, and its derivative by the points' places, node by node from the formulas."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.grid.stencil import chunk_points, point_channels, point_offset, stencil_weights


def kernels(dtype: str) -> Kernels:
    """``gather_points`` and ``gather_gradient``; all sums in float64."""
    return {"gather_points": gather_points, "gather_gradient": gather_gradient}


def gather_points(
    tid: int,
    world_offset: int,
    chunks: int,
    stencil: Any,
    bins: int,
    channel_offset: int,
    points: Any,
    image: Array,
    value: Array,
) -> None:
    """Add up value_p = sum_i S_ip image_i: the transpose of the splat."""
    w, own = chunk_points(tid, world_offset, chunks, points)
    for p in own:
        s = stencil_weights(stencil, image.shape[2:], point_offset(p, w, points))
        channels = point_channels(p, bins, channel_offset, value.shape[1], points)
        value[p] = image[w][channels, s.rows, s.columns].astype(float) @ s.weights


def gather_gradient(
    tid: int,
    world_offset: int,
    chunks: int,
    stencil: Any,
    bins: int,
    channel_offset: int,
    points: Any,
    image: Array,
    value: Array,
    gradient: Array,
) -> None:
    """Add up gradient_p = sum_c value_pc sum_i (d S_ip / d x_p) image_ci; it is 0 along a clamped coordinate."""
    w, own = chunk_points(tid, world_offset, chunks, points)
    for p in own:
        s = stencil_weights(stencil, image.shape[2:], point_offset(p, w, points))
        channels = point_channels(p, bins, channel_offset, value.shape[1], points)
        per_node = value[p].astype(float) @ image[w][channels, s.rows, s.columns].astype(float)
        gradient[p] = per_node @ s.gradients
