"""Plain sweeps over batches of contact problems, their adjoint, and products with the Jacobian; one thread a world.

The arithmetic is that of ``row.row_functions`` for general rows and omega = 1. Contacts are swept in index order, of
which nobody says that neighbours have no body in common, so a row holds all of a contact side by side instead of lanes.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, scalar_types, tangent

# columns of a row, 64 bytes in float32: normal; arms crossed with normal and tangent; inverse masses; inverse inertias
# times arms; effective masses; bias; friction
NX, NY, RAN, RBN, RAT, RBT, MA, MB, KAN, KBN, KAT, KBT, EN, ET, BIAS, MU = range(16)
# bits of the tape, what a row did in a sweep: its normal pressed, its tangent stopped at +mu n or at -mu n
PRESSING, UPPER, LOWER = (wp.constant(bit) for bit in (1, 2, 4))


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """The kernels by name."""
    t = scalar_types(dtype)
    real, vec2, vec3 = t.real, t.vec2, wp.types.vector(3, t.real)
    row_type = wp.types.vector(16, real)
    module = kernel_module("differentiable", dtype)

    @wp.func(module=module)
    def inverse(x: real):
        if x > real(0.0):
            return real(1.0) / x
        return real(0.0)

    @wp.func(module=module)
    def normal_speed(r: row_type, va: vec3, vb: vec3):
        return r[NX] * (vb[0] - va[0]) + r[NY] * (vb[1] - va[1]) + (r[RBN] * vb[2] - r[RAN] * va[2])

    @wp.func(module=module)
    def tangent_speed(r: row_type, va: vec3, vb: vec3):
        return r[NY] * (vb[0] - va[0]) - r[NX] * (vb[1] - va[1]) + (r[RBT] * vb[2] - r[RAT] * va[2])

    @wp.func(module=module)
    def moves(r: row_type, mass: int, normal_turn: int, tangent_turn: int):
        """Whether a row changes a body: a store to the ground, which many rows share, makes each wait for the last."""
        return r[mass] > real(0.0) or r[normal_turn] != real(0.0) or r[tangent_turn] != real(0.0)

    @wp.func(module=module)
    def push_a(r: row_type, v: vec3, n: real, t: real):
        """Velocity of body A after a normal and a tangential impulse."""
        px = r[NX] * n + r[NY] * t
        py = r[NY] * n - r[NX] * t
        return vec3(v[0] - r[MA] * px, v[1] - r[MA] * py, v[2] - (r[KAN] * n + r[KAT] * t))

    @wp.func(module=module)
    def push_b(r: row_type, v: vec3, n: real, t: real):
        """Velocity of body B after a normal and a tangential impulse."""
        px = r[NX] * n + r[NY] * t
        py = r[NY] * n - r[NX] * t
        return vec3(v[0] + r[MB] * px, v[1] + r[MB] * py, v[2] + (r[KBN] * n + r[KBT] * t))

    @wp.kernel(module=module, enable_backward=False)
    def pack_problem(
        world_offset: int,
        given_mass: int,
        contact_start: wp.array(dtype=wp.int32),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        friction: wp.array(dtype=real),
        bias: wp.array(dtype=real),
        inv_mass: wp.array(dtype=real),
        inv_inertia: wp.array(dtype=real),
        effective_mass: wp.array(dtype=vec2),
        # out:
        row: wp.array(dtype=row_type),
    ):
        """Rows of a world's contacts; effective masses 1 / (J M^-1 J^T) unless they are given."""
        w = wp.tid() + world_offset
        for c in range(contact_start[w], contact_start[w + 1]):
            a = body_a[c]
            b = body_b[c]
            ma = inv_mass[a]
            mb = inv_mass[b]
            ia = inv_inertia[a]
            ib = inv_inertia[b]
            n = normal[c]
            tan = tangent(n)
            ran = cross(arm_a[c], n)
            rbn = cross(arm_b[c], n)
            rat = cross(arm_a[c], tan)
            rbt = cross(arm_b[c], tan)
            en = inverse(ma + mb + ia * ran * ran + ib * rbn * rbn)
            et = inverse(ma + mb + ia * rat * rat + ib * rbt * rbt)
            if given_mass != 0:
                en = effective_mass[c][0]
                et = effective_mass[c][1]
            row[c] = row_type(
                n[0], n[1], ran, rbn, rat, rbt, ma, mb,
                ia * ran, ib * rbn, ia * rat, ib * rbt, en, et, bias[c], friction[c],
            )  # fmt: skip

    @wp.func(module=module)
    def push_world(
        w: int,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        impulse: wp.array(dtype=vec2),
        velocity: wp.array(dtype=vec3),
    ):
        for c in range(contact_start[w], contact_start[w + 1]):
            r = row[c]
            a = row_body[c][0]
            b = row_body[c][1]
            x = impulse[c]
            velocity[a] = push_a(r, velocity[a], x[0], x[1])
            velocity[b] = push_b(r, velocity[b], x[0], x[1])

    @wp.kernel(module=module, enable_backward=False)
    def push_impulses(
        world_offset: int,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        impulse: wp.array(dtype=vec2),
        # in, out:
        velocity: wp.array(dtype=vec3),
    ):
        """V += M^-1 J^T impulse (2.26)."""
        push_world(wp.tid() + world_offset, contact_start, row, row_body, impulse, velocity)

    @wp.kernel(module=module, enable_backward=False)
    def pull_velocities(
        world_offset: int,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        velocity: wp.array(dtype=vec3),
        # out:
        speed: wp.array(dtype=vec2),
    ):
        """J V: normal and tangential speed of each contact."""
        w = wp.tid() + world_offset
        for c in range(contact_start[w], contact_start[w + 1]):
            r = row[c]
            va = velocity[row_body[c][0]]
            vb = velocity[row_body[c][1]]
            speed[c] = vec2(normal_speed(r, va, vb), tangent_speed(r, va, vb))

    @wp.kernel(module=module, enable_backward=False)
    def step_problem(
        world_offset: int,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        impulse: wp.array(dtype=vec2),
        velocity: wp.array(dtype=vec3),
        # out:
        step: wp.array(dtype=vec2),
    ):
        """What each row alone would change its impulses by, all at the same velocities."""
        w = wp.tid() + world_offset
        for c in range(contact_start[w], contact_start[w + 1]):
            r = row[c]
            va = velocity[row_body[c][0]]
            vb = velocity[row_body[c][1]]
            x = impulse[c]
            n = wp.max(x[0] - r[EN] * (normal_speed(r, va, vb) + r[BIAS]), real(0.0))
            limit = r[MU] * n
            t = wp.min(wp.max(x[1] - r[ET] * tangent_speed(r, va, vb), -limit), limit)
            step[c] = vec2(n - x[0], t - x[1])

    @wp.kernel(module=module, enable_backward=False)
    def sweep_problem(
        world_offset: int,
        sweeps: int,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        # in, out:
        impulse: wp.array(dtype=vec2),
        velocity: wp.array(dtype=vec3),
        # out:
        change: wp.array(dtype=vec2),
        active: wp.array2d(dtype=wp.int8),
    ):
        """Projected Gauss-Seidel, normal before tangent, from ``velocity`` as predicted; ``active`` is the tape."""
        w = wp.tid() + world_offset
        none = real(0.0)
        push_world(w, contact_start, row, row_body, impulse, velocity)
        for k in range(sweeps):
            for c in range(contact_start[w], contact_start[w + 1]):
                r = row[c]
                a = row_body[c][0]
                b = row_body[c][1]
                va = velocity[a]
                vb = velocity[b]
                x = impulse[c]
                code = int(0)
                free_n = x[0] - r[EN] * (normal_speed(r, va, vb) + r[BIAS])
                if free_n > none:
                    code = PRESSING
                n = wp.max(free_n, none)
                va = push_a(r, va, n - x[0], none)
                vb = push_b(r, vb, n - x[0], none)
                limit = r[MU] * n
                free_t = x[1] - r[ET] * tangent_speed(r, va, vb)
                if free_t > limit:
                    code += UPPER
                if free_t < -limit:
                    code += LOWER
                t = wp.min(wp.max(free_t, -limit), limit)
                if moves(r, MA, KAN, KAT):
                    velocity[a] = push_a(r, va, none, t - x[1])
                if moves(r, MB, KBN, KBT):
                    velocity[b] = push_b(r, vb, none, t - x[1])
                impulse[c] = vec2(n, t)
                change[c] = vec2(n - x[0], t - x[1])
                active[k, c] = wp.int8(code)

    @wp.kernel(module=module, enable_backward=False)
    def pull_problem(
        world_offset: int,
        sweeps: int,
        leak: real,
        contact_start: wp.array(dtype=wp.int32),
        row: wp.array(dtype=row_type),
        row_body: wp.array(dtype=wp.vec2i),
        active: wp.array2d(dtype=wp.int8),
        by_change: wp.array(dtype=vec2),
        # in, out:
        by_velocity: wp.array(dtype=vec3),
        by_impulse: wp.array(dtype=vec2),
    ):
        """The adjoint of ``sweep_problem``: cotangents of its results become that of the impulses it began with.

        ``by_velocity`` holds M^-1 times the velocities' cotangent V~, which then follows the rows backwards by the
        forward functions: its part in an impulse is J M^-1 V~, and a speed's cotangent u changes it by M^-1 J^T u. A
        row that is stopped passes ``leak`` of what it would pass if it were not, and a tangent at its limit mu n also
        mu of it to its normal.
        """
        w = wp.tid() + world_offset
        first = contact_start[w]
        last = contact_start[w + 1]
        none = real(0.0)
        for back in range(sweeps):
            k = sweeps - 1 - back
            for i in range(last - first):
                c = last - 1 - i
                r = row[c]
                a = row_body[c][0]
                b = row_body[c][1]
                va = by_velocity[a]
                vb = by_velocity[b]
                y = by_impulse[c]
                z = vec2(none, none)
                if back == 0:
                    z = by_change[c]
                    y = y + z
                code = int(active[k, c])
                pull_t = tangent_speed(r, va, vb)
                y_t = y[1] + pull_t
                y_n = y[0]
                free_t = y_t
                if code >= UPPER:
                    free_t = leak * y_t
                    if code < LOWER:
                        y_n = y_n + r[MU] * y_t
                    else:
                        y_n = y_n - r[MU] * y_t
                va = push_a(r, va, none, -(r[ET] * free_t))
                vb = push_b(r, vb, none, -(r[ET] * free_t))
                pull_n = normal_speed(r, va, vb)
                free_n = y_n + pull_n
                if code % UPPER == 0:
                    free_n = leak * free_n
                if moves(r, MA, KAN, KAT):
                    by_velocity[a] = push_a(r, va, -(r[EN] * free_n), none)
                if moves(r, MB, KBN, KBT):
                    by_velocity[b] = push_b(r, vb, -(r[EN] * free_n), none)
                by_impulse[c] = vec2(free_n - pull_n - z[0], free_t - pull_t - z[1])
        for c in range(first, last):
            r = row[c]
            va = by_velocity[row_body[c][0]]
            vb = by_velocity[row_body[c][1]]
            by_impulse[c] = by_impulse[c] + vec2(normal_speed(r, va, vb), tangent_speed(r, va, vb))

    return {
        "pack_problem": pack_problem,
        "push_impulses": push_impulses,
        "pull_velocities": pull_velocities,
        "step_problem": step_problem,
        "sweep_problem": sweep_problem,
        "pull_problem": pull_problem,
    }
