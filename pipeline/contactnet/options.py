"""Options of the training of a ContactNet; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dc_kernels.model.settings import Count, NotNegative, Positive, Seed, Settings


@dataclass(frozen=True, kw_only=True)
class ContactTrainOptions(Settings):
    """Options of a training of ContactNet; the defaults are those of the weights in the package."""

    out: Path = Path("out/contactnet")
    """Output folder, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder."""
    rounds: Count = 14
    """Rounds of recording and steps [1]."""
    steps: Count = 500
    """Steps of a round [1]."""
    contacts: Count = 5000
    """Approximate number of contacts in a step's batch [1]."""
    rate: Positive = 1e-3
    """Highest learning rate, of AdamW in one cycle."""
    weight_decay: NotNegative = 1e-4
    """Weight decay of the optimiser [1]."""
    clip: Positive = 1.0
    """Gradient norm to which larger gradients are clipped [1]."""
    seed: Seed = 0
    """Seed of the weights, of the recorded states, and of the first world [1]."""
    spacing: Positive = 2.0
    """Distance of the grid's nodes [typical diameters]."""
    channels: tuple[Count, ...] = (8, 16, 16)
    """Channels of the trunk at each scale [1]."""
    near: Count = 8
    """Channels that are gathered at the contacts [1]."""
    hidden: tuple[Count, ...] = (48, 32)
    """Widths of the head's hidden layers [1]."""
    worlds: Positive = 1.0
    """Factor on the worlds of a round [1]."""
    threads: Count = 1
    """Threads of torch [1]."""
