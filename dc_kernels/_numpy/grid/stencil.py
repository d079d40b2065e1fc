"""What a point reaches on a grid and with which weights, node by node from the formulas."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels.grid.layout import CHUNK
from dc_kernels.grid.stencil import Normalize
from dc_kernels.sph.smoothing import STENCILS, smoothing, smoothing_gradient

FAR = 1e150  # [m], where a point lies that is farther: its square is a number still
_NAME = {code: name for name, code in STENCILS.items()}


class Weights(NamedTuple):
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


_NOTHING = Weights(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 2)), True)


def axis_weights(kernel: str, u: float, nodes: int) -> tuple[Array, Array, Array, bool]:
    """Nodes, weights and d weights / d u of the 1D factor of "bilinear" or "bspline", and whether u was clamped.

    Args:
        kernel: "bilinear" or "bspline".
        u: coordinate in units of the spacing, node 0 at 0.
        nodes: nodes of the axis, at least 2.
    """
    clamped = not 0 <= u <= nodes - 1
    u = min(max(u, 0.0), nodes - 1.0)
    i = min(int(u), nodes - 2)
    f = u - i
    if kernel == "bilinear":
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


def stencil_weights(stencil: Any, shape: tuple[int, int], offset: Array) -> Weights:
    """Nodes, weights and weight gradients of one point.

    Args:
        stencil: the numbers of ``grid.fields.STENCIL``.
        shape: (rows, columns) of the grid.
        offset: x_p - origin of the grid, (2,) [m].
    """
    if not np.isfinite(offset).all():
        return _NOTHING
    kernel, spacing, h = _NAME[stencil.kernel], float(stencil.spacing), float(stencil.h)
    x, y = (min(max(float(value), -FAR), FAR) for value in offset)
    rows, columns = shape
    if kernel in ("bilinear", "bspline"):
        c, wx, dx, outside_x = axis_weights(kernel, x / spacing, columns)
        r, wy, dy, outside_y = axis_weights(kernel, y / spacing, rows)
        grid_r, grid_c = np.meshgrid(r, c, indexing="ij")
        gradients = np.stack([np.outer(wy, dx), np.outer(dy, wx)], axis=-1) / spacing
        return Weights(
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
    w = smoothing(kernel, np.hypot(d[:, 0], d[:, 1]), h)
    reached = w > 0
    grid_r, grid_c, d, w = (a[reached] for a in (grid_r, grid_c, d, w))
    gradients = smoothing_gradient(kernel, d, h)
    total = w.sum()
    if stencil.normalize == Normalize.SUM or (total == 0 and not stencil.nearest):
        return Weights(grid_r, grid_c, w, gradients, total == 0)
    if total == 0:
        node_r = int(np.clip(np.floor(y / spacing + 0.5), 0, rows - 1))
        node_c = int(np.clip(np.floor(x / spacing + 0.5), 0, columns - 1))
        return Weights(np.array([node_r]), np.array([node_c]), np.ones(1), np.zeros((1, 2)), True)
    share = w / total
    return Weights(grid_r, grid_c, share, (gradients - share[:, None] * gradients.sum(0)) / total, False)


def point_channels(p: int, bins: int, channel_offset: int, count: int, points: Any) -> slice:
    """Return the channels of the values of a point."""
    first = channel_offset + (int(points.bin[p]) * count if bins > 1 else 0)
    return slice(first, first + count)


def point_offset(p: int, w: int, points: Any) -> Array:
    """Return the place of a point relative to the grid of its world, (2,) [m]."""
    return points.place[p].astype(float) - points.origin[w]


def chunk_points(tid: int, world_offset: int, chunks: int, points: Any) -> tuple[int, range]:
    """Return world and points of a thread of a gather."""
    w, part = world_offset + tid // chunks, tid % chunks
    start, count = int(points.start[w]), int(points.count[w])
    return w, range(start + part * CHUNK, start + min(count, (part + 1) * CHUNK))
