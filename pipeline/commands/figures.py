"""The command ``figures``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.commands.common import Common, Positional
from pipeline.plots.kernels import draw


@dataclass(frozen=True, kw_only=True)
class Figures(Common):
    """Reproduce a figure of Wu (2018): "kernels" compares the smoothing kernels (figures 3.3 and 3.4)."""

    figure: Positional[Literal["kernels"]]
    """Which figure."""
    out: Path = Path("out/figures")
    """Folder of the PNG."""

    def __call__(self) -> dict[str, Any]:
        path = draw(self.figure, self.out)
        if not self.json:
            print(path)
        return {"figure": self.figure, "path": str(path)}
