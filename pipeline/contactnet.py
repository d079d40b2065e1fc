"""ContactNet: corrects the impulses of a solve in flight, contact by contact (``dc_kernels.solve_features``).

A convolutional trunk of several scales reads images of what the contacts carry and of how the last sweep changed it; a
small head at each contact reads the trunk at the contact and at both its bodies, and the contact's own features, which
no grid can blur. The answer is a correction at the scale of the contact: a multiple of the step of the last sweep (as
Aitken's, but of its own for each contact), a part scaled by the step's RMS, and a multiple of the impulse carried.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dc_kernels.arrays import require
from dc_kernels.solve_channels import IMAGE, LOCAL, OUTPUT

torch = require("torch", "pipeline")
nn = torch.nn
F = torch.nn.functional


@dataclass(frozen=True, kw_only=True)
class ContactNetConfig:
    """Sizes of a ContactNet."""

    spacing: float = 1.0
    """Distance of the grid's nodes [typical diameters]."""
    channels: tuple[int, ...] = (16, 24, 32)
    """Channels of the trunk at each scale; each scale halves the grid."""
    near: int = 16
    """Channels that are gathered at the contacts."""
    hidden: tuple[int, ...] = (48, 32)
    """Widths of the head's hidden layers."""


class ContactNet(nn.Module):
    """Features of contacts and images of worlds -> corrections (contacts, len(OUTPUT))."""

    def __init__(self, config: ContactNetConfig | None = None) -> None:
        """Random weights; the last layer begins at half an Aitken step for every contact."""
        super().__init__()
        self.config = config = config or ContactNetConfig()
        widths = config.channels
        self.down = nn.ModuleList(
            nn.Conv2d(before, width, 3, padding=1) for before, width in zip((len(IMAGE), *widths), widths)
        )
        self.up = nn.ModuleList(nn.Conv2d(low + high, high, 3, padding=1) for high, low in itertools.pairwise(widths))
        self.near = nn.Conv2d(widths[0], config.near, 1)
        first, *rest = config.hidden
        self.own = nn.Linear(len(LOCAL), first)
        self.places = nn.ModuleList(nn.Linear(config.near, first, bias=False) for _ in range(3))
        sizes = (first, *rest)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.last = nn.Linear(sizes[-1], len(OUTPUT))
        with torch.no_grad():
            self.last.weight.mul_(0.1)
            self.last.bias.zero_()
            self.last.bias[:2] = 0.5

    def trunk(self, images: Any) -> Any:
        """(K, len(IMAGE), rows, columns) -> (K, near, rows, columns)."""
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

    def head(self, local: Any, near: Any) -> Any:
        """Features (n, len(LOCAL)) and the trunk at three places, (n, near) each -> (n, len(OUTPUT))."""
        x = self.own(local)
        for layer, value in zip(self.places, near):
            x = x + layer(value)
        x = F.relu(x)
        for layer in self.layers:
            x = F.relu(layer(x))
        return self.last(x)

    def forward(self, local: Any, images: Any, gather: Callable[[Any], Any]) -> Any:
        """Corrections; ``gather`` brings an image of the worlds to the contacts and both their bodies."""
        return self.head(local, gather(self.trunk(images)))
