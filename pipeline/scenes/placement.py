"""Random places of discs that do not overlap."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

CLEARANCE = 1e-4
"""Gap between placed discs, which is still positive after rounding to float32 [diameters]."""
PLACEMENT_ATTEMPTS = 200
"""Fresh starts of a world whose random placement jammed [1]."""

TOGETHER = 128
"""Candidates of a world that are held to each other at once [1]."""
PART = 2048
"""Candidates that are held to the discs at once, within the processor's cache [1]."""
TRIED = 64
"""Blocks of candidates before a jammed world starts anew; at the thesis density about 8 are needed [1]."""

Sampler = Callable[[int, int], np.ndarray]
"""A world's stream of candidates: ``sampler(first, count)`` returns the next ``count`` of them, of which the world has
seen ``first`` since its last fresh start, (count, 2) [m]."""


def place_discs(
    samplers: Sequence[Sampler], count: int, distance: float, size: tuple[float, float], *, ahead: int = 1
) -> np.ndarray:
    """Place discs by random sequential addition: a candidate is kept if it overlaps none that was kept before.

    Candidates of all worlds are held to the discs placed before, then those of a world to each other; the result is
    what a loop over single candidates would give.

    Args:
        samplers: stream of candidates of each world; those outside ``size`` are dropped.
        count: discs in each world.
        distance: least distance of two centres [m].
        size: width and height of the region of the centres [m], which begins at (0, 0).
        ahead: blocks of candidates that are taken together from the second draw on: few large draws are faster, but
            end with candidates that nobody needs, which are gone for whoever draws from the stream of a world later.

    Returns:
        Centres (worlds, count, 2) [m], in the order they were placed.

    Raises:
        ValueError: when the discs do not fit.
    """
    most = 2.0 / math.sqrt(3.0) * size[0] * size[1] / distance**2 + (size[0] + size[1]) / distance + 1.0  # Groemer 1960
    full = f"bodies is {count}: so many do not fit into {size[0]:.3g} x {size[1]:.3g} m of centres"
    if count > most:
        raise ValueError(f"{full}; it must be <= {int(most)}")
    cells = _Cells(len(samplers), distance, size)
    block = max(count, 32)
    centres: list[list[np.ndarray]] = [[] for _ in samplers]
    left = np.full(len(samplers), count)
    tried = 0
    while (active := np.flatnonzero(left)).size:
        if tried and tried % (TRIED * block) == 0:  # jammed: all active worlds are, as they went through equally many
            if tried >= TRIED * block * PLACEMENT_ATTEMPTS:
                raise ValueError(full)
            cells.clear(active)
            left[active] = count
            for w in active.tolist():
                centres[w] = []
        drawn = min(ahead * block if tried else block, TRIED * block - tried % (TRIED * block))
        points = [samplers[w](tried % (TRIED * block), drawn) for w in active.tolist()]
        tried += drawn
        for w, found in cells.add(active, np.concatenate(points)):
            centres[w].append(found[: left[w]])
            left[w] -= len(centres[w][-1])
    return np.array([np.concatenate(parts) for parts in centres]).view(np.float64).reshape(-1, count, 2)


class _Cells:
    """A rectangle of each world in cells that hold at most one disc each; points are complex numbers."""

    def __init__(self, worlds: int, distance: float, size: tuple[float, float]) -> None:
        """Begin with no disc.

        Args:
            worlds: their number.
            distance: of two centres, at least [m]; ``distance / sqrt(2)`` is the side of a cell.
            size: of the rectangle [m].
        """
        self.size, self.cell, self.square = size, distance / math.sqrt(2.0), distance * distance
        self.width, height = int(size[0] / self.cell) + 5, int(size[1] / self.cell) + 5  # two empty cells on each side
        self.discs = np.full((worlds, self.width * height), np.inf, np.complex128)
        self.empty = True
        near = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
        reach = [(x, y) for y in range(-2, 3) for x in range(-2, 3) if abs(x * y) < 4]
        # the 21 cells within reach, the likeliest hits first
        groups = near, [cell for cell in reach if cell not in near]
        self.groups = [np.array([y * self.width + x for x, y in group]) for group in groups]

    def clear(self, worlds: np.ndarray) -> None:
        """Take all discs out of some worlds."""
        self.discs[worlds] = np.inf

    def add(self, worlds: np.ndarray, points: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Add discs to some worlds, and go through those worlds with what was added.

        Args:
            worlds: their indices.
            points: candidates (n, 2), equally many for each world, one world after the other.
        """
        block = len(points) // len(worlds)
        inside = np.flatnonzero(((points >= 0.0) & (points <= self.size)).all(axis=1))
        points = points[inside]
        column, row = (points / self.cell).astype(np.int64).T
        home = (row + 2) * self.width + (column + 2)
        home += (worlds * self.discs.shape[1]).repeat(block)[inside]
        points = points.view(np.complex128)[:, 0]
        free = np.arange(len(home))
        if not self.empty:
            parts = [self._free(points, home, free[n : n + PART]) for n in range(0, len(free), PART)]
            free = np.concatenate(parts) if parts else free
        self.empty = False
        ends = inside[free].searchsorted(np.arange(0, block * len(worlds) + 1, block)).tolist()
        for w, (first, last) in zip(worlds.tolist(), itertools.pairwise(ends)):
            for start in range(first, last, TOGETHER):
                index = free[start : min(start + TOGETHER, last)]
                if start > first:
                    index = self._free(points, home, index)
                index = index[self._choose(points[index])]
                self.discs.reshape(-1)[home[index]] = points[index]
                yield w, points[index]

    def _free(self, points: np.ndarray, home: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return those of the candidates ``index`` that overlap no disc."""
        for group in self.groups:
            discs = self.discs.reshape(-1).take(home[index, None] + group)
            index = index[~self._near(discs, points[index, None]).any(axis=1)]
        return index

    def _choose(self, points: np.ndarray) -> list[int]:
        """Return the indices of those that overlap none that is returned before."""
        first, second = np.divmod(self._near(points, points[:, None]).reshape(-1).nonzero()[0], len(points))
        later = first < second
        chosen = dict.fromkeys(range(len(points)))
        for i, j in zip(first[later].tolist(), second[later].tolist()):  # all that speaks against i came before
            if i in chosen:
                chosen.pop(j, None)
        return list(chosen)

    def _near(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Tell which points are too near to each other, in any shape that broadcasts."""
        gap, other = a.real - b.real, a.imag - b.imag
        gap *= gap
        other *= other
        gap += other
        return gap < self.square
