"""The part that networks of contacts and of bodies have in common: a small U-Net whose image they read at points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from dc_kernels.runtime.imports import require

torch = require("torch", "pipeline")
nn = torch.nn
F = nn.functional
Module: Any = nn.Module  # a name that mypy takes as a base


class Trunk(Module):
    """A network that begins with a U-Net: a 3x3 convolution at each scale down, one back up, skips between."""

    def __init__(self, inputs: int, widths: Sequence[int], near: int) -> None:
        """Draw random weights.

        Args:
            inputs: channels of the images.
            widths: channels at each scale; each scale halves the grid.
            near: channels of what is read at points.
        """
        super().__init__()
        self.down = nn.ModuleList(
            nn.Conv2d(before, width, 3, padding=1) for before, width in zip((inputs, *widths), widths)
        )
        self.up = nn.ModuleList(nn.Conv2d(low + high, high, 3, padding=1) for high, low in itertools.pairwise(widths))
        self.near = nn.Conv2d(widths[0], near, 1)

    def trunk(self, images: Any) -> Any:
        """Map images (K, inputs, rows, columns) to what is read of them, (K, near, rows, columns)."""
        kept = []
        x = images
        for i, layer in enumerate(self.down):
            if i:
                x = F.avg_pool2d(x, 2, ceil_mode=True)
            x = F.relu(layer(x))
            kept.append(x)
        for layer, skip in zip(reversed(self.up), reversed(kept[:-1])):
            x = F.interpolate(x, size=skip.shape[2:], mode="nearest")
            x = F.relu(layer(torch.cat([skip, x], dim=1)))
        return self.near(x)
