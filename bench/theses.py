"""The theses' transfer as a baseline: a k-d tree of the grid's nodes and a Python loop over the particles."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dc_kernels.grid import Grid
from dc_kernels.smoothing import smoothing


class ThesesTransfer:
    """Splat with weights normalised for each particle, and the reverse sum, with poly6 of support h [m]."""

    def __init__(self, grid: Grid, h: float) -> None:
        """The tree is built once: the nodes do not move."""
        self.grid, self.h = grid, h
        self.nodes = grid.nodes().reshape(-1, 2)
        self.tree = cKDTree(self.nodes)

    def weights(self, point: np.ndarray) -> tuple[list[int], np.ndarray]:
        """The nodes that a particle reaches, and its weights there."""
        reached = self.tree.query_ball_point(point, self.h)
        weight = smoothing("poly6", np.linalg.norm(self.nodes[reached] - point, axis=1), self.h)
        total = weight.sum()
        return reached, weight / total if total > 0 else weight

    def splat(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values (n, C) at points (n, 2) as an image (C, rows, columns)."""
        image = np.zeros((values.shape[1], len(self.nodes)))
        for point, value in zip(points, values, strict=True):
            reached, weight = self.weights(point)
            for channel, number in enumerate(value):
                image[channel, reached] += number * weight
        return image.reshape(-1, *self.grid.shape)

    def gather(self, image: np.ndarray, points: np.ndarray) -> np.ndarray:
        """What the nodes hold, shared among the points that reach them, (n, C)."""
        total = self.splat(points, np.ones((len(points), 1)))[0].ravel()
        flat = image.reshape(len(image), -1)
        values = np.zeros((len(points), len(image)))
        for i, point in enumerate(points):
            reached, weight = self.weights(point)
            share = np.divide(weight, total[reached], out=np.zeros_like(weight), where=total[reached] > 0)
            values[i] = flat[:, reached] @ share
        return values
