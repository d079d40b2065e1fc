"""A stranger's bodies and contacts into the solver's arrays, looked at on the way, and what was solved back to them."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguity, contiguous_groups, group_types, struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import BodyType, Flag
from dc_kernels.solve.exchange import ARM, EXCHANGE, UNIT

STATIC = wp.constant(int(BodyType.STATIC))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))
NONFINITE = wp.constant(int(Flag.NONFINITE))
INVALID = wp.constant(int(Flag.INVALID))


@wp.func
def is_body(b: int, first: int, last: int):
    """1 for a body of the world."""
    if b >= first and b < last:
        return 1
    return 0


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``receive_contacts``, ``receive_velocities`` and ``send``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Exchange = struct_type("exchange", dtype, EXCHANGE)
    module = kernel_module("exchange", dtype)
    contiguous = contiguous_groups(dtype)
    code = native_code("solve/receive.h", dtype=dtype, UNIT=UNIT, ARM=ARM)

    @wp.func_native(code)
    def look_at(
        contacts: t.Contacts,
        point: wp.array(dtype=vec2),
        kept: wp.array(dtype=wp.int32),
        position: wp.array(dtype=vec2),
        inv_inertia: wp.array(dtype=real),
        discs: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        b0: wp.int32,
        b1: wp.int32,
    ) -> wp.int32: ...

    @wp.func_native(contiguity(EXCHANGE))
    def contiguous_exchange(group: Exchange): ...

    @wp.func(module=module)
    def receive_bodies(first: int, last: int, model: t.Model):
        """Which bodies contacts move; 1 where masses are out of range."""
        bad = int(0)
        check = real(0.0)
        for b in range(first, last):
            m = model.inv_mass[b]
            i = model.inv_inertia[b]
            check += (m - m) + (i - i)
            if m < real(0.0) or i < real(0.0):
                bad = 1
            model.body_type[b] = STATIC
            if m > real(0.0) or i > real(0.0):
                model.body_type[b] = DYNAMIC
        if check != real(0.0):
            bad = 1
        return bad

    @wp.func(module=module)
    def receive_joints(w: int, first: int, last: int, model: t.Model, state: t.State, joints: t.Joints):
        """1 where joints are out of range."""
        bad = int(0)
        check = real(0.0)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            if a == b or is_body(a, first, last) == 0 or is_body(b, first, last) == 0:
                bad = 1
            ra = joints.joint_anchor_a[j]
            rb = joints.joint_anchor_b[j]
            length = joints.joint_length[j]
            check += (ra[0] - ra[0]) + (ra[1] - ra[1]) + (rb[0] - rb[0]) + (rb[1] - rb[1]) + (length - length)
            if length <= real(0.0):
                bad = 1
        if model.joint_start[w] < model.joint_start[w + 1]:
            for b in range(first, last):
                x = state.position[b]
                angle = state.angle[b]
                check += (x[0] - x[0]) + (x[1] - x[1]) + (angle - angle)
        if check != real(0.0):
            bad = 1
        return bad

    @wp.kernel(module=module, enable_backward=False)
    def receive_contacts(
        launch: t.Launch,
        discs: int,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        exchange: Exchange,
    ):
        """Masses, joints and contacts of a world as they now stand; a flag, and no contact, where any is out of range.

        Arms are made of points where there are some. Without kept colours all contacts are to be coloured.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous_exchange(exchange)
        first = model.body_start[w]
        last = model.body_start[w + 1]
        start = contacts.contact_start[w]
        n_contacts = exchange.count[w]
        state.flags[w] = 0
        contacts.contact_count[w] = 0
        if n_contacts < 0 or n_contacts > contacts.contact_start[w + 1] - start:
            state.flags[w] = CONTACT_OVERFLOW
            return
        bad = receive_bodies(first, last, model)
        bad += receive_joints(w, first, last, model, state, joints)
        end = start + n_contacts
        bad += look_at(
            contacts, exchange.point, exchange.color, state.position, model.inv_inertia, discs, start, end, first, last
        )
        if bad > 0:
            state.flags[w] = INVALID
            return
        contacts.contact_count[w] = n_contacts

    @wp.kernel(module=module, enable_backward=False)
    def receive_velocities(
        launch: t.Launch,
        kept: int,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        exchange: Exchange,
    ):
        """Velocities and start impulses of a world; a flag where any is not finite.

        With ``kept`` masses are those that the rows were made with.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous_exchange(exchange)
        if (state.flags[w] & ~NONFINITE) != 0:
            return
        state.flags[w] = 0
        before = exchange.velocity_before.shape[0] > 0
        check = real(0.0)
        for b in range(model.body_start[w], model.body_start[w + 1]):
            v = exchange.velocity[b]
            spin = exchange.angular_velocity[b]
            m = model.inv_mass[b]
            if kept == 1:
                m = motion.predicted[b][3]
            motion.predicted[b] = vec4(v[0], v[1], spin, m)
            check += (v[0] - v[0]) + (v[1] - v[1]) + (spin - spin)
            if before:
                v = exchange.velocity_before[b]
                spin = exchange.angular_velocity_before[b]
                check += (v[0] - v[0]) + (v[1] - v[1]) + (spin - spin)
            state.velocity[b] = v
            state.angular_velocity[b] = spin
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            x = exchange.impulse[c]
            contacts.impulse[c] = x
            check += (x[0] - x[0]) + (x[1] - x[1])
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            along = joints.joint_impulse[j]
            check += along - along
        if check != real(0.0):
            state.flags[w] = NONFINITE
            if kept == 0:
                state.flags[w] = NONFINITE | INVALID  # there are no rows of these contacts to go on from

    @wp.kernel(module=module, enable_backward=False)
    def send(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        exchange: Exchange,
    ):
        """Solved velocities, impulses, colours of a world to where they came from; nothing but a flag if not finite."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(contacts)
        contiguous_exchange(exchange)
        if state.flags[w] != 0:
            return
        check = real(0.0)
        for b in range(model.body_start[w], model.body_start[w + 1]):
            v = motion.solved[b]
            check += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2])
        if check != real(0.0):
            state.flags[w] = NONFINITE
            return
        for b in range(model.body_start[w], model.body_start[w + 1]):
            v = motion.solved[b]
            exchange.velocity[b] = vec2(v[0], v[1])
            exchange.angular_velocity[b] = v[2]
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            exchange.impulse[c] = contacts.impulse[c]
        if exchange.color.shape[0] > 0:
            for c in range(start, start + contacts.contact_count[w]):
                exchange.color[c] = contacts.color[c]

    return {"receive_contacts": receive_contacts, "receive_velocities": receive_velocities, "send": send}
