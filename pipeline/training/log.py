"""The log of a training."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dc_kernels.runtime.imports import require
from pipeline.files import atomic_path


class Log:
    """Writes scalars of a training by step, for TensorBoard and as one JSON object a line in ``metrics.jsonl``.

    A training that goes on from a step drops what an earlier run logged after it.
    """

    def __init__(self, folder: Path, step: int = 0, *, enabled: bool = True) -> None:
        """Continue after ``step``; does nothing unless ``enabled``."""
        self.path = folder / "metrics.jsonl"
        self.rows: list[dict[str, Any]] = []
        self.writer = None
        if not enabled:
            return
        folder.mkdir(parents=True, exist_ok=True)
        if step and self.path.exists():
            self.rows = [row for row in _rows(self.path) if row["step"] <= step]
        with atomic_path(self.path) as partial:
            partial.write_text("".join(json.dumps(row) + "\n" for row in self.rows))
        summaries = require("torch.utils.tensorboard", "pipeline")
        self.writer = summaries.SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1 if step else None)

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Log values of a step; a name such as "validation/loss" has its group first."""
        if self.writer is None:
            return
        row = {"step": step, **{name: float(value) for name, value in values.items()}}
        self.rows.append(row)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        for name, value in values.items():
            self.writer.add_scalar(name, float(value), step)

    def series(self, name: str) -> tuple[list[int], list[float]]:
        """Return steps and values of a name."""
        rows = [row for row in self.rows if name in row]
        return [row["step"] for row in rows], [row[name] for row in rows]

    def close(self) -> None:
        """Close the file of TensorBoard."""
        if self.writer is not None:
            self.writer.close()


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Read the lines up to the first that is cut short, as a killed run may leave half of one."""
    for line in path.read_text().splitlines():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            return
