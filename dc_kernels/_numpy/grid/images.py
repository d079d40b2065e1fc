"""What bodies and contacts show on an image: places and values of the points that are splatted."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot, rotate, rotation, tangent
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS

_BODY = {channel.code: name for name, channel in BODY_CHANNELS.items()}
_CONTACT = {channel.code: name for name, channel in CONTACT_CHANNELS.items()}


def kernels(dtype: str) -> Kernels:
    """``body_features``, ``contact_features``, ``add_walls``; the arrays bring their scalar type."""
    return {"body_features": body_features, "contact_features": contact_features, "add_walls": add_walls}


def body_features(
    tid: int, world_offset: int, channel: Array, area: Any, model: Any, state: Any, points: Any, value: Array
) -> None:
    """Put points at position + R(angle) area.place, with area.weight times the body's value; none if flagged."""
    w = tid + world_offset
    points.count[w] = 0 if state.flags[w] else area.start[w + 1] - area.start[w]
    for p in range(area.start[w], area.start[w] + points.count[w]):
        b = area.body[p]
        angle, velocity = state.angle[b], state.velocity[b]
        points.place[p] = state.position[b] + (rotate(rotation(angle), area.place[p]) if area.spread else 0)
        attributes = {
            "mass": model.mass[b],
            "inertia": model.inertia[b],
            "velocity_x": velocity[0],
            "velocity_y": velocity[1],
            "omega": state.angular_velocity[b],
            "angle_cos": np.cos(angle),
            "angle_sin": np.sin(angle),
            "speed": np.hypot(*velocity),
        }
        for c, code in enumerate(channel):
            value[p, c] = attributes[_BODY[int(code)]] * (area.weight[p] if area.spread else 1)


def contact_features(
    tid: int, world_offset: int, bins: int, channel: Array, state: Any, contacts: Any, points: Any, value: Array
) -> None:
    """Put points at position[body_a] + arm_a, with the contacts' values; a flagged world gets none."""
    w = tid + world_offset
    points.count[w] = 0 if state.flags[w] else contacts.contact_count[w]

    def speed(body: int, arm: Array) -> Any:
        return state.velocity[body] + state.angular_velocity[body] * np.array([-arm[1], arm[0]])

    for p in range(contacts.contact_start[w], contacts.contact_start[w] + points.count[w]):
        a, b, n = contacts.body_a[p], contacts.body_b[p], contacts.normal[p]
        points.place[p] = state.position[a] + contacts.arm_a[p]
        if bins > 1:
            points.bin[p] = direction_bin(n, bins)
        relative = speed(b, contacts.arm_b[p]) - speed(a, contacts.arm_a[p])
        attributes = {
            "normal_x": n[0],
            "normal_y": n[1],
            "gap": contacts.gap[p],
            "impulse_n": contacts.impulse[p, 0],
            "impulse_t": contacts.impulse[p, 1],
            "closing_speed": -dot(n, relative),
            "sliding_speed": dot(tangent(n), relative),
            "friction": contacts.friction[p],
            "new": float(contacts.age[p] == 0),
        }
        for c, code in enumerate(channel):
            value[p, c] = attributes[_CONTACT[int(code)]]


def direction_bin(n: Array, bins: int) -> int:
    """Bin of the direction modulo pi, the first centred on the x axis."""
    turn = np.arctan2(float(n[1]), float(n[0])) % np.pi / np.pi
    return int(turn * bins + 0.5) % bins


def add_walls(tid: int, world_offset: int, walls: Any, image: Array) -> None:
    """Add the walls' value to their nodes, on top of what bodies added."""
    w = tid + world_offset
    mine = slice(walls.start[w], walls.start[w + 1])
    image[w, walls.channel, walls.row[mine], walls.column[mine]] += image.dtype.type(walls.value)
