"""What bodies and contacts show on an image: places and values of the points that are splatted."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot, rotate, rotation, tangent
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS

_BODY = {channel.code: name for name, channel in BODY_CHANNELS.items()}
_CONTACT = {channel.code: name for name, channel in CONTACT_CHANNELS.items()}


def kernels(dtype: str) -> Kernels:
    """``body_features``, ``contact_features``, ``mark_walls``, ``add_walls``; the arrays bring their scalar type."""
    return {
        "body_features": body_features,
        "contact_features": contact_features,
        "mark_walls": mark_walls,
        "add_walls": add_walls,
    }


def body_features(
    tid: int,
    world_offset: int,
    area: int,
    body_channel: Array,
    flags: Array,
    area_start: Array,
    area_body: Array,
    area_point: Array,
    area_weight: Array,
    mass: Array,
    inertia: Array,
    position: Array,
    angle: Array,
    velocity: Array,
    angular_velocity: Array,
    point_count: Array,
    point: Array,
    value: Array,
) -> None:
    """Points at position + R(angle) area_point with area_weight times the body's value; none in a flagged world."""
    w = tid + world_offset
    point_count[w] = 0 if flags[w] else area_start[w + 1] - area_start[w]
    for p in range(area_start[w], area_start[w] + point_count[w]):
        b = area_body[p]
        point[p] = position[b] + (rotate(rotation(angle[b]), area_point[p]) if area else 0)
        attributes = {
            "mass": mass[b],
            "inertia": inertia[b],
            "velocity_x": velocity[b, 0],
            "velocity_y": velocity[b, 1],
            "omega": angular_velocity[b],
            "angle_cos": np.cos(angle[b]),
            "angle_sin": np.sin(angle[b]),
            "speed": np.hypot(*velocity[b]),
        }
        for c, code in enumerate(body_channel):
            value[p, c] = attributes[_BODY[int(code)]] * (area_weight[p] if area else 1)


def contact_features(
    tid: int,
    world_offset: int,
    bins: int,
    contact_channel: Array,
    flags: Array,
    contact_start: Array,
    contact_count: Array,
    body_a: Array,
    body_b: Array,
    normal: Array,
    arm_a: Array,
    arm_b: Array,
    gap: Array,
    friction: Array,
    impulse: Array,
    age: Array,
    position: Array,
    velocity: Array,
    angular_velocity: Array,
    point_count: Array,
    point: Array,
    point_bin: Array,
    value: Array,
) -> None:
    """Points at position[body_a] + arm_a with the contacts' values; none in a flagged world."""
    w = tid + world_offset
    point_count[w] = 0 if flags[w] else contact_count[w]

    def speed(body: int, arm: Array) -> Any:
        return velocity[body] + angular_velocity[body] * np.array([-arm[1], arm[0]])

    for p in range(contact_start[w], contact_start[w] + point_count[w]):
        a, b, n = body_a[p], body_b[p], normal[p]
        point[p] = position[a] + arm_a[p]
        if bins > 1:
            point_bin[p] = direction_bin(n, bins)
        relative = speed(b, arm_b[p]) - speed(a, arm_a[p])
        attributes = {
            "normal_x": n[0],
            "normal_y": n[1],
            "gap": gap[p],
            "impulse_n": impulse[p, 0],
            "impulse_t": impulse[p, 1],
            "closing_speed": -dot(n, relative),
            "sliding_speed": dot(tangent(n), relative),
            "friction": friction[p],
            "new": float(age[p] == 0),
        }
        for c, code in enumerate(contact_channel):
            value[p, c] = attributes[_CONTACT[int(code)]]


def direction_bin(n: Array, bins: int) -> int:
    """Bin of the direction modulo pi, the first centred on the x axis."""
    turn = np.arctan2(float(n[1]), float(n[0])) % np.pi / np.pi
    return int(turn * bins + 0.5) % bins


def mark_walls(tid: int, world_offset: int, wall_band: Array, touched: Array) -> None:
    """Bands with walls are cleared by the splat that follows, so that each gets its walls once."""
    touched[tid + world_offset] |= wall_band[tid + world_offset]


def add_walls(
    tid: int,
    world_offset: int,
    wall_value: Any,
    wall_channel: int,
    wall_start: Array,
    wall_row: Array,
    wall_column: Array,
    image: Array,
) -> None:
    """The walls' value on their nodes, on top of what bodies added."""
    w = tid + world_offset
    mine = slice(wall_start[w], wall_start[w + 1])
    image[w, wall_channel, wall_row[mine], wall_column[mine]] += image.dtype.type(wall_value)
