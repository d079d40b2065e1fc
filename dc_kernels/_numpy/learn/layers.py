"""Packed weights layer by layer, and the trunk of a network on its image, in float64."""

from __future__ import annotations

import itertools

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels.learn.layers import blocks, padded


class Weights:
    """Reads packed weights layer by layer."""

    def __init__(self, packed: Array) -> None:
        self.packed, self.at = packed, 0

    def layer(self, outputs: int, *shapes: tuple[int, ...]) -> tuple[Array, list[Array]]:
        """Return biases (outputs,) and the weights of inputs of some shapes, (..., outputs) each."""
        parts: list[Array] = [np.zeros((*shape, padded(outputs))) for shape in ((), *shapes)]
        for block in blocks(outputs):
            for part in parts:
                own = part[..., block]
                own[...] = self.packed[self.at : self.at + own.size].reshape(own.shape)
                self.at += own.size
        bias, *inputs = (part[..., :outputs] for part in parts)
        return bias, inputs


def trunk_of(image: Array, weights: Weights, widths: Array) -> Array:
    """Map an image (rows, columns, channels) to what contacts read of it, (rows, columns, widths[0])."""
    kept = []
    x = image
    for scale, width in enumerate(widths):
        x = _halved(x) if scale else x
        bias, (weight,) = weights.layer(int(width), (3, 3, x.shape[2]))
        x = np.maximum(_convolved(x, weight) + bias, 0.0)
        kept.append(x)
    for fine in reversed(kept[:-1]):
        width = fine.shape[2]
        bias, (weight, sets) = weights.layer(width, (3, 3, width), (3, 3, 2, 2, x.shape[2]))
        x = np.maximum(_convolved(fine, weight) + _repeated(x, sets, fine.shape[:2]) + bias, 0.0)
    return x


def _halved(x: Array) -> Array:
    """Means of 2 x 2 nodes, of fewer at the end of an odd axis."""
    sums, counts = (np.pad(a, ((0, a.shape[0] % 2), (0, a.shape[1] % 2), (0, 0))) for a in (x, np.ones_like(x)))
    rows, columns, channels = sums.shape
    four = (rows // 2, 2, columns // 2, 2, channels)
    return sums.reshape(four).sum(axis=(1, 3)) / counts.reshape(four).sum(axis=(1, 3))


def _convolved(x: Array, weight: Array) -> Array:
    """Correlate with 3 x 3 weights (3, 3, channels, outputs), zeros around."""
    wide = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(wide, (3, 3), axis=(0, 1))
    return np.einsum("yxcij,ijco->yxo", windows, weight)


def _repeated(x: Array, sets: Array, shape: tuple[int, ...]) -> Array:
    """Correlate what repeats x 2 x 2 times with the weights of its 2 x 2 nodes, by row and column (``layers.SUMS``)."""
    wide = np.pad(x, ((1, 1), (1, 1), (0, 0)))

    def kind(i: int, n: int) -> int:
        return 1 if i % 2 else (2 if i == n - 1 else 0)

    found = np.zeros((*shape, sets.shape[-1]))
    for i, j in itertools.product(*map(range, shape)):
        corner = wide[(i + 1) // 2 : (i + 1) // 2 + 2, (j + 1) // 2 : (j + 1) // 2 + 2]
        found[i, j] = np.einsum("abc,abco->o", corner, sets[kind(i, shape[0]), kind(j, shape[1])])
    return found
