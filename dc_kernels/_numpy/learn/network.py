"""A ContactNet from its packed weights: image, trunk and head of a world that is read, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.grid.stencil import axis_weights
from dc_kernels._numpy.learn.layers import Weights, trunk_of
from dc_kernels.learn.channels import IMAGE, OUTPUT, Answer, Output
from dc_kernels.learn.layers import padded

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
    weights = Weights(network.weight.astype(float))
    origin = reading.grid_origin[k].astype(float)

    def nodes(kernel: str, place: Array) -> list[tuple[Array, Array]]:
        """Nodes and weights along y and x."""
        u = (place.astype(float) - origin) / network.spacing
        return [axis_weights(kernel, u[axis], n)[:2] for axis, n in ((1, network.rows), (0, network.columns))]

    image = np.zeros((network.rows, network.columns, len(IMAGE)))
    for m in range(mine.start, mine.stop):
        (rows, wy), (columns, wx) = nodes("bspline", reading.place[m])
        image[np.ix_(rows, columns)] += np.multiply.outer(np.outer(wy, wx), reading.image_value[m].astype(float))
    trunk = trunk_of(image, weights, network.width)
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
