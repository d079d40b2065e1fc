"""Semi-implicit Euler (Wu 2018, chapter 2.1): velocities before the contacts, positions after them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import BodyType, Flag


def kernels(dtype: str, traits: bool = False) -> Kernels:
    """``predict``, ``displace`` and ``commit``; ``traits``: bodies have damping, gravity scales."""
    return {"predict": predict_with_traits if traits else predict, "displace": displace, "commit": commit}


def predict(
    tid: int,
    launch: Any,
    config: Any,
    model: Any,
    state: Any,
    motion: Any,
) -> None:
    """Velocities with forces and gravity applied, with the inverse mass; what the fastest body covers in the step."""
    _predict(tid, launch, config, model, state, motion, forced)


def predict_with_traits(tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any) -> None:
    """See ``predict``; bodies have damping and gravity scales."""
    _predict(tid, launch, config, model, state, motion, damped)


def forced(w: int, b: int, model: Any, state: Any, dt: Any) -> list[Any]:
    """Velocity and spin of a dynamic body after a step's forces."""
    v = state.velocity[b] + (model.gravity[w] + state.force[b] * model.inv_mass[b]) * dt
    return [*v, state.angular_velocity[b] + state.torque[b] * model.inv_inertia[b] * dt]


def damped(w: int, b: int, model: Any, state: Any, dt: Any) -> list[Any]:
    """The exact solution of dv/dt = a - rate v for velocity and spin of a dynamic body after a step of constant a."""

    def after(v: Any, a: Any, rate: Any) -> Any:
        x = rate * dt
        return v * np.exp(-x) + a * (dt * (-np.expm1(-x) / x if x > 0 else x.dtype.type(1)))

    v = after(
        state.velocity[b],
        model.gravity[w] * model.gravity_scale[b] + state.force[b] * model.inv_mass[b],
        model.linear_damping[b],
    )
    return [*v, after(state.angular_velocity[b], state.torque[b] * model.inv_inertia[b], model.angular_damping[b])]


def _predict(
    tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, after: Callable[..., list[Any]]
) -> None:
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    dt = motion.step_dt[w]
    bodies = range(model.body_start[w], model.body_start[w + 1])
    with np.errstate(over="ignore", invalid="ignore"):
        for b in bodies:
            if model.body_type[b] == BodyType.STATIC:
                motion.predicted[b] = 0.0
            elif model.body_type[b] == BodyType.KINEMATIC:
                motion.predicted[b] = [*state.velocity[b], state.angular_velocity[b], 0.0]
            else:
                motion.predicted[b] = [*after(w, b, model, state, dt), model.inv_mass[b]]
        squares = (motion.predicted[bodies, :2] ** 2).sum(axis=1)
        dynamic = model.body_type[bodies] == BodyType.DYNAMIC
        most = (
            min(squares.max(initial=0.0), 16.0 * squares[dynamic].mean()) if dynamic.any() else squares.max(initial=0.0)
        )
        fastest = np.sqrt(most)  # of any body, but no more than four times the root mean square
    own = (motion.predicted[bodies, :3], state.velocity[bodies], state.angular_velocity[bodies])
    if not all(np.isfinite(values).all() for values in (*own, state.time[w], model.origin[w])):
        state.flags[w] = Flag.NONFINITE
        return
    motion.reach[w] = max(
        min(fastest * dt, config.speculative_max * model.length_scale[w]), config.speculative * model.length_scale[w]
    )


def displace(
    tid: int,
    launch: Any,
    model: Any,
    state: Any,
    motion: Any,
) -> None:
    """What the solved velocities move the bodies by in this step; position correction adds to it."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    for b in range(model.body_start[w], model.body_start[w + 1]):
        motion.displacement[b, :3] = motion.solved[b, :3] * motion.step_dt[w]
        motion.displacement[b, 3] = motion.solved[b, 3]


def commit(
    tid: int,
    launch: Any,
    model: Any,
    state: Any,
    joints: Any,
    motion: Any,
    contacts: Any,
    cache: Any,
) -> None:
    """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    bodies = np.arange(model.body_start[w], model.body_start[w + 1])
    with np.errstate(over="ignore", invalid="ignore"):
        new_position = state.position[bodies] + motion.displacement[bodies, :2]
        new_angle = state.angle[bodies] + motion.displacement[bodies, 2]
    new: tuple[Any, ...] = (new_position, new_angle, motion.solved[bodies, :3])
    if not all(np.isfinite(values).all() for values in new):
        state.flags[w] = Flag.NONFINITE
        return
    moves = model.body_type[bodies] != BodyType.STATIC
    state.position[bodies[moves]] = new_position[moves]
    state.angle[bodies[moves]] = new_angle[moves]
    state.velocity[bodies[moves]] = motion.solved[bodies[moves], :2]
    state.angular_velocity[bodies[moves]] = motion.solved[bodies[moves], 2]
    state.time[w] += float(motion.step_dt[w])
    used = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    cache.key[used] = contacts.key[used]
    cache.impulse[used] = contacts.impulse[used]
    cache.color[used] = contacts.color[used]
    cache.age[used] = contacts.age[used]
    cache.count[w] = contacts.contact_count[w]
    own_joints = slice(*joints.joint_row_start[model.joint_start[w : w + 2]])
    cache.joint_impulse[own_joints] = joints.joint_impulse[own_joints]
    contacts.contact_dt[w] = motion.step_dt[w]
