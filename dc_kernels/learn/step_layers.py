"""Weights of a StepNet as its kernels read them; blocks of outputs and the trunk lie as those of a ContactNet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dc_kernels.learn.layers import CHUNK, Layer, Packing, padded, trunk_size
from dc_kernels.learn.step_channels import ANSWER, CHANNELS, MOTION


@dataclass(frozen=True)
class StepLayers:
    """Weights of a StepNet, as arrays."""

    down: Sequence[Layer]
    """Convolutions of each scale, from the finest to the coarsest."""
    up: Sequence[Layer]
    """Convolutions of each scale but the coarsest, which read it beside the next coarser one; from the finest."""
    near: Layer
    """What bodies read of the trunk, (near, channels)."""
    first: Layer
    """What a contact says before the first round, by its motion, (kept, MOTION)."""
    rounds: Sequence[tuple[Layer, Layer]]
    """Two layers of each round: of motion, what both bodies read of the trunk, what the contact says, and what the
    other contacts of both bodies do; then answer and what the contact says next, (ANSWER + kept, wide)."""

    @property
    def widths(self) -> list[int]:
        """Channels of the trunk at each scale."""
        return [len(bias) for _, bias in self.down]

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the head as its kernels take them."""
        names = {"near": self.near, "kept": self.first, "wide": self.rounds[0][0]}
        return {**{name: len(bias) for name, (_, bias) in names.items()}, "rounds": len(self.rounds)}


def pack(layers: StepLayers) -> np.ndarray:
    """Return all weights in the order in which the kernels read them, float64.

    The inputs of a round lie in whole vectors, with the motion behind the others; its outputs with the answer behind
    what the contact says next.
    """
    packing = Packing()
    packing.add_trunk(layers.down, layers.up)
    for weight, bias in (layers.near, layers.first):
        packing.add(bias, weight.T)
    near, kept = layers.sizes["near"], layers.sizes["kept"]
    for (weight, bias), (last, last_bias) in layers.rounds:
        motion, *others = np.split(weight.T, np.cumsum([MOTION, near, near, kept, kept]))
        wide = [np.zeros((padded(len(part)), len(bias))) for part in others]
        for place, part in zip(wide, others):
            place[: len(part)] = part
        packing.add(bias, np.concatenate([*wide, motion]))
        packing.add(np.roll(last_bias, -ANSWER), np.roll(last, -ANSWER, axis=0).T)
    return packing.all()


def scratch_size(layers: StepLayers, rows: int, columns: int) -> int:
    """Return the numbers of a world's image, maps and head at work; raises ``ValueError`` for too many scales."""
    near, kept, wide = (padded(layers.sizes[name]) for name in ("near", "kept", "wide"))
    given = max(padded(2 * near + 3 * kept + MOTION), padded(layers.widths[0]))
    found = max(near, wide, padded(layers.sizes["kept"] + ANSWER))
    return trunk_size(layers.widths, len(CHANNELS), rows, columns) + CHUNK * (given + 2 * found)
