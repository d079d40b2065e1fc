"""A stranger's bodies and contacts into the solver's arrays, looked at on the way, and what was solved back to them."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguity, contiguous_groups, group_types, struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import BodyType, Flag
from dc_kernels.model.rules import INVERSE
from dc_kernels.solve.exchange import ARM, EXCHANGE, UNIT
from dc_kernels.solve.rows import LANES

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
    real, vec2 = t.real, t.vec2
    Exchange = struct_type("exchange", dtype, EXCHANGE)
    module = kernel_module("exchange", dtype)
    infinity = real(float("inf"))
    contiguous = contiguous_groups(dtype)
    limits = {"UNIT": UNIT, "ARM": ARM}
    kinds = {"FIXED": int(BodyType.STATIC), "MOVABLE": int(BodyType.DYNAMIC), "LARGEST": INVERSE.high}

    @wp.func_native(native_code("exchange/bodies.h", dtype=dtype, **kinds))
    def look_at_bodies(
        inv_mass: wp.array(dtype=real),
        inv_inertia: wp.array(dtype=real),
        body_type: wp.array(dtype=wp.int32),
        b0: wp.int32,
        b1: wp.int32,
    ) -> wp.int32: ...

    @wp.func_native(native_code("prelude.h", "exchange/contacts.h", dtype=dtype, LANES=LANES, **limits))
    def look_at_contacts(
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

    @wp.func_native(native_code("exchange/velocities.h", dtype=dtype))
    def take_velocities(
        kept: wp.int32,
        given: Exchange,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        b0: wp.int32,
        b1: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
    ) -> wp.int32: ...

    @wp.func_native(native_code("exchange/send.h", dtype=dtype))
    def give_back(
        taken: Exchange,
        motion: t.Motion,
        contacts: t.Contacts,
        b0: wp.int32,
        b1: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
    ) -> wp.int32: ...

    @wp.func_native(contiguity(EXCHANGE))
    def contiguous_exchange(group: Exchange): ...

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

    @wp.func(module=module)
    def receive_rows(w: int, first: int, last: int, rows: t.Rows):
        """1 where a caller's own rows are out of range; their bounds may be infinite."""
        bad = int(0)
        check = real(0.0)
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            a = rows.row_body_a[k]
            b = rows.row_body_b[k]
            if a == b or is_body(a, first, last) == 0 or is_body(b, first, last) == 0:
                bad = 1
            ja = rows.row_jacobian_a[k]
            jb = rows.row_jacobian_b[k]
            check += (ja[0] - ja[0]) + (ja[1] - ja[1]) + (ja[2] - ja[2])
            check += (jb[0] - jb[0]) + (jb[1] - jb[1]) + (jb[2] - jb[2])
            soft = rows.row_softness[k]
            check += (rows.row_bias[k] - rows.row_bias[k]) + (soft - soft)
            ordered = rows.row_lower[k] <= rows.row_upper[k]
            some = rows.row_lower[k] < infinity and rows.row_upper[k] > -infinity
            if soft < real(0.0) or not ordered or not some:
                bad = 1
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
        rows: t.Rows,
        exchange: Exchange,
    ):
        """Masses, joints, rows, contacts of a world as they now stand; a flag, no contact, where one is out of range.

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
        bad = look_at_bodies(model.inv_mass, model.inv_inertia, model.body_type, first, last)
        bad += receive_joints(w, first, last, model, state, joints)
        bad += receive_rows(w, first, last, rows)
        end = start + n_contacts
        bad += look_at_contacts(
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
        rows: t.Rows,
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
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        first = model.body_start[w]
        last = model.body_start[w + 1]
        bad = take_velocities(kept, exchange, model, state, motion, contacts, first, last, start, end)
        check = real(0.0)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            along = joints.joint_impulse[j]
            check += along - along
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            along = rows.row_impulse[k]
            check += along - along
        if bad > 0 or check != real(0.0):
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
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        first = model.body_start[w]
        last = model.body_start[w + 1]
        if give_back(exchange, motion, contacts, first, last, start, end) > 0:
            state.flags[w] = NONFINITE

    return {"receive_contacts": receive_contacts, "receive_velocities": receive_velocities, "send": send}
