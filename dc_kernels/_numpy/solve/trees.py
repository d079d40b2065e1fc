"""The direct solve of joints whose bodies form trees, as one dense system of all their rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels._numpy.solve.row import Row, by_lane, read_row
from dc_kernels.solve.rows import LANES

LEAST = 1e-9  # of the largest singular value: a row that others hold already


class Tree:
    """The rows of a tree, and J M^-1 J^T of them.

    Attributes:
        rows: those that the tree holds, without those along which nothing can move, or that ``places`` leave alone.
    """

    def __init__(self, tree: int, variant: str, rows: Any, bodies: Array, places: bool = False) -> None:
        own = range(rows.tree_first[tree], rows.tree_first[tree + 1])
        at = [rows.row_slot[rows.tree_row[t] + i] for t in own for i in range(rows.tree_size[t])]
        read = (read_row(variant, k // (2 * LANES), k % (2 * LANES), rows, bodies) for k in at)
        found = [row for row in read if row is not None and row.effective_mass[0] > 0]
        self.rows: list[Row] = [row for row in found if row.held or not places]
        size = len(self.rows)
        matrix = np.zeros((size, size))
        for i, row in enumerate(self.rows):
            moved = np.zeros((len(bodies), 3))
            for body, part in ((row.a, slice(0, 3)), (row.b, slice(3, 6))):
                moved[body] += row.response[0, part]
            matrix[i] = [np.concatenate([moved[one.a], moved[one.b]]) @ one.jacobian[0] for one in self.rows]
            matrix[i, i] += row.softness
        self._inverse = np.linalg.pinv((matrix + matrix.T) / 2, rcond=LEAST, hermitian=True)

    def lacks(self, still: Any, rows: Any) -> bool:
        """Whether a row lacked more of its speed as the last sweep came to it."""
        change = by_lane(rows.change)
        return any(not abs(change[row.at][0]) <= still * row.effective_mass[0] for row in self.rows)

    def solve(self, rows: Any, bodies: Array) -> None:
        """The impulses that make all rows hold at once, and the velocities with them."""
        if not self.rows:
            return
        impulse, change = by_lane(rows.impulse), by_lane(rows.change)
        now = [row.jacobian[0] @ row.velocity(bodies) + row.bias for row in self.rows]
        now = [v + row.softness * impulse[row.at][0] for v, row in zip(now, self.rows, strict=True)]
        for row, step in zip(self.rows, -self._inverse @ np.array(now, np.float64), strict=True):
            impulse[row.at][0] += step
            change[row.at][0] += step
            row.change(bodies, np.array([step, 0.0], bodies.dtype))

    def push(self, bodies: Array, share: Any, limit: Any) -> None:
        """The displacements that remove a share of what the rows have drifted by."""
        if not self.rows:
            return
        off = np.array([row.jacobian[0] @ row.velocity(bodies) + row.gap for row in self.rows], np.float64)
        for row, step in zip(self.rows, -self._inverse @ np.clip(share * off, -limit, limit), strict=True):
            row.change(bodies, np.array([step, 0.0], bodies.dtype))
