"""A StepNet from its packed weights: image, trunk and head of a world before the solve, in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.grid.stencil import axis_weights
from dc_kernels._numpy.learn.layers import Weights, trunk_of
from dc_kernels.learn.layers import padded
from dc_kernels.learn.step_channels import ANSWER, BINS, CHANNELS, CONTACT_CHANNELS, FLOATING, LEAST_GIVE, MOTION
from dc_kernels.model.enums import BodyType


def kernels(dtype: str) -> Kernels:
    """``answer_worlds``; the arrays bring their scalar type."""
    return {"answer_worlds": answer_worlds}


def answer_worlds(
    tid: int, world_offset: int, network: Any, model: Any, state: Any, motion: Any, contacts: Any, asking: Any
) -> None:
    """Make velocities (``asking.velocity``) and impulses of the worlds that are asked for."""
    w = tid + world_offset
    if not asking.asked[w]:
        return
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    mine = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    dt = float(motion.step_dt[w])
    pull = math.hypot(*model.gravity[w].astype(float))
    unit = pull * dt**2 if pull > 0 else FLOATING * float(model.length_scale[w])
    speed = unit / dt
    dynamic = model.body_type[bodies] == BodyType.DYNAMIC
    inverse = np.stack([model.inv_mass[bodies], model.inv_mass[bodies], model.inv_inertia[bodies]], axis=1)
    inverse = np.where(dynamic[:, None], inverse, 0.0).astype(float)
    way = motion.predicted[bodies, :3].astype(float) / speed
    a, b = (getattr(contacts, name)[mine] - bodies.start for name in ("body_a", "body_b"))
    lines = _lines(
        contacts.normal[mine].astype(float), *(getattr(contacts, f"arm_{x}")[mine].astype(float) for x in "ab")
    )
    give = np.maximum((lines[0] ** 2 * inverse[a] + lines[1] ** 2 * inverse[b]).sum(axis=2), LEAST_GIVE)
    gap = np.maximum(contacts.gap[mine].astype(float), 0.0) / unit

    def relative(ways: Array) -> Array:
        """How B moves against A along normals and tangents, (2, M)."""
        return np.asarray((lines[1] * ways[b] - lines[0] * ways[a]).sum(axis=2))

    image = np.zeros((network.rows, network.columns, len(CHANNELS)))
    origin = np.array([network.origin_x, network.origin_y], float)

    def nodes(kernel: str, place: Array) -> list[tuple[Array, Array]]:
        """Nodes and weights along y and x."""
        u = (place.astype(float) - origin) / network.spacing
        return [axis_weights(kernel, u[axis], n)[:2] for axis, n in ((1, network.rows), (0, network.columns))]

    def splat(place: Array, first: int, values: Array) -> None:
        (rows, wy), (columns, wx) = nodes("bspline", place)
        image[rows[:, None], columns, first : first + len(values)] += np.multiply.outer(np.outer(wy, wx), values)

    mass = model.mass[bodies].astype(float)
    mean = mass[dynamic].mean() if dynamic.any() and mass[dynamic].any() else 1.0
    force = (motion.predicted[bodies, :2].astype(float) - state.velocity[bodies]) / speed
    place = state.position[bodies].astype(float)
    for i in np.flatnonzero(dynamic):
        splat(place[i], 0, np.array([mass[i] / mean, *way[i], *force[i]]))
    closing, sliding = relative(way)
    for i, (x, y) in enumerate(contacts.normal[mine].astype(float)):
        turn = math.atan2(-y, -x) if y < 0 or (y == 0 and x < 0) else math.atan2(y, x)
        first = CHANNELS.index("contacts/0") + len(CONTACT_CHANNELS) * (int(turn / math.pi * BINS + 0.5) % BINS)
        values = np.array([1.0, gap[i], min(closing[i] + gap[i], 0.0), sliding[i]])
        splat(place[a[i]] + contacts.arm_a[mine][i], first, values)
    image[..., CHANNELS.index("wall")] = asking.wall[w]

    weights = Weights(network.weight.astype(float))
    trunk = trunk_of(image, weights, network.width)
    bias, (weight,) = weights.layer(network.near, (trunk.shape[2],))
    seen = np.zeros((len(way), padded(network.near)))
    for i in np.flatnonzero(dynamic):
        (rows, wy), (columns, wx) = nodes("bilinear", place[i])
        seen[i, : network.near] = np.einsum("y,x,yxc->c", wy, wx, trunk[np.ix_(rows, columns)]) @ weight + bias
    now, impulse = way, np.zeros((2, len(gap)))
    friction = contacts.friction[mine].astype(float)
    share = [inverse[a, 0] / give[0], inverse[b, 0] / give[0], friction]

    def moving() -> Array:
        """How contacts move, and what they carry, (M, MOTION)."""
        closing, sliding = relative(now)
        left = closing + gap
        return np.stack([left, np.minimum(left, 0.0), sliding, *(impulse * give), gap, closing, *share], axis=1)

    bias, (weight,) = weights.layer(network.kept, (MOTION,))
    hidden = np.zeros((len(gap), padded(network.kept)))
    hidden[:, : network.kept] = np.maximum(moving() @ weight + bias, 0.0)
    for _ in range(network.rounds):
        heard = np.zeros((len(way), hidden.shape[1]))
        np.add.at(heard, a, hidden)
        np.add.at(heard, b, hidden)
        heard[~dynamic] = 0.0
        motion_now = moving()
        x = np.concatenate([seen[a], seen[b], hidden, heard[a] - hidden, heard[b] - hidden, motion_now], axis=1)
        bias, (weight,) = weights.layer(network.wide, (x.shape[1],))
        x = np.maximum(x @ weight + bias, 0.0)
        bias, (weight,) = weights.layer(network.kept + ANSWER, (x.shape[1],))
        x = x @ weight + bias
        by = x[:, network.kept :].T
        step = by[2:] - motion_now[:, [0, 2]].T / (1.0 + np.exp(-by[:2]))
        normal, tangent = impulse + step / give
        normal = np.maximum(normal, 0.0)
        impulse = np.stack([normal, np.clip(tangent, -friction * normal, friction * normal)])
        now = way.copy()
        np.subtract.at(now, a, (impulse[:, :, None] * lines[0]).sum(axis=0) * inverse[a])
        np.add.at(now, b, (impulse[:, :, None] * lines[1]).sum(axis=0) * inverse[b])
        hidden[:, : network.kept] = np.maximum(x[:, : network.kept], 0.0)
    asking.velocity[bodies] = np.where(dynamic[:, None], now * speed, motion.predicted[bodies, :3])
    contacts.impulse[mine] = impulse.T * speed


def _lines(normal: Array, arm_a: Array, arm_b: Array) -> Array:
    """Directions, and arms crossed with them, of A and B along normals and tangents, (2, 2, M, 3)."""

    def of(line: Array, arm: Array) -> Array:
        return np.column_stack([line, arm[:, 0] * line[:, 1] - arm[:, 1] * line[:, 0]])

    tangent = np.column_stack([normal[:, 1], -normal[:, 0]])
    return np.array([[of(normal, arm), of(tangent, arm)] for arm in (arm_a, arm_b)])
