"""Rows of numbers that a builder collects one by one or many at once."""

from __future__ import annotations

from typing import Any

import numpy as np


class RowTable:
    """A table of float64 numbers that grows by single rows and by blocks."""

    def __init__(self, width: int) -> None:
        self.count = 0
        self._width = width
        self._rows: list[tuple[float, ...]] = []
        self._blocks: list[np.ndarray] = []

    def append(self, *row: float) -> int:
        """Add a row; returns its index."""
        self._rows.append(row)
        self.count += 1
        return self.count - 1

    def extend(self, block: np.ndarray) -> None:
        """Add rows, (n, width)."""
        self._flush()
        self._blocks.append(block)
        self.count += len(block)

    def collect(self) -> np.ndarray:
        """All rows so far, (count, width)."""
        self._flush()
        if len(self._blocks) != 1:
            self._blocks = [np.concatenate([np.empty((0, self._width)), *self._blocks])]
        return self._blocks[0]

    def row(self, index: int) -> Any:
        """One row."""
        first = self.count - len(self._rows)
        if index >= first:
            return self._rows[index - first]
        for block in reversed(self._blocks):  # what is asked for was mostly added lately
            first -= len(block)
            if index >= first:
                return block[index - first]
        raise IndexError(index)

    def _flush(self) -> None:
        if self._rows:
            self._blocks.append(np.array(self._rows, np.float64))
            self._rows = []
