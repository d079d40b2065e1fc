"""Plain sweeps over batches of contact problems, their adjoint, and products with the Jacobian; one thread a world.

The arithmetic is that of the solver for general rows with omega = 1 (``solve.row``). Contacts are swept in index order,
in which neighbours may have bodies in common, so a row holds all of a contact side by side instead of lanes.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, scalar_types, tangent
from dc_kernels._warp.solve.laws import inverse_or_zero, relative_speed
from dc_kernels.learn.packed import Active, Column


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """The kernels by name."""
    t = scalar_types(dtype)
    real, vec2, vec3 = t.real, t.vec2, wp.types.vector(3, t.real)
    row_type = wp.types.vector(16, real)
    module = kernel_module("differentiable", dtype)

    @wp.func(module=module)
    def normal_speed(r: row_type, va: vec3, vb: vec3):
        n = vec2(r[Column.NX], r[Column.NY])
        return relative_speed(n, va, vb, r[Column.NORMAL_ARM_A], r[Column.NORMAL_ARM_B])

    @wp.func(module=module)
    def tangent_speed(r: row_type, va: vec3, vb: vec3):
        tan = vec2(r[Column.NY], -r[Column.NX])
        return relative_speed(tan, va, vb, r[Column.TANGENT_ARM_A], r[Column.TANGENT_ARM_B])

    # a store to the ground, which many rows share, would make each wait for the last
    @wp.func(module=module)
    def moves_a(r: row_type):
        """Whether the contact changes body A."""
        turns = r[Column.NORMAL_TURN_A] != real(0.0) or r[Column.TANGENT_TURN_A] != real(0.0)
        return r[Column.INV_MASS_A] > real(0.0) or turns

    @wp.func(module=module)
    def moves_b(r: row_type):
        """Whether the contact changes body B."""
        turns = r[Column.NORMAL_TURN_B] != real(0.0) or r[Column.TANGENT_TURN_B] != real(0.0)
        return r[Column.INV_MASS_B] > real(0.0) or turns

    @wp.func(module=module)
    def push_a(r: row_type, v: vec3, n: real, t: real):
        """Velocity of body A after a normal and a tangential impulse."""
        px = r[Column.NX] * n + r[Column.NY] * t
        py = r[Column.NY] * n - r[Column.NX] * t
        turn = r[Column.NORMAL_TURN_A] * n + r[Column.TANGENT_TURN_A] * t
        return vec3(v[0] - r[Column.INV_MASS_A] * px, v[1] - r[Column.INV_MASS_A] * py, v[2] - turn)

    @wp.func(module=module)
    def push_b(r: row_type, v: vec3, n: real, t: real):
        """Velocity of body B after a normal and a tangential impulse."""
        px = r[Column.NX] * n + r[Column.NY] * t
        py = r[Column.NY] * n - r[Column.NX] * t
        turn = r[Column.NORMAL_TURN_B] * n + r[Column.TANGENT_TURN_B] * t
        return vec3(v[0] + r[Column.INV_MASS_B] * px, v[1] + r[Column.INV_MASS_B] * py, v[2] + turn)

    @wp.kernel(module=module, enable_backward=False)
    def complete_rows(
        world_offset: int,
        given_mass: int,
        contact_start: wp.array(dtype=wp.int32),
        row_body: wp.array(dtype=wp.vec2i),
        inverse: wp.array(dtype=vec3),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        # in, out:
        row: wp.array(dtype=row_type),
    ):
        """Fill in arms, inverse masses and, unless they are given, effective masses 1 / (J M^-1 J^T) of a world."""
        w = wp.tid() + world_offset
        for c in range(contact_start[w], contact_start[w + 1]):
            r = row[c]
            a = inverse[row_body[c][0]]
            b = inverse[row_body[c][1]]
            n = vec2(r[Column.NX], r[Column.NY])
            tan = tangent(n)
            ran = cross(arm_a[c], n)
            rbn = cross(arm_b[c], n)
            rat = cross(arm_a[c], tan)
            rbt = cross(arm_b[c], tan)
            r[Column.NORMAL_ARM_A] = ran
            r[Column.NORMAL_ARM_B] = rbn
            r[Column.TANGENT_ARM_A] = rat
            r[Column.TANGENT_ARM_B] = rbt
            r[Column.INV_MASS_A] = a[0]
            r[Column.INV_MASS_B] = b[0]
            r[Column.NORMAL_TURN_A] = a[2] * ran
            r[Column.NORMAL_TURN_B] = b[2] * rbn
            r[Column.TANGENT_TURN_A] = a[2] * rat
            r[Column.TANGENT_TURN_B] = b[2] * rbt
            if given_mass == 0:
                r[Column.EN] = inverse_or_zero(a[0] + b[0] + a[2] * ran * ran + b[2] * rbn * rbn)
                r[Column.ET] = inverse_or_zero(a[0] + b[0] + a[2] * rat * rat + b[2] * rbt * rbt)
            row[c] = r

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
        """Add M^-1 J^T impulse to the velocities (Wu 2018, equation 2.26)."""
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
        """Compute J V: normal and tangential speed of each contact."""
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
        """Compute what each row alone would change its impulses by, all at the same velocities."""
        w = wp.tid() + world_offset
        for c in range(contact_start[w], contact_start[w + 1]):
            r = row[c]
            va = velocity[row_body[c][0]]
            vb = velocity[row_body[c][1]]
            x = impulse[c]
            n = wp.max(x[0] - r[Column.EN] * (normal_speed(r, va, vb) + r[Column.BIAS]), real(0.0))
            limit = r[Column.MU] * n
            t = wp.min(wp.max(x[1] - r[Column.ET] * tangent_speed(r, va, vb), -limit), limit)
            step[c] = vec2(n - x[0], t - x[1])

    @wp.kernel(module=module, enable_backward=False)
    def sweep_problem(
        world_offset: int,
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
        """Sweep as often as the tape ``active`` is long, normal before tangent, from ``velocity`` as predicted."""
        w = wp.tid() + world_offset
        none = real(0.0)
        push_world(w, contact_start, row, row_body, impulse, velocity)
        for k in range(active.shape[0]):
            for c in range(contact_start[w], contact_start[w + 1]):
                r = row[c]
                a = row_body[c][0]
                b = row_body[c][1]
                va = velocity[a]
                vb = velocity[b]
                x = impulse[c]
                code = int(0)
                free_n = x[0] - r[Column.EN] * (normal_speed(r, va, vb) + r[Column.BIAS])
                if free_n > none:
                    code = Active.PRESSING
                n = wp.max(free_n, none)
                va = push_a(r, va, n - x[0], none)
                vb = push_b(r, vb, n - x[0], none)
                limit = r[Column.MU] * n
                free_t = x[1] - r[Column.ET] * tangent_speed(r, va, vb)
                if free_t > limit:
                    code += Active.UPPER
                if free_t < -limit:
                    code += Active.LOWER
                t = wp.min(wp.max(free_t, -limit), limit)
                if moves_a(r):
                    velocity[a] = push_a(r, va, none, t - x[1])
                if moves_b(r):
                    velocity[b] = push_b(r, vb, none, t - x[1])
                impulse[c] = vec2(n, t)
                change[c] = vec2(n - x[0], t - x[1])
                active[k, c] = wp.int8(code)

    @wp.kernel(module=module, enable_backward=False)
    def pull_problem(
        world_offset: int,
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
        sweeps = active.shape[0]
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
                if code >= Active.UPPER:
                    free_t = leak * y_t
                    if code < Active.LOWER:
                        y_n = y_n + r[Column.MU] * y_t
                    else:
                        y_n = y_n - r[Column.MU] * y_t
                va = push_a(r, va, none, -(r[Column.ET] * free_t))
                vb = push_b(r, vb, none, -(r[Column.ET] * free_t))
                pull_n = normal_speed(r, va, vb)
                free_n = y_n + pull_n
                if code % Active.UPPER == 0:
                    free_n = leak * free_n
                if moves_a(r):
                    by_velocity[a] = push_a(r, va, -(r[Column.EN] * free_n), none)
                if moves_b(r):
                    by_velocity[b] = push_b(r, vb, -(r[Column.EN] * free_n), none)
                by_impulse[c] = vec2(free_n - pull_n - z[0], free_t - pull_t - z[1])
        for c in range(first, last):
            r = row[c]
            va = by_velocity[row_body[c][0]]
            vb = by_velocity[row_body[c][1]]
            by_impulse[c] = by_impulse[c] + vec2(normal_speed(r, va, vb), tangent_speed(r, va, vb))

    return {
        "complete_rows": complete_rows,
        "push_impulses": push_impulses,
        "pull_velocities": pull_velocities,
        "step_problem": step_problem,
        "sweep_problem": sweep_problem,
        "pull_problem": pull_problem,
    }
