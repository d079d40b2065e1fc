"""ContactNet: corrects the impulses of a solve in flight, contact by contact (``dc_kernels.learn.in_flight``).

A convolutional trunk of several scales reads images of what the contacts carry and of how the last sweep changed it; a
small head at each contact reads the trunk at the contact and at both its bodies, and the contact's own features, which
no grid can blur. The answer is a correction at the scale of the contact: a multiple of the step of the last sweep (as
Aitken's, but of its own for each contact), a part scaled by the step's RMS, and a multiple of the impulse carried.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT, SHARE
from dc_kernels.learn.layers import Layers
from dc_kernels.model.settings import Positive, Settings
from dc_kernels.runtime.imports import require
from pipeline.networks.models import Channels
from pipeline.networks.registry import register
from pipeline.networks.trunk import Trunk
from pipeline.networks.weights import as_arrays, runs_as_written

torch = require("torch", "pipeline")
nn = torch.nn
F = torch.nn.functional
Module: Any = nn.Module  # a name that mypy takes as a base

BEGIN, ACCELERATED = LOCAL.index("begin"), LOCAL.index("accelerated")
STEP, FREE, CARRIED = (
    slice(OUTPUT.index(f"{part}_n"), OUTPUT.index(f"{part}_t") + 1) for part in ("step", "free", "carried")
)
"""Columns of the answer, normal and tangential part of each."""


@dataclass(frozen=True, kw_only=True)
class ContactNetConfig(Settings):
    """Sizes of the layers of a ContactNet, and of the grid that it reads."""

    settings_prefix: ClassVar[str] = "ContactNetConfig."

    spacing: Positive = 2.0
    """Distance of the grid's nodes; it need not be fine, as contacts bring exact features [typical diameters]."""
    channels: tuple[Channels, ...] = (8, 16, 16)
    """Channels of the trunk at each scale; each scale halves the grid [1]."""
    near: Channels = 8
    """Channels that are gathered at the contacts [1]."""
    hidden: tuple[Channels, ...] = (48, 32)
    """Widths of the head's hidden layers [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` where there is no layer."""
        for name in ("channels", "hidden"):
            if not getattr(self, name):
                raise ValueError(f"{self.settings_prefix}{name} is (); it must hold widths >= 1")


@register("contactnet", ContactNetConfig, None)
class ContactNet(Trunk):
    """Maps features of contacts and images of worlds to corrections (contacts, len(OUTPUT))."""

    def __init__(self, config: ContactNetConfig | None = None) -> None:
        """Draw random weights; the answer begins as a share of Aitken's step, ``SHARE`` for every contact."""
        config = config or ContactNetConfig()
        super().__init__(len(IMAGE), config.channels, config.near)
        self.config = config
        first, *rest = config.hidden
        self.own = nn.Linear(len(LOCAL), first)
        self.places = nn.ModuleList(nn.Linear(config.near, first, bias=False) for _ in range(3))
        sizes = (first, *rest)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.last = nn.Linear(sizes[-1], len(OUTPUT))
        # share of the answer that is used, with plain and with accelerated solvers (``tuning``)
        self.register_buffer("gain", torch.ones(2))
        with torch.no_grad():
            self.last.weight.mul_(0.1)
            self.last.bias.zero_()
        self.to(memory_format=torch.channels_last)  # half the time of a convolution on a CPU

    def head(self, local: Any, near: Any) -> Any:
        """Map features (n, len(LOCAL)) and the trunk at three places (n, near) to corrections (n, len(OUTPUT))."""
        x = self.own(local)
        for layer, value in zip(self.places, near):
            x = x + layer(value)
        x = F.relu(x)
        for layer in self.layers:
            x = F.relu(layer(x))
        accelerated = local[:, ACCELERATED, None]
        answer = self.last(x) * (self.gain[0] + (self.gain[1] - self.gain[0]) * accelerated)
        answer[:, STEP] += even_share(local)[:, None]
        return answer

    def forward(self, local: Any, images: Any, gather: Callable[[Any], Any]) -> Any:
        """Return corrections (n, len(OUTPUT)); ``gather`` reads an image at the contacts and at their bodies."""
        return self.head(local, gather(self.trunk(images)))

    def in_lanes(self, accelerated: bool) -> Layers | None:
        """Return the weights for kernels, for a solver that extrapolates by itself or not.

        None: with another ``trunk`` or ``head``, or hooks, torch answers.
        """
        if not runs_as_written(self, ContactNet, "trunk", "head"):
            return None

        gain = float(self.gain[int(accelerated)])
        weight, bias = as_arrays(self.last)
        return Layers(
            down=[as_arrays(layer) for layer in self.down],
            up=[as_arrays(layer) for layer in self.up],
            near=tuple(part.reshape(len(part), -1) if part.ndim > 1 else part for part in as_arrays(self.near)),
            own=as_arrays(self.own),
            places=[layer.weight.detach().numpy() for layer in self.places],
            hidden=[as_arrays(layer) for layer in self.layers],
            last=(gain * weight, gain * bias),
            share=SHARE,
        )


class EvenShare(Module):
    """Answers with an equal share of Aitken's step for all contacts: what a network has to beat."""

    def __init__(self) -> None:
        super().__init__()
        self.config = ContactNetConfig()

    def trunk(self, images: Any) -> Any:
        """Return zeros, (K, 1, rows, columns), of which the head reads nothing."""
        return images.new_zeros(len(images), 1, *images.shape[2:])

    def head(self, local: Any, near: Any) -> Any:
        """Return an equal share of the step of the last sweep for all contacts, (n, len(OUTPUT))."""
        output = local.new_zeros(len(local), len(OUTPUT))
        output[:, STEP] = even_share(local)[:, None]
        return output

    @property
    def is_even(self) -> bool:
        """Whether kernels may answer in its place; not in a class with another ``head``."""
        return type(self).head is EvenShare.head


def even_share(local: Any) -> Any:
    """Return the share of Aitken's step for each contact, (n,): ``SHARE`` while solving, 0 before the first sweep."""
    return SHARE * (1.0 - local[:, BEGIN])
