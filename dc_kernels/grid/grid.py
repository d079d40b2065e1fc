"""The grid that bodies and contacts are splatted onto, and its choice for a scene (Wu 2018, section 3.2.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from dc_kernels.model.settings import MAX_INT, Limits, Positive, Settings, checker
from dc_kernels.model.shapes import points as check_points
from dc_kernels.runtime.inputs import check_start
from dc_kernels.runtime.interop import host_view

Nodes = Annotated[int, Limits(least=2, below=2**24)]
"""Nodes along a side: kernels find them in float32, which counts so far."""
_positive = checker(Positive)
_most_nodes = checker(Annotated[int, Limits(least=4, most=MAX_INT)])
_corner = checker(tuple[float, float])


@dataclass(frozen=True, kw_only=True)
class Grid(Settings):
    """Nodes of a regular grid, the same in every world: node (row r, column c) lies at origin + spacing (c, r).

    An image on it is an array (worlds, channels, rows, columns), the layout a CNN wants; row 0 is the lowest.
    """

    settings_prefix: ClassVar[str] = "Grid."

    rows: Nodes
    """Nodes along y [1]."""
    columns: Nodes
    """Nodes along x [1]."""
    spacing: Positive
    """Distance of neighbouring nodes [m]."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Place of node (0, 0), relative to each world's origin [m]."""

    @classmethod
    def from_box(cls, lower: Any, upper: Any, spacing: float) -> Grid:
        """Return the grid between two corners, both included; the upper one is moved out to a whole number of cells.

        Args:
            lower: low corner (x, y) [m].
            upper: high corner (x, y) [m].
            spacing: distance of the nodes [m].

        Raises:
            ValueError: for a box without area, or a spacing out of range.
        """
        sides = _sides(lower, upper)
        spacing = _positive("spacing", spacing)
        cells = _cells(sides, spacing)
        if not (cells < 2**24 - 1).all():
            raise ValueError(f"box of {sides} m has {cells} cells of {spacing} m; a side may have 2^24 - 2")
        return cls(
            rows=int(cells[1]) + 1,
            columns=int(cells[0]) + 1,
            spacing=float(spacing),
            origin=(float(lower[0]), float(lower[1])),
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


_grid = checker(Grid)
REACH = 0.9
"""Distance from a point to its nearest node, at most, over the support radius that ``choose_grid`` picks: below 1, so
that the nearest node's weight is not lost in round-off."""


@dataclass(frozen=True, kw_only=True)
class GridChoice:
    """A grid and a support radius for the points of a scene, with their properties (see ``choose_grid``)."""

    grid: Grid
    h: float
    """Support radius [m]."""
    closest: float
    """Smallest distance of two points of the same world [m]; inf if no world has two."""
    shared: np.ndarray
    """Number of points of each world that share their cell with another one, (W,), counted on the grid."""
    exact: bool
    """Whether each point reaches a node and no two supports overlap: then reverse SPH returns the splatted values."""

    def __str__(self) -> str:
        grid, worlds = self.grid, int((self.shared > 0).sum())
        found = f"{grid.rows} x {grid.columns} nodes, spacing {grid.spacing:.4g} m, h {self.h:.4g} m: "
        if self.exact:
            return found + "no two points share a cell, no two supports overlap"
        if worlds:
            found += f"{int(self.shared.sum())} points in {worlds} of {len(self.shared)} worlds share a cell"
        else:
            found += "no two points share a cell"
        return found + f", supports overlap (closest two points {self.closest:.4g} m apart)"


def choose_grid(
    points: Any,
    *,
    lower: Any,
    upper: Any,
    start: Any = None,
    max_nodes: int = 65_536,
    max_spacing: float | None = None,
) -> GridChoice:
    """Choose spacing and support radius such that no two points share a cell (Wu 2018, section 3.2.3).

    A node's cell is the square of side ``spacing`` around it. It cannot hold two points farther apart than its
    diagonal, spacing sqrt(2). A stronger condition is imposed: spacing / sqrt(2) < h <= d / 2, where d is the smallest
    distance of two points of a world. By the left inequality each point has a node inside its support, as the nearest
    one is at most spacing / sqrt(2) away; by the right one no node lies in the supports of two points. A node then has
    the value of one point only, and reverse SPH, which divides a node's value in proportion to the weights, returns
    to each point its value: the round trip is exact to round-off. No cell is shared then, as spacing < d / sqrt(2).

    The choice is the coarsest grid of that kind: h = d / 2 and spacing = 0.9 sqrt(2) h, 0.636 d. Contacts of
    equal discs of radius r that do not overlap are at least r apart (the theses': h = 0.25 m, spacing 0.32 m).
    If this needs more than ``max_nodes``, or two points coincide, the grid is the finest within the limit and h
    the smallest with which each point reaches a node; ``shared`` then counts the points that share a cell of that grid.

    Args:
        points: (n, 2) [m], contact points of all worlds, one world after the other.
        lower: low corner (x, y) of the region that the grid covers [m].
        upper: high corner (x, y) [m].
        start: (W + 1) offsets of the worlds in ``points``; None: one world.
        max_nodes: largest number of nodes of the grid, at least 4 [1].
        max_spacing: largest spacing [m], used if no world has two points; None: the shorter side of the region.

    Raises:
        ValueError: points are not finite, offsets out of order, the region has no area, or a limit is out of range.
    """
    points, start = _worlds_of(points, start)
    sides = _sides(lower, upper)
    max_nodes = _most_nodes("max_nodes", max_nodes)
    max_spacing = float(sides.min()) if max_spacing is None else _positive("max_spacing", max_spacing)
    closest = closest_pair(points, start)
    wanted = min(REACH * closest / np.sqrt(2.0), max_spacing)
    finest = _finest(sides, int(max_nodes))
    fits = finest <= wanted
    spacing = wanted if fits else finest
    grid = Grid.from_box(lower, upper, spacing)
    h = float(min(closest / 2.0, 2.0 * spacing) if fits else spacing / (REACH * np.sqrt(2.0)))
    away = points - grid.origin - grid.spacing * _nearest(points, grid)
    reached = bool((np.hypot(*away.T) < h).all())  # not where a point lies outside the region
    return GridChoice(grid=grid, h=h, closest=closest, shared=shared_cells(points, grid, start), exact=fits and reached)


def shared_cells(points: Any, grid: Grid, start: Any = None) -> np.ndarray:
    """Return the number of points of each world that share a cell of the grid with another one, (W,).

    A node's cell is the square of side ``spacing`` around it; a point outside the grid counts for its nearest node.

    Args:
        points: (n, 2) [m].
        grid: the grid.
        start: (W + 1) offsets of the worlds in ``points``; None: one world.

    Raises:
        ValueError: for points that are not finite, or offsets out of order.
    """
    _grid("grid", grid)
    points, start = _worlds_of(points, start)
    place = _nearest(points, grid)
    world = np.repeat(np.arange(len(start) - 1), np.diff(start))
    cell = (world * grid.rows + place[:, 1]) * grid.columns + place[:, 0]
    _, inverse, count = np.unique(cell, return_inverse=True, return_counts=True)
    return np.bincount(world[count[inverse] > 1], minlength=len(start) - 1)


def closest_pair(points: Any, start: Any = None) -> float:
    """Least distance of two points of the same world [m], inf where no world has two; arguments as ``shared_cells``.

    A sweep over the points sorted along an oblique line, which columns and rows of points cannot be perpendicular to.
    """
    points, start = _worlds_of(points, start)
    world = np.repeat(np.arange(len(start) - 1), np.diff(start))
    along = points @ (np.cos(0.4), np.sin(0.4))
    order = np.lexsort((along, world))
    points, world, along = points[order], world[order], along[order]
    best = np.inf
    first = np.arange(len(points))
    for step in range(1, len(points)):
        first = first[first + step < len(points)]
        second = first + step
        near = (world[second] == world[first]) & (along[second] - along[first] < best)
        first, second = first[near], second[near]
        if not len(first):
            break
        best = min(best, float(np.hypot(*(points[second] - points[first]).T).min()))
    return best


def _nearest(points: np.ndarray, grid: Grid) -> np.ndarray:
    """Column and row of the node nearest to each point, (n, 2)."""
    place = np.floor((points - grid.origin) / grid.spacing + 0.5)
    return np.clip(place, 0, (grid.columns - 1, grid.rows - 1)).astype(np.int64)


def _cells(sides: np.ndarray, spacing: float) -> np.ndarray:
    """Cells along each side of a box, in floating point; 1e-9: a side of 60 cells must not become 61 by round-off."""
    return np.maximum(np.ceil(sides / spacing - 1e-9), 1)


def _finest(sides: np.ndarray, max_nodes: int) -> float:
    """The least spacing with which a box has at most so many nodes, by bisection."""
    low, high = 0.0, float(sides.max())
    while low < (middle := 0.5 * (low + high)) < high:
        if np.prod(_cells(sides, middle) + 1) <= max_nodes:
            high = middle
        else:
            low = middle
    return high


def _sides(lower: Any, upper: Any) -> np.ndarray:
    """Width and height of a box.

    Raises:
        ValueError: for corners that are not finite, or a box without area.
    """
    low, high = (np.array(_corner(name, corner)) for name, corner in (("lower", lower), ("upper", upper)))
    if not (high > low).all():
        raise ValueError(f"upper is {high.tolist()}; it must lie above and to the right of lower, {low.tolist()} [m]")
    return high - low


def _worlds_of(points: Any, start: Any) -> tuple[np.ndarray, np.ndarray]:
    """Checked points in float64, and the offsets of their worlds."""
    points = check_points(host_view("points", points), "points", 0)
    return points, check_start("start", start, len(points))
