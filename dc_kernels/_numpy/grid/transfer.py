"""Particles to grid and back: the sums of the splat and of the gather, node by node from the formulas."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels.grid.layout import BAND, CHUNK
from dc_kernels.sph.smoothing import STENCILS, smoothing, smoothing_gradient

_NAME = {code: name for name, code in STENCILS.items()}


class Stencil(NamedTuple):
    """What a point has to do with the grid: the nodes i it reaches, S_ip and d S_ip / d x_p."""

    rows: Array
    """(k,) int."""
    columns: Array
    """(k,) int."""
    weights: Array
    """(k,) float64."""
    gradients: Array
    """(k, 2) float64 [1/m]."""
    missed: bool
    """Whether the point counts as missed: it reaches no node, was clamped onto the grid, or is not finite."""


_NOTHING = Stencil(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 2)), True)


def kernels(dtype: str) -> Kernels:
    """``splat_worlds``, ``gather_points``, ``gather_gradient`` and ``divide_image``; all sums in float64."""
    return {
        "splat_worlds": splat_worlds,
        "gather_points": gather_points,
        "gather_gradient": gather_gradient,
        "divide_image": divide_image,
    }


def axis_weights(stencil: int, u: float, nodes: int) -> tuple[Array, Array, Array, bool]:
    """Nodes, weights and d weights / d u of the 1D factor of "bilinear" or "bspline", and whether u was clamped.

    Args:
        stencil: code of "bilinear" or "bspline".
        u: coordinate in units of the spacing, node 0 at 0.
        nodes: nodes of the axis, at least 2.
    """
    clamped = not 0 <= u <= nodes - 1
    u = min(max(u, 0.0), nodes - 1.0)
    i = min(int(u), nodes - 2)
    f = u - i
    if _NAME[stencil] == "bilinear":
        index, w, dw = [i, i + 1], [1 - f, f], [-1.0, 1.0]
    else:
        index = [i - 1, i, i + 1, i + 2]
        w = [(1 - f) ** 3 / 6, (3 * f**3 - 6 * f**2 + 4) / 6, (3 * (1 - f) ** 3 - 6 * (1 - f) ** 2 + 4) / 6, f**3 / 6]
        dw = [-((1 - f) ** 2) / 2, (3 * f**2 - 4 * f) / 2, (4 * (1 - f) - 3 * (1 - f) ** 2) / 2, f**2 / 2]
    weights, slopes = np.zeros(nodes), np.zeros(nodes)
    for node, value, slope in zip(index, w, dw):
        # a ghost is the linear extrapolation of the two nodes beside it
        if node < 0:
            parts = [(0, 2.0), (1, -1.0)]
        elif node >= nodes:
            parts = [(nodes - 1, 2.0), (nodes - 2, -1.0)]
        else:
            parts = [(node, 1.0)]
        for inner, share in parts:
            weights[inner] += share * value
            slopes[inner] += share * slope
    inner = np.arange(max(index[0], 0), min(index[-1], nodes - 1) + 1)
    return inner, weights[inner], slopes[inner] * (not clamped), clamped


def stencil_weights(
    stencil: int, normalize: int, nearest: int, spacing: float, h: float, shape: tuple[int, int], offset: Array
) -> Stencil:
    """Nodes, weights and weight gradients of one point.

    Args:
        stencil: a code of ``STENCILS``.
        normalize: 0: S_ip = W(|x_p - x_i|, h); 1: S_ip = W_ip / sum_j W_jp over the nodes of the grid.
        nearest: whether a point that reaches no node goes to the nearest one with weight 1 (if normalize is 1;
            a plain sum has no weight 1, so there it is lost).
        spacing: distance of the nodes [m].
        h: support radius of a smoothing kernel [m]; the others do not use it.
        shape: (rows, columns) of the grid.
        offset: x_p - origin of the grid, (2,) [m].
    """
    if not np.isfinite(offset).all():
        return _NOTHING
    x, y = (float(value) for value in offset)
    rows, columns = shape
    if _NAME[stencil] in ("bilinear", "bspline"):
        c, wx, dx, outside_x = axis_weights(stencil, x / spacing, columns)
        r, wy, dy, outside_y = axis_weights(stencil, y / spacing, rows)
        grid_r, grid_c = np.meshgrid(r, c, indexing="ij")
        gradients = np.stack([np.outer(wy, dx), np.outer(dy, wx)], axis=-1) / spacing
        return Stencil(
            grid_r.ravel(), grid_c.ravel(), np.outer(wy, wx).ravel(), gradients.reshape(-1, 2), outside_x or outside_y
        )
    # all nodes of a box around the support; those of weight 0 drop out
    c, r = (
        np.arange(
            max(0, int(np.clip((a - h) / spacing, -1, n)) - 1), min(n, int(np.clip((a + h) / spacing, -1, n)) + 2)
        )
        for a, n in ((x, columns), (y, rows))
    )
    grid_r, grid_c = (a.ravel() for a in np.meshgrid(r, c, indexing="ij"))
    d = np.stack([x - spacing * grid_c, y - spacing * grid_r], axis=-1)
    w = smoothing(_NAME[stencil], np.hypot(d[:, 0], d[:, 1]), h)
    reached = w > 0
    grid_r, grid_c, d, w = (a[reached] for a in (grid_r, grid_c, d, w))
    gradients = smoothing_gradient(_NAME[stencil], d, h)
    total = w.sum()
    if normalize == 0 or (total == 0 and not nearest):
        return Stencil(grid_r, grid_c, w, gradients, total == 0)
    if total == 0:
        node_r = int(np.clip(np.floor(y / spacing + 0.5), 0, rows - 1))
        node_c = int(np.clip(np.floor(x / spacing + 0.5), 0, columns - 1))
        return Stencil(np.array([node_r]), np.array([node_c]), np.ones(1), np.zeros((1, 2)), True)
    share = w / total
    return Stencil(grid_r, grid_c, share, (gradients - share[:, None] * gradients.sum(0)) / total, False)


def _channels(p: int, bins: int, channel_offset: int, count: int, point_bin: Array) -> slice:
    """Channels of the values of a point."""
    first = channel_offset + (int(point_bin[p]) * count if bins > 1 else 0)
    return slice(first, first + count)


def _chunk(tid: int, world_offset: int, chunks: int, point_start: Array, point_count: Array) -> tuple[int, range]:
    """World and points of a thread of a gather."""
    w, part = world_offset + tid // chunks, tid % chunks
    start, count = int(point_start[w]), int(point_count[w])
    return w, range(start + part * CHUNK, start + min(count, (part + 1) * CHUNK))


def splat_worlds(
    tid: int,
    world_offset: int,
    stencil: int,
    normalize: int,
    nearest: int,
    spacing: Any,
    h: Any,
    bins: int,
    channel_offset: int,
    grid_origin: Array,
    point_start: Array,
    point_count: Array,
    point: Array,
    value: Array,
    point_bin: Array,
    touched: Array,
    missed: Array,
    image: Array,
) -> None:
    """image_i = sum_p S_ip value_p in one world, after the bands marked by the call before are cleared."""
    w = tid + world_offset
    shape = image.shape[2:]
    count = value.shape[1]
    mine = slice(channel_offset, channel_offset + bins * count)
    for band in np.flatnonzero(touched[w]):
        image[w, mine, band * BAND : (band + 1) * BAND] = 0
    touched[w] = 0
    missed[w] = 0
    total = np.zeros((bins * count, *shape))
    for p in range(point_start[w], point_start[w] + point_count[w]):
        offset = point[p].astype(float) - grid_origin[w]
        s = stencil_weights(stencil, normalize, nearest, float(spacing), float(h), shape, offset)
        missed[w] += s.missed
        touched[w, s.rows // BAND] = 1
        total[_channels(p, bins, 0, count, point_bin), s.rows, s.columns] += np.outer(value[p].astype(float), s.weights)
    for band in np.flatnonzero(touched[w]):
        rows = slice(band * BAND, (band + 1) * BAND)
        image[w, mine, rows] += total[:, rows].astype(image.dtype)


def gather_points(
    tid: int,
    world_offset: int,
    chunks: int,
    stencil: int,
    normalize: int,
    nearest: int,
    spacing: Any,
    h: Any,
    bins: int,
    channel_offset: int,
    grid_origin: Array,
    point_start: Array,
    point_count: Array,
    point: Array,
    point_bin: Array,
    image: Array,
    value: Array,
) -> None:
    """value_p = sum_i S_ip image_i: the transpose of the splat."""
    w, points = _chunk(tid, world_offset, chunks, point_start, point_count)
    for p in points:
        offset = point[p].astype(float) - grid_origin[w]
        s = stencil_weights(stencil, normalize, nearest, float(spacing), float(h), image.shape[2:], offset)
        channels = _channels(p, bins, channel_offset, value.shape[1], point_bin)
        value[p] = image[w][channels, s.rows, s.columns].astype(float) @ s.weights


def gather_gradient(
    tid: int,
    world_offset: int,
    chunks: int,
    stencil: int,
    normalize: int,
    nearest: int,
    spacing: Any,
    h: Any,
    bins: int,
    channel_offset: int,
    grid_origin: Array,
    point_start: Array,
    point_count: Array,
    point: Array,
    point_bin: Array,
    image: Array,
    value: Array,
    gradient: Array,
) -> None:
    """gradient_p = sum_c value_pc sum_i (d S_ip / d x_p) image_ci; 0 along a clamped coordinate."""
    w, points = _chunk(tid, world_offset, chunks, point_start, point_count)
    for p in points:
        offset = point[p].astype(float) - grid_origin[w]
        s = stencil_weights(stencil, normalize, nearest, float(spacing), float(h), image.shape[2:], offset)
        channels = _channels(p, bins, channel_offset, value.shape[1], point_bin)
        per_node = value[p].astype(float) @ image[w][channels, s.rows, s.columns].astype(float)
        gradient[p] = per_node @ s.gradients


def divide_image(tid: int, world_offset: int, weight: Array, image: Array) -> None:
    """Divide by the weight where it is > 0, else set 0: channel b C + c by the weight of bin b."""
    w = tid + world_offset
    bins = weight.shape[1]
    by = np.repeat(weight[w], image.shape[1] // bins, axis=0)
    image[w] = np.where(by > 0, image[w] / np.where(by > 0, by, 1), 0)
