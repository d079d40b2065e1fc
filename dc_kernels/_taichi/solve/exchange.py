"""A stranger's bodies and contacts into the solver's arrays, looked at on the way, and what was solved back to them."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types, struct_type
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import Either, kernel
from dc_kernels.model.enums import BodyType, Flag
from dc_kernels.model.rules import INVERSE
from dc_kernels.solve.exchange import ARM, EXCHANGE, UNIT

STATIC, DYNAMIC = int(BodyType.STATIC), int(BodyType.DYNAMIC)
CONTACT_OVERFLOW, NONFINITE, INVALID = int(Flag.CONTACT_OVERFLOW), int(Flag.NONFINITE), int(Flag.INVALID)
LARGEST = INVERSE.high
INFINITY = float("inf")


@ti.func
def are_two_bodies(a, b, first, last):
    """Whether a and b are two bodies of the world."""
    return a != b and first <= a < last and first <= b < last


@ti.func
def is_finite(v):
    """Whether a number, or the sum of some, is finite: x - x is 0 for a finite x, NaN for inf and NaN."""
    return v - v == 0.0


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``receive_contacts``, ``receive_velocities`` and ``send``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Exchange = struct_type("exchange", dtype, EXCHANGE)

    @ti.func
    def is_finite_pair(v):
        return is_finite(v[0]) and is_finite(v[1])

    @ti.func
    def look_at_bodies(first, last, model: t.Model):
        """How many of a world's bodies have masses out of range; which of them contacts move."""
        bad = 0
        for b in range(first, last):
            mass = model.inv_mass[b]
            inertia = model.inv_inertia[b]
            if not (0.0 <= mass <= LARGEST and 0.0 <= inertia <= LARGEST):  # NaN compares with nothing
                bad += 1
            model.body_type[b] = ti.select(mass > 0.0 or inertia > 0.0, DYNAMIC, STATIC)
        return bad

    @ti.func
    def look_at_joints(w, first, last, model: t.Model, state: t.State, joints: t.Joints):
        """How many joints of a world are out of range, or its bodies, where it has joints."""
        bad = 0
        begin = model.joint_start[w]
        end = model.joint_start[w + 1]
        for j in range(begin, end):
            length = joints.joint_length[j]
            good = are_two_bodies(joints.joint_body_a[j], joints.joint_body_b[j], first, last)
            good = good and is_finite_pair(joints.joint_anchor_a[j]) and is_finite_pair(joints.joint_anchor_b[j])
            if not (good and is_finite(length) and length > 0.0):
                bad += 1
        if begin < end:
            for b in range(first, last):
                if not (is_finite_pair(state.position[b]) and is_finite(state.angle[b])):
                    bad += 1
        return bad

    @ti.func
    def look_at_rows(w, first, last, rows: t.Rows):
        """How many of a caller's own rows of a world are out of range; their bounds may be infinite."""
        bad = 0
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            good = are_two_bodies(rows.row_body_a[k], rows.row_body_b[k], first, last)
            for c in ti.static(range(3)):
                good = good and is_finite(rows.row_jacobian_a[k, c]) and is_finite(rows.row_jacobian_b[k, c])
            soft = rows.row_softness[k]
            good = good and is_finite(rows.row_bias[k]) and is_finite(soft) and soft >= 0.0
            lower = rows.row_lower[k]
            upper = rows.row_upper[k]
            if not (good and lower <= upper and lower < INFINITY and upper > -INFINITY):
                bad += 1
        return bad

    @ti.func
    def is_bent(arm, normal):
        """Whether an arm has more beside the normal than what round-off leaves."""
        bend = arm[0] * normal[1] - arm[1] * normal[0]
        return bend * bend > ARM * ARM * (arm[0] * arm[0] + arm[1] * arm[1])

    @ti.func
    def is_good(i, discs, model: t.Model, contacts: t.Contacts):
        """Whether a contact of two bodies of its world is in range."""
        p = contacts.arm_a[i]
        q = contacts.arm_b[i]
        n = contacts.normal[i]
        mu = contacts.friction[i]
        e = contacts.restitution[i]
        off = n[0] * n[0] + n[1] * n[1] - 1.0
        good = is_finite_pair(p) and is_finite_pair(q) and is_finite(contacts.gap[i]) and is_finite(mu)
        good = good and off >= -UNIT and off <= UNIT and mu >= 0.0 and e >= 0.0 and e <= 1.0
        if discs != 0:
            # the arm of a body that nothing turns may be any, as that of the ground is
            good = good and not (model.inv_inertia[contacts.body_a[i]] > 0.0 and is_bent(p, n))
            good = good and not (model.inv_inertia[contacts.body_b[i]] > 0.0 and is_bent(q, n))
        return good

    def receiver(points: bool) -> Any:
        """``receive_contacts`` of contacts that come with points, or with arms, which may be read-only."""

        @ti.func
        def look_at_contacts(
            discs, begin, end, first, last, model: t.Model, state: t.State, contacts: t.Contacts, exchange: Exchange
        ):
            """How many contacts of a world are out of range; their arms and kept colours are taken."""
            bad = 0
            for i in range(begin, end):
                if not are_two_bodies(contacts.body_a[i], contacts.body_b[i], first, last):
                    bad += 1
            if bad == 0:
                keeps = exchange.color.shape[0] > 0
                for i in range(begin, end):
                    color = -1
                    if keeps:
                        color = exchange.color[i]
                    contacts.color[i] = color
                    if ti.static(points):
                        at = exchange.point[i]
                        contacts.arm_a[i] = at - state.position[contacts.body_a[i]]
                        contacts.arm_b[i] = at - state.position[contacts.body_b[i]]
                    if not is_good(i, discs, model, contacts):
                        bad += 1
            return bad

        @kernel
        def receive_contacts(
            tid,
            launch: t.Launch,
            discs: ti.i32,
            model: t.Model,
            state: t.State,
            joints: t.Joints,
            contacts: t.Contacts,
            rows: t.Rows,
            exchange: Exchange,
        ):
            """Masses, joints, rows, contacts of a world as they stand; a flag, no contact, where one is out of range.

            Arms are made of points where there are some. Without kept colours all contacts are to be coloured.
            """
            w = tid + launch.world_offset
            first = model.body_start[w]
            last = model.body_start[w + 1]
            begin = contacts.contact_start[w]
            count = exchange.count[w]
            flag = 0
            taken = 0
            if count < 0 or count > contacts.contact_start[w + 1] - begin:
                flag = CONTACT_OVERFLOW
            else:
                end = begin + count
                bad = look_at_bodies(first, last, model)
                bad += look_at_joints(w, first, last, model, state, joints)
                bad += look_at_rows(w, first, last, rows)
                bad += look_at_contacts(discs, begin, end, first, last, model, state, contacts, exchange)
                if bad > 0:
                    flag = INVALID
                else:
                    taken = count
            state.flags[w] = flag
            contacts.contact_count[w] = taken

        return receive_contacts

    @kernel
    def receive_velocities(
        tid,
        launch: t.Launch,
        kept: ti.i32,
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
        w = tid + launch.world_offset
        if (state.flags[w] & ~NONFINITE) == 0:
            check = real(0.0)  # x - x is 0 for a finite x, NaN for inf and NaN
            before = exchange.velocity_before.shape[0] > 0
            for b in range(model.body_start[w], model.body_start[w + 1]):
                v = exchange.velocity[b]
                spin = exchange.angular_velocity[b]
                mass = motion.predicted[b][3]
                if kept == 0:
                    mass = model.inv_mass[b]
                motion.predicted[b] = vec4(v[0], v[1], spin, mass)
                check += (v[0] - v[0]) + (v[1] - v[1]) + (spin - spin)
                if before:
                    v = exchange.velocity_before[b]
                    spin = exchange.angular_velocity_before[b]
                    check += (v[0] - v[0]) + (v[1] - v[1]) + (spin - spin)
                state.velocity[b] = v
                state.angular_velocity[b] = spin
            begin = contacts.contact_start[w]
            for i in range(begin, begin + contacts.contact_count[w]):
                start = exchange.impulse[i]
                contacts.impulse[i] = start
                check += (start[0] - start[0]) + (start[1] - start[1])
            for j in range(model.joint_start[w], model.joint_start[w + 1]):
                along = joints.joint_impulse[j]
                check += along - along
            for k in range(rows.row_start[w], rows.row_start[w + 1]):
                along = rows.row_impulse[k]
                check += along - along
            flag = 0
            if not (check == 0.0):
                flag = NONFINITE
                if kept == 0:
                    flag = NONFINITE | INVALID  # there are no rows of these contacts to go on from
            state.flags[w] = flag

    @kernel
    def send(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        exchange: Exchange,
    ):
        """Solved velocities, impulses, colours of a world to where they came from; nothing but a flag if not finite."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            first = model.body_start[w]
            last = model.body_start[w + 1]
            check = real(0.0)
            for b in range(first, last):
                v = motion.solved[b]
                check += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2])
            if check == 0.0:
                for b in range(first, last):
                    v = motion.solved[b]
                    exchange.velocity[b] = vec2(v[0], v[1])
                    exchange.angular_velocity[b] = v[2]
                begin = contacts.contact_start[w]
                end = begin + contacts.contact_count[w]
                for i in range(begin, end):
                    exchange.impulse[i] = contacts.impulse[i]
                if exchange.color.shape[0] > 0:
                    for i in range(begin, end):
                        exchange.color[i] = contacts.color[i]
            else:
                state.flags[w] = NONFINITE

    receive_contacts = Either(lambda values: bool(len(values["exchange"].point)), receiver(True), receiver(False))
    return {"receive_contacts": receive_contacts, "receive_velocities": receive_velocities, "send": send}
