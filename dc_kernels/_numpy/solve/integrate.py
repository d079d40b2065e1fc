"""Semi-implicit Euler (seed, chapter 2.1): velocities before the contacts, positions after them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels.model.enums import BodyType, Flag


def kernels(dtype: str) -> Kernels:
    """``predict``, ``displace`` and ``commit``; the arrays bring their scalar type."""
    return {"predict": predict, "displace": displace, "commit": commit}


def predict(
    tid: int,
    world_offset: int,
    speculative_factor: float,
    speculative_limit: float,
    body_start: Array,
    length_scale: Array,
    gravity: Array,
    body_type: Array,
    inv_mass: Array,
    inv_inertia: Array,
    velocity: Array,
    angular_velocity: Array,
    force: Array,
    torque: Array,
    step_dt: Array,
    flags: Array,
    predicted: Array,
    reach: Array,
) -> None:
    """Velocities with forces and gravity applied, with the inverse mass; what the fastest body covers in the step."""
    w = tid + world_offset
    if flags[w]:
        return
    dt = step_dt[w]
    bodies = range(body_start[w], body_start[w + 1])
    with np.errstate(over="ignore", invalid="ignore"):
        for b in bodies:
            if body_type[b] == BodyType.STATIC:
                predicted[b] = 0.0
            elif body_type[b] == BodyType.KINEMATIC:
                predicted[b] = [*velocity[b], angular_velocity[b], 0.0]
            else:
                v = velocity[b] + (gravity[w] + force[b] * inv_mass[b]) * dt
                spin = angular_velocity[b] + torque[b] * inv_inertia[b] * dt
                predicted[b] = [*v, spin, inv_mass[b]]
        squares = (predicted[bodies, :2] ** 2).sum(axis=1)
        dynamic = body_type[bodies] == BodyType.DYNAMIC
        most = (
            min(squares.max(initial=0.0), 16.0 * squares[dynamic].mean()) if dynamic.any() else squares.max(initial=0.0)
        )
        fastest = np.sqrt(most)  # of any body, but no more than four times the root mean square
    if not np.isfinite(predicted[bodies, :3]).all():
        flags[w] = Flag.NONFINITE
        return
    reach[w] = max(min(fastest * dt, speculative_limit * length_scale[w]), speculative_factor * length_scale[w])


def displace(
    tid: int, world_offset: int, body_start: Array, flags: Array, step_dt: Array, solved: Array, displacement: Array
) -> None:
    """What the solved velocities move the bodies by in this step; position correction adds to it."""
    w = tid + world_offset
    if flags[w]:
        return
    for b in range(body_start[w], body_start[w + 1]):
        displacement[b, :3] = solved[b, :3] * step_dt[w]
        displacement[b, 3] = solved[b, 3]


def commit(
    tid: int,
    world_offset: int,
    body_start: Array,
    body_type: Array,
    step_dt: Array,
    solved: Array,
    displacement: Array,
    position: Array,
    angle: Array,
    velocity: Array,
    angular_velocity: Array,
    time: Array,
    flags: Array,
    contact_start: Array,
    contact_count: Array,
    key: Array,
    impulse: Array,
    color: Array,
    age: Array,
    joint_start: Array,
    joint_impulse: Array,
    contact_dt: Array,
    cache_count: Array,
    cache_key: Array,
    cache_impulse: Array,
    cache_color: Array,
    cache_age: Array,
    joint_cache: Array,
) -> None:
    """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
    w = tid + world_offset
    if flags[w]:
        return
    bodies = np.arange(body_start[w], body_start[w + 1])
    with np.errstate(over="ignore", invalid="ignore"):
        new_position = position[bodies] + displacement[bodies, :2]
        new_angle = angle[bodies] + displacement[bodies, 2]
    new: tuple[Any, ...] = (new_position, new_angle, solved[bodies, :3])
    if not all(np.isfinite(values).all() for values in new):
        flags[w] = Flag.NONFINITE
        return
    moves = body_type[bodies] != BodyType.STATIC
    position[bodies[moves]] = new_position[moves]
    angle[bodies[moves]] = new_angle[moves]
    velocity[bodies[moves]] = solved[bodies[moves], :2]
    angular_velocity[bodies[moves]] = solved[bodies[moves], 2]
    time[w] += float(step_dt[w])
    used = slice(contact_start[w], contact_start[w] + contact_count[w])
    cache_key[used] = key[used]
    cache_impulse[used] = impulse[used]
    cache_color[used] = color[used]
    cache_age[used] = age[used]
    cache_count[w] = contact_count[w]
    joints = slice(joint_start[w], joint_start[w + 1])
    joint_cache[joints] = joint_impulse[joints]
    contact_dt[w] = step_dt[w]
