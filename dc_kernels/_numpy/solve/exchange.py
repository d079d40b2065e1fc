"""A stranger's bodies and contacts into the solver's arrays, looked at on the way, and what was solved back to them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import BodyType, Flag
from dc_kernels.model.rules import INVERSE
from dc_kernels.solve.exchange import ARM, UNIT


def kernels(dtype: str) -> Kernels:
    """``receive_contacts``, ``receive_velocities`` and ``send``; the arrays bring their scalar type."""
    return {"receive_contacts": receive_contacts, "receive_velocities": receive_velocities, "send": send}


def receive_contacts(
    tid: int, launch: Any, discs: int, model: Any, state: Any, joints: Any, contacts: Any, rows: Any, exchange: Any
) -> None:
    """Masses, joints, rows, contacts of a world as they now stand; a flag, no contact, where one is out of range."""
    w = tid + launch.world_offset
    first, last = model.body_start[w], model.body_start[w + 1]
    start, count = contacts.contact_start[w], exchange.count[w]
    state.flags[w] = contacts.contact_count[w] = 0
    if not 0 <= count <= contacts.contact_start[w + 1] - start:
        state.flags[w] = Flag.CONTACT_OVERFLOW
        return
    state.flags[w] = Flag.INVALID
    bodies, own = slice(first, last), slice(start, start + count)
    lines = slice(model.joint_start[w], model.joint_start[w + 1])
    extra = slice(rows.row_start[w], rows.row_start[w + 1])
    m, i = model.inv_mass[bodies], model.inv_inertia[bodies]
    model.body_type[bodies] = np.where((m > 0) | (i > 0), BodyType.DYNAMIC, BodyType.STATIC)
    good = [m >= 0, i >= 0, m <= INVERSE.high, i <= INVERSE.high]
    for a, b in (
        (contacts.body_a[own], contacts.body_b[own]),
        (joints.joint_body_a[lines], joints.joint_body_b[lines]),
        (rows.row_body_a[extra], rows.row_body_b[extra]),
    ):
        if not ((a != b) & (a >= first) & (a < last) & (b >= first) & (b < last)).all():
            return
    if lines.stop > lines.start:
        finite = (joints.joint_anchor_a[lines], joints.joint_anchor_b[lines], joints.joint_length[lines])
        good += [np.isfinite(x) for x in (*finite, state.position[bodies], state.angle[bodies])]
        good.append(joints.joint_length[lines] > 0)
    lower, upper = rows.row_lower[extra], rows.row_upper[extra]
    finite = (rows.row_jacobian_a, rows.row_jacobian_b, rows.row_bias, rows.row_softness)
    good += [np.isfinite(x[extra]) for x in finite]
    good += [rows.row_softness[extra] >= 0, lower <= upper, lower < np.inf, upper > -np.inf]
    a, b, n = contacts.body_a[own], contacts.body_b[own], contacts.normal[own]
    if len(exchange.point):
        contacts.arm_a[own] = exchange.point[own] - state.position[a]
        contacts.arm_b[own] = exchange.point[own] - state.position[b]
    arms = contacts.arm_a[own], contacts.arm_b[own]
    mu, e = contacts.friction[own], contacts.restitution[own]
    good += [np.isfinite(x) for x in (*arms, contacts.gap[own], mu)]
    good += [np.abs((n * n).sum(axis=1) - 1) <= UNIT, mu >= 0, (e >= 0) & (e <= 1)]
    if discs:
        for arm, body in zip(arms, (a, b)):
            bend = np.abs(arm[:, 0] * n[:, 1] - arm[:, 1] * n[:, 0])
            good.append((model.inv_inertia[body] == 0) | (bend <= ARM * np.linalg.norm(arm, axis=1)))
    contacts.color[own] = exchange.color[own] if len(exchange.color) else -1
    if all(values.all() for values in good):
        state.flags[w] = 0
        contacts.contact_count[w] = count


def receive_velocities(
    tid: int,
    launch: Any,
    kept: int,
    model: Any,
    state: Any,
    joints: Any,
    motion: Any,
    contacts: Any,
    rows: Any,
    exchange: Any,
) -> None:
    """Velocities and start impulses of a world; a flag where any is not finite."""
    w = tid + launch.world_offset
    if state.flags[w] & ~Flag.NONFINITE:
        return
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    own = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    lines = slice(model.joint_start[w], model.joint_start[w + 1])
    motion.predicted[bodies, :2] = exchange.velocity[bodies]
    motion.predicted[bodies, 2] = exchange.angular_velocity[bodies]
    if not kept:
        motion.predicted[bodies, 3] = model.inv_mass[bodies]
    before = (
        (exchange.velocity_before, exchange.angular_velocity_before)
        if len(exchange.velocity_before)
        else (exchange.velocity, exchange.angular_velocity)
    )
    state.velocity[bodies], state.angular_velocity[bodies] = (x[bodies] for x in before)
    contacts.impulse[own] = exchange.impulse[own]
    extra = slice(rows.row_start[w], rows.row_start[w + 1])
    starts = (contacts.impulse[own], joints.joint_impulse[lines], rows.row_impulse[extra])
    given = (motion.predicted[bodies], *(x[bodies] for x in before), *starts)
    state.flags[w] = 0
    if not all(np.isfinite(values).all() for values in given):
        state.flags[w] = Flag.NONFINITE if kept else Flag.NONFINITE | Flag.INVALID


def send(tid: int, launch: Any, model: Any, state: Any, motion: Any, contacts: Any, exchange: Any) -> None:
    """Solved velocities, impulses, colours of a world to where they came from; nothing but a flag if not finite."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    if not np.isfinite(motion.solved[bodies, :3]).all():
        state.flags[w] = Flag.NONFINITE
        return
    exchange.velocity[bodies] = motion.solved[bodies, :2]
    exchange.angular_velocity[bodies] = motion.solved[bodies, 2]
    own = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    exchange.impulse[own] = contacts.impulse[own]
    if len(exchange.color):
        exchange.color[own] = contacts.color[own]
