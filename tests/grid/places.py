"""Points, values and oracles of transfers."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.model.arrays import kernel_array, kernel_vectors
from dc_kernels.runtime.backends import bind
from dc_kernels.sph.smoothing import KERNELS

SPACING = 0.25
RADIAL, SEPARABLE = tuple(KERNELS), ("bilinear", "bspline")


def cloud(grid: Grid, count: int, seed: int = 0, margin: float = 0.0, dtype: Any = np.float64) -> np.ndarray:
    """Random points, up to ``margin`` spacings outside the grid."""
    draw = np.random.default_rng(seed)
    edge = margin * grid.spacing
    return draw.uniform(np.array(grid.origin) - edge, np.array(grid.upper) + edge, (count, 2)).astype(dtype)


def border_cloud(grid: Grid, count: int, seed: int = 0, dtype: Any = np.float64) -> np.ndarray:
    """Points inside, near, on and beyond the border."""
    points = cloud(grid, count, seed, margin=3.0, dtype=dtype)
    low, high = np.array(grid.origin), np.array(grid.upper)
    points[::7] = np.clip(points[::7], low, high)  # those that were outside now lie on the border
    points[1] = low
    points[2] = high
    points[3] = low - 50 * grid.spacing
    return points


def launch(table: Any, name: str, dim: int, arrays: dict[str, Any], backend: str, **scalars: Any) -> None:
    """Bind a kernel of a backend to numpy arrays by name and run it."""
    values: dict[str, Any] = dict(scalars)
    for key, array in arrays.items():
        values[key] = kernel_vectors(array, backend) if key == "gradient" else kernel_array(array, backend)
    bind(table[name], dim, values, "cpu")()
