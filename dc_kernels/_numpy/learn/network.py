"""A ContactNet from its packed weights: image, trunk and head of a world that is read, in float64."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.grid.stencil import axis_weights
from dc_kernels.learn.channels import IMAGE, OUTPUT, Answer, Output
from dc_kernels.learn.layers import blocks, padded

PLACES = ("place", "place_a", "place_b")


def kernels(dtype: str) -> Kernels:
    """``answer_contacts``; the arrays bring their scalar type."""
    return {"answer_contacts": answer_contacts}


def answer_contacts(tid: int, world_offset: int, network: Any, reading: Any, output: Array) -> None:
    """Answer with a correction for each contact of a world that was read (columns ``Output``)."""
    k = tid + world_offset
    mine = slice(reading.packed_start[k], reading.packed_start[k + 1])
    if mine.start == mine.stop or reading.answer[k] != Answer.NETWORK:
        return
    weights = _Weights(network.weight.astype(float))
    origin = reading.grid_origin[k].astype(float)

    def nodes(kernel: str, place: Array) -> list[tuple[Array, Array]]:
        """Nodes and weights along y and x."""
        u = (place.astype(float) - origin) / network.spacing
        return [axis_weights(kernel, u[axis], n)[:2] for axis, n in ((1, network.rows), (0, network.columns))]

    image = np.zeros((network.rows, network.columns, len(IMAGE)))
    for m in range(mine.start, mine.stop):
        (rows, wy), (columns, wx) = nodes("bspline", reading.place[m])
        image[np.ix_(rows, columns)] += np.multiply.outer(np.outer(wy, wx), reading.image_value[m].astype(float))
    trunk = _trunk(image, weights, network.width)
    inputs = np.zeros((mine.stop - mine.start, 3, padded(trunk.shape[2])))
    for row, m in enumerate(range(mine.start, mine.stop)):
        for i, name in enumerate(PLACES):
            (rows, wy), (columns, wx) = nodes("bilinear", getattr(reading, name)[m])
            inputs[row, i, : trunk.shape[2]] = np.einsum("y,x,yxc->c", wy, wx, trunk[np.ix_(rows, columns)])
    x = np.concatenate([inputs.reshape(len(inputs), -1), reading.local[mine].astype(float)], axis=1)
    for width in network.hidden:
        bias, (weight,) = weights.layer(int(width), (x.shape[1],))
        x = np.maximum(x @ weight + bias, 0.0)
    bias, (weight,) = weights.layer(len(OUTPUT), (x.shape[1],))
    answer = x @ weight + bias
    answer[:, [Output.STEP_N, Output.STEP_T]] += network.share
    output[mine] = answer


class _Weights:
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


def _trunk(image: Array, weights: _Weights, widths: Array) -> Array:
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
