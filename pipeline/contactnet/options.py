"""Options of the training of a ContactNet; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.checks import check_finite, check_least


@dataclass(frozen=True, kw_only=True)
class ContactTrainOptions:
    """Options of a training of ContactNet; the defaults are those of the weights in the package."""

    out: Path = Path("out/contactnet")
    """Folder of the files, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder."""
    rounds: int = 14
    """Rounds of recording and steps [1]."""
    steps: int = 500
    """Steps of a round [1]."""
    contacts: int = 5000
    """Number of contacts of a step's batch, about [1]."""
    rate: float = 1e-3
    """Highest learning rate, of AdamW in one cycle."""
    weight_decay: float = 1e-4
    """Weight decay of the optimiser [1]."""
    clip: float = 1.0
    """Longest gradient, to which longer ones are cut [1]."""
    seed: int = 0
    """Seed of the weights, of what is recorded, and of the first world [1]."""
    spacing: float = 2.0
    """Distance of the grid's nodes [typical diameters]."""
    channels: tuple[int, ...] = (8, 16, 16)
    """Channels of the trunk at each scale [1]."""
    near: int = 8
    """Channels that are gathered at the contacts [1]."""
    hidden: tuple[int, ...] = (48, 32)
    """Widths of the head's hidden layers [1]."""
    worlds: float = 1.0
    """Factor on the worlds of a round [1]."""
    threads: int = 1
    """Threads of torch [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        check_least(self, rounds=1, steps=1, contacts=1, threads=1, seed=0)
        check_finite(self, "rate", "clip", "worlds")
