"""The grid that bodies and contacts are splatted onto, and its choice for a scene (seed, section 3.2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Nodes of a regular grid, the same in every world: node (row r, column c) lies at origin + spacing (c, r).

    An image on it is an array (worlds, channels, rows, columns), the layout a CNN wants; row 0 is the lowest.
    """

    rows: int
    """Nodes along y [1]."""
    columns: int
    """Nodes along x [1]."""
    spacing: float
    """Distance of neighbouring nodes [m]."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Place of node (0, 0), relative to each world's origin [m]."""

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or not 2 <= value < 2**24:
                raise ValueError(f"Grid.{name} is {value!r}; it must be an integer in [2, 2^24)")
        if not (0.0 < self.spacing < float("inf")):
            raise ValueError(f"Grid.spacing is {self.spacing!r}; it must be finite and > 0 [m]")
        origin = np.asarray(self.origin, float)
        if origin.shape != (2,):
            raise ValueError(f"Grid.origin has shape {origin.shape}; it must be (2,)")
        if not np.isfinite(origin).all():
            raise ValueError(f"Grid.origin is {self.origin}; it must be finite [m]")

    @classmethod
    def from_box(cls, lower: Any, upper: Any, spacing: float) -> Grid:
        """The grid from corner to corner, both ends included; the upper one is moved out to a whole number of cells.

        Args:
            lower: low corner (x, y) [m].
            upper: high corner (x, y) [m].
            spacing: distance of the nodes [m].

        Raises:
            ValueError: for a box without area, or a spacing out of range.
        """
        low, high = np.asarray(lower, float), np.asarray(upper, float)
        if low.shape != (2,) or high.shape != (2,) or not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError(f"box is {lower} to {upper}; both corners must be two finite numbers [m]")
        if not (high > low).all():
            raise ValueError(f"box is {lower} to {upper}; the upper corner must lie above and to the right [m]")
        if not (0.0 < spacing < float("inf")):
            raise ValueError(f"Grid.spacing is {spacing!r}; it must be finite and > 0 [m]")
        # 1e-9: a side of 60 cells must not become 61 by round-off
        cells = np.maximum(np.ceil((high - low) / spacing - 1e-9), 1)
        if not (cells < 2**24 - 1).all():
            raise ValueError(f"box of {high - low} m has {cells} cells of {spacing} m; a side may have 2^24 - 2")
        return cls(
            rows=int(cells[1]) + 1,
            columns=int(cells[0]) + 1,
            spacing=float(spacing),
            origin=(float(low[0]), float(low[1])),
        )

    @classmethod
    def thesis(cls) -> Grid:
        """The theses' grid: 61 x 61 nodes, 0.25 m apart, over their box of 15 m."""
        return cls(rows=61, columns=61, spacing=0.25)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns

    @property
    def upper(self) -> tuple[float, float]:
        """Place of the last node [m]."""
        return (
            self.origin[0] + self.spacing * (self.columns - 1),
            self.origin[1] + self.spacing * (self.rows - 1),
        )

    def nodes(self) -> np.ndarray:
        """Places of all nodes, (rows, columns, 2) [m]."""
        x = self.origin[0] + self.spacing * np.arange(self.columns)
        y = self.origin[1] + self.spacing * np.arange(self.rows)
        return np.stack(np.meshgrid(x, y), axis=-1)
