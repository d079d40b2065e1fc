"""Weights of a ContactNet as its kernels read them: blocks of outputs in lanes, and images that are padded with zeros.

A block is one or two vectors of LANES outputs of a layer: its biases, then the weights of each input for these outputs.
Where a convolution reads a coarser image that is repeated 2 x 2 times, a pixel sees 2 x 2 of its nodes, whose weights
are sums of the 3 x 3, in nine sets: by whether the row, and the column, is even, odd, or even and the image's last.
The layer behind the trunk that has no nonlinearity goes into the weights of the head, as a gather's weights sum to 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT

LANES = 8  # outputs side by side
CHUNK = 24  # contacts that the head answers at once: whole blocks of 6 and of 8
MOST_SCALES = 8
SUMS = np.array([[[1, 0, 0], [0, 1, 1]], [[1, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 0]]], float)
"""What of three neighbours each of two coarse nodes stands for: even, odd, even and last; (3, 2, 3)."""

Layer = tuple[np.ndarray, np.ndarray]
"""Weights (outputs, inputs[, 3, 3]) and biases (outputs,)."""


@dataclass(frozen=True)
class Layers:
    """Weights of a ContactNet, as arrays."""

    down: Sequence[Layer]
    """Convolutions of each scale, from the finest to the coarsest."""
    up: Sequence[Layer]
    """Convolutions of each scale but the coarsest, which read it beside the next coarser one; from the finest."""
    near: Layer
    """What the head reads of the trunk, (near, channels)."""
    own: Layer
    """First layer of the head on a contact's own features."""
    places: Sequence[np.ndarray]
    """First layer of the head on what is near the contact, its body A and its body B, (width, near) each."""
    hidden: Sequence[Layer]
    """Further hidden layers of the head."""
    last: Layer
    """Last layer of the head."""
    share: float
    """Share of Aitken's step that is added to the answer, but before the first sweep [1]."""

    @property
    def widths(self) -> list[int]:
        """Channels of the trunk at each scale."""
        return [len(bias) for _, bias in self.down]

    @property
    def hidden_widths(self) -> list[int]:
        """Widths of the hidden layers of the head."""
        return [len(bias) for _, bias in (self.own, *self.hidden)]


def padded(channels: int) -> int:
    """Return a number of channels as it lies in memory: whole vectors."""
    return -(-channels // LANES) * LANES


def blocks(outputs: int) -> Iterator[slice]:
    """Blocks of the outputs of a layer: two vectors wide where there are so many."""
    first = 0
    while first < outputs:
        width = LANES * (2 if first + LANES < outputs else 1)
        yield slice(first, first + width)
        first += width


class Packing:
    """Weights that are put one behind the other in the order in which kernels read them."""

    def __init__(self) -> None:
        self.parts: list[np.ndarray] = []

    def add(self, bias: np.ndarray, *inputs: np.ndarray) -> None:
        """Add a layer; inputs are (..., outputs), read one after the other."""
        for block in blocks(len(bias)):
            for values in (bias, *inputs):
                wide = np.zeros((*values.shape[:-1], padded(len(bias))))
                wide[..., : len(bias)] = values
                self.parts.append(wide[..., block].ravel())

    def add_trunk(self, down: Sequence[Layer], up: Sequence[Layer]) -> None:
        """Add the convolutions of each scale, and those back, from the finest each."""
        for weight, bias in down:
            self.add(bias, weight.transpose(2, 3, 1, 0))
        for (weight, bias), (_, skip) in reversed(list(zip(up, down))):
            fine, coarse = weight[:, : len(skip)], weight[:, len(skip) :]
            self.add(bias, fine.transpose(2, 3, 1, 0), np.einsum("pay,qbx,oiyx->pqabio", SUMS, SUMS, coarse))

    def all(self) -> np.ndarray:
        """Return all weights, float64."""
        return np.concatenate(self.parts)


def pack(layers: Layers) -> np.ndarray:
    """Return all weights in the order in which the kernels read them, float64."""
    packing = Packing()
    packing.add_trunk(layers.down, layers.up)
    (near, near_bias), (own, own_bias) = layers.near, layers.own
    wide = np.zeros((len(layers.places), padded(near.shape[1]), len(own_bias)))
    for place, weight in zip(wide, layers.places):
        place[: near.shape[1]] = (weight.astype(float) @ near).T
    bias = own_bias + sum(weight.astype(float) @ near_bias for weight in layers.places)
    packing.add(bias, np.concatenate([*wide, own.T]))
    for weight, bias in (*layers.hidden, layers.last):
        packing.add(bias, weight.T)
    return packing.all()


def trunk_size(widths: Sequence[int], channels: int, rows: int, columns: int) -> int:
    """Return the numbers of the maps of a trunk at work on an image; raises ``ValueError`` for too many scales."""
    if len(widths) > MOST_SCALES:
        raise ValueError(f"the trunk has {len(widths)} scales; there may be {MOST_SCALES}")
    sizes = [(rows, columns)]
    for _ in widths[1:]:
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    maps = [(sizes[0], channels), *zip(sizes, widths), *zip(sizes[1:], widths[:-1]), *zip(sizes[:-1], widths[:-1])]
    return sum((y + 2) * (x + 2) * padded(channels) for (y, x), channels in maps)


def scratch_size(layers: Layers, rows: int, columns: int) -> int:
    """Return the numbers of a world's image, maps and head at work; raises ``ValueError`` for too many scales."""
    total = trunk_size(layers.widths, len(IMAGE), rows, columns)
    inputs = padded(3 * padded(layers.widths[0]) + len(LOCAL))
    return total + CHUNK * (inputs + 2 * max(map(padded, (*layers.hidden_widths, len(OUTPUT)))))
