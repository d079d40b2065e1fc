"""Random places of discs that do not overlap."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

CLEARANCE = 1e-4
"""Gap between placed discs, which is still positive after rounding to float32 [diameters]."""
PLACEMENT_ATTEMPTS = 200
"""Fresh starts of a world whose random placement jammed [1]."""

Sampler = Callable[[int, int], np.ndarray]
"""A world's stream of candidates: ``sampler(first, count)`` returns the next ``count`` of them, of which the world has
seen ``first`` since its last fresh start, (count, 2) [m]."""


def _neighbour_offsets(width: int) -> list[np.ndarray]:
    """Return offsets to the 21 cells within reach, in groups to be checked in turn, the likeliest hits first."""
    near = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
    diagonal = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    far = [(x, y) for y in range(-2, 3) for x in range(-2, 3) if max(abs(x), abs(y)) == 2 and abs(x * y) < 4]
    return [np.array([y * width + x for x, y in group]) for group in (near, diagonal, far)]


def place_discs(samplers: Sequence[Sampler], count: int, distance: float, size: tuple[float, float]) -> np.ndarray:
    """Place discs by random sequential addition: a candidate is kept if it overlaps none that was kept before.

    Worlds and candidates are tested in parallel, but the result is what a loop over single candidates would give.
    Cells of side ``distance / sqrt(2)`` hold at most one disc, so a candidate looks at 21 cells.

    Args:
        samplers: stream of candidates of each world; those outside ``size`` are dropped.
        count: discs in each world.
        distance: least distance of two centres [m].
        size: width and height of the region of the centres [m], which begins at (0, 0).

    Returns:
        Centres (worlds, count, 2) [m], in the order they were placed.

    Raises:
        ValueError: when the discs do not fit.
    """
    most = 2.0 / math.sqrt(3.0) * size[0] * size[1] / distance**2 + (size[0] + size[1]) / distance + 1.0  # Groemer 1960
    full = f"bodies is {count}: so many do not fit into {size[0]:.3g} x {size[1]:.3g} m of centres"
    if count > most:
        raise ValueError(f"{full}; it must be <= {int(most)}")
    cell = distance / math.sqrt(2.0)
    width, height = int(size[0] / cell) + 5, int(size[1] / cell) + 5  # two empty cells on each side
    worlds, cells = len(samplers), width * height
    groups = _neighbour_offsets(width)
    reach = np.concatenate(groups)
    grid_x, grid_y = np.full(worlds * cells, np.inf), np.full(worlds * cells, np.inf)
    none = np.iinfo(np.int64).max
    first_here = np.full(worlds * cells, none)  # first undecided candidate of a cell

    def free(index: np.ndarray, x: np.ndarray, y: np.ndarray, home: np.ndarray) -> np.ndarray:
        """Return those of the candidates ``index`` that overlap no placed disc."""
        for group in groups:
            at = home[index, None] + group
            gap = (grid_x[at] - x[index, None]) ** 2 + (grid_y[at] - y[index, None]) ** 2
            index = index[~(gap < distance * distance).any(axis=1)]
        return index

    block = max(count, 32)
    limit = 64 * block  # candidates before a jammed world starts anew; at the thesis density about 8 are needed
    result = np.empty((worlds, count, 2))
    placed = np.zeros(worlds, np.int64)
    tried = 0
    active = np.arange(worlds)
    while len(active):
        if tried and tried % limit == 0:  # jammed: all still active worlds are, as they went through equally many
            if tried >= limit * PLACEMENT_ATTEMPTS:
                raise ValueError(full)
            for grid in (grid_x, grid_y):
                grid.reshape(worlds, cells)[active] = np.inf
            placed[active] = 0
        points = np.concatenate([samplers[w](tried % limit, block) for w in active.tolist()])
        tried += block
        x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        owner = np.repeat(active, block)
        inside = (x >= 0.0) & (x <= size[0]) & (y >= 0.0) & (y <= size[1])
        with np.errstate(invalid="ignore"):
            home = owner * cells + ((y / cell).astype(np.int64) + 2) * width + (x / cell).astype(np.int64) + 2
        home[~inside] = 0
        undecided = free(np.flatnonzero(inside), x, y, home)
        accepted = []
        while len(undecided):
            # a candidate is in when no undecided one in reach comes before it
            first_here[home[undecided[::-1]]] = undecided[::-1]
            ready = undecided[first_here[home[undecided, None] + reach].min(axis=1) == undecided]
            first_here[home[undecided]] = none
            grid_x[home[ready]], grid_y[home[ready]] = x[ready], y[ready]
            accepted.append(ready)
            undecided = free(undecided[~np.isin(undecided, ready, assume_unique=True)], x, y, home)
        index = np.sort(np.concatenate(accepted)) if accepted else np.empty(0, np.int64)
        world = owner[index]
        slot = placed[world] + np.arange(len(index)) - np.searchsorted(world, world)
        fits = slot < count
        result[world[fits], slot[fits]] = points[index[fits]]
        placed += np.bincount(world, minlength=worlds)
        active = active[placed[active] < count]
    return result
