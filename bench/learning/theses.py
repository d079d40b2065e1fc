"""Splat and gather as the theses had them: k-d trees of scipy and Python loops.

``SeedTransfer`` is the way that Wu (2018) describes. ``ThesesTransfer`` is the best that can be made of it: a tree of
the nodes, built once and asked for all particles at a time, numpy over a particle's nodes and channels, and reverse SPH
(Engedal 2018) for the way back. Arithmetic is in float64; the kernel is poly6 with weights of one particle that sum to
1. The theses share a node's content in proportion to the weights before they are normalised, here it is the normalised
ones, as in ``dc_kernels.grid.transfer``; the losses of a round trip differ by 2 % of themselves.
"""

from __future__ import annotations

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.runtime.imports import require


class ThesesTransfer:
    """The nodes of a grid in a k-d tree."""

    def __init__(self, grid: Grid, h: float) -> None:
        """Build the tree; h is the support radius [m]."""
        self.grid, self.h = grid, h
        self.nodes = grid.nodes().reshape(-1, 2)
        self.tree = require("scipy.spatial", "bench").cKDTree(self.nodes)

    def weights(self, points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Nodes within h of each point (n, 2), and their weights, which sum to 1; none where there is no node."""
        found = []
        for point, near in zip(points, self.tree.query_ball_point(points, self.h), strict=True):
            nodes = np.array(near, np.int64)
            offset = self.nodes[nodes] - point
            weight = np.maximum(self.h**2 - (offset * offset).sum(axis=1), 0.0) ** 3
            total = weight.sum()
            found.append((nodes, weight / total) if total > 0.0 else (nodes[:0], weight[:0]))
        return found

    def splat(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values (n, C) at points (n, 2) as an image (C, rows, columns)."""
        image = np.zeros((values.shape[1], len(self.nodes)))
        for (nodes, weight), value in zip(self.weights(points), values, strict=True):
            image[:, nodes] += value[:, None] * weight
        return image.reshape(-1, *self.grid.shape)

    def gather(self, image: np.ndarray, points: np.ndarray) -> np.ndarray:
        """An image (C, rows, columns) back at points (n, 2) by reverse SPH: (n, C).

        Each node's content is shared among the points that reach it in proportion to their weights.
        """
        pairs = self.weights(points)
        total = np.zeros(len(self.nodes))
        for nodes, weight in pairs:
            total[nodes] += weight
        share = image.reshape(len(image), -1) / np.where(total > 0.0, total, 1.0)
        values = np.zeros((len(points), len(image)))
        for i, (nodes, weight) in enumerate(pairs):
            values[i] = share[:, nodes] @ weight
        return values


class SeedTransfer:
    """The way of Wu (2018), sections 3.2 and 3.3: a k-d tree of the particles, asked at each node; bilinear back."""

    def __init__(self, grid: Grid, h: float) -> None:
        """Support radius h [m]."""
        self.grid, self.h = grid, h
        self.nodes = grid.nodes().reshape(-1, 2).tolist()

    def splat(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """See ``ThesesTransfer.splat``; the particles move, so their tree is built anew."""
        tree = require("scipy.spatial", "bench").cKDTree(points)
        places, rows = points.tolist(), values.tolist()
        total = [0.0] * len(places)
        pairs = []
        for node, (x, y) in enumerate(self.nodes):
            for i in tree.query_ball_point((x, y), self.h):
                weight = (self.h**2 - (x - places[i][0]) ** 2 - (y - places[i][1]) ** 2) ** 3
                total[i] += weight
                pairs.append((node, i, weight))
        image = np.zeros((values.shape[1], len(self.nodes)))
        for node, i, weight in pairs:
            for channel, number in enumerate(rows[i]):
                image[channel, node] += number * weight / total[i]
        return image.reshape(-1, *self.grid.shape)

    def gather(self, image: np.ndarray, points: np.ndarray) -> np.ndarray:
        """An image (C, rows, columns) at points (n, 2) by bilinear interpolation (eq. 3.17), (n, C)."""
        values = np.zeros((len(points), len(image)))
        for value, (x, y) in zip(values, points.tolist(), strict=True):
            u, v = (x - self.grid.origin[0]) / self.grid.spacing, (y - self.grid.origin[1]) / self.grid.spacing
            c, r = min(int(u), self.grid.columns - 2), min(int(v), self.grid.rows - 2)
            u, v = u - c, v - r
            for channel, field in enumerate(image):
                low = (1 - u) * field[r, c] + u * field[r, c + 1]
                value[channel] = (1 - v) * low + v * ((1 - u) * field[r + 1, c] + u * field[r + 1, c + 1])
        return values
