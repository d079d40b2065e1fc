"""Numbers that a builder collects one by one or many at once: rows of a table, and what few of its rows have."""

from __future__ import annotations

from collections.abc import Mapping
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


class Traits:
    """Columns of numbers that few rows have: what is not given takes no memory, and is neutral.

    Attributes:
        given: name of a column, first row, and numbers from there on.
    """

    def __init__(self, neutral: dict[str, float]) -> None:
        """Begin with none.

        Args:
            neutral: names of the columns, and the number of a row for which none was given.
        """
        self.neutral = neutral
        self.given: list[tuple[str, int, np.ndarray]] = []

    def add(self, first: int, columns: Mapping[str, np.ndarray]) -> None:
        """Give rows from ``first`` on their numbers, (n,), by name of the column; other names are left alone."""
        for name, value in self.neutral.items():
            if name in columns and (columns[name] != value).any():
                self.given.append((name, first, columns[name]))

    def collect(self, rows: np.ndarray, prefix: str = "") -> dict[str, np.ndarray]:
        """All columns where a row of any of them is not neutral, with a prefix to their names; else none.

        Args:
            rows: all rows in the order that is wanted, (n,).
            prefix: what the names begin with.
        """
        if not self.given:
            return {}
        found = {name: np.full(len(rows), value) for name, value in self.neutral.items()}
        for name, first, values in self.given:
            found[name][first : first + len(values)] = values
        return {prefix + name: column[rows] for name, column in found.items()}
