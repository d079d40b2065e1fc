"""Scales of a network's channels and of the losses, from training states."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from dc_kernels.runtime.imports import require
from pipeline.data.splatter import Splatter

torch = require("torch", "pipeline")

SCALE_STATES = 512
"""Number of states from which scales are taken [1]."""


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Root mean squares; in units of those of ``nodes`` and ``contacts`` the answer zero has a mean square of 1."""

    channels: Any
    """Of each input channel over the nodes that it reaches, without walls, as they are far heavier, (channels,)."""
    outputs: Any
    """Of each channel of the labels' image over the nodes that it reaches, (outputs,) [N s]."""
    nodes: Any
    """Of each channel of the labels' image over all nodes, (outputs,) [N s]."""
    contacts: Any
    """Of normal and tangential impulses of the labels over the contacts, (2,) [N s]."""


def find_scales(batches: Iterable[Any], splatter: Splatter, walls: float) -> Scales:
    """Measure the scales of training states.

    Args:
        batches: of states, of which ``SCALE_STATES`` are looked at, about.
        splatter: makes their images.
        walls: mass of the nodes that walls cover [kg]; 0: there are none.
    """
    channels, outputs, nodes, contacts = (RunningSquare() for _ in range(4))
    states = 0
    for batch in batches:
        images, target = splatter(batch)
        if walls:
            images = torch.where(images < walls, images, 0.0)
        channels.add(images, images != 0)
        outputs.add(target, target != 0)
        nodes.add(target, torch.ones_like(target))
        contacts.add(batch.label.T[None], torch.ones_like(batch.label.T[None]))
        states += len(batch.dt)
        if states >= SCALE_STATES:
            break
    return Scales(channels=channels.root(), outputs=outputs.root(), nodes=nodes.root(), contacts=contacts.root())


class RunningSquare:
    """Sums up the mean square of each channel (dimension 1) over those values of several tensors that count."""

    def __init__(self) -> None:
        self.square: Any = 0.0
        self.count: Any = 0.0

    def add(self, values: Any, counts: Any) -> None:
        """Add values (B, channels, ...), those where ``counts`` is 1."""
        self.square = self.square + (values.square() * counts).transpose(0, 1).flatten(1).sum(dim=1)
        self.count = self.count + counts.transpose(0, 1).flatten(1).sum(dim=1)

    def root(self) -> Any:
        """Return the root of the mean square, 1 for a channel without values that count, (channels,)."""
        root = (self.square / torch.clamp(self.count, min=1)).sqrt()
        return torch.where(root > 0, root, 1.0)
