"""What a network reads of a solve in flight, contact by contact, and its correction of the impulses."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, scalar_types, tangent
from dc_kernels.solve.iteration import COUNTERS, NORMS
from dc_kernels.solve.rows import COLUMNS, LANES

N_LANES = wp.constant(LANES)
N_COUNTERS = wp.constant(COUNTERS)
N_NORMS = wp.constant(NORMS)
UNKNOWN = wp.constant(4.0)  # A before the first sweep


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``solve_features`` and ``correct_impulses``; a thread each world that is asked for."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("in_flight", dtype, variant)
    columns = COLUMNS[variant]
    width = wp.constant(len(columns) * LANES)
    EN, ET, BIAS = (wp.constant(columns.index(name) * LANES) for name in ("en", "et", "bias"))
    zero, one = real(0.0), real(1.0)
    tiny = real(1e-20)

    @wp.func(module=module)
    def squash(x: real):
        """asinh: linear for small values, logarithmic for large ones."""
        y = wp.min(wp.abs(x), real(1e18))  # whose square is finite: at exact rest the step is none
        z = wp.log(y + wp.sqrt(y * y + real(1.0)))
        if x < real(0.0):
            return -z
        return z

    @wp.func(module=module)
    def local_step(
        c: int,
        slot: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        friction: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        x: vec2,
    ):
        """Unprojected normal and tangential steps of a contact alone, and the projected ones [N s]."""
        i = slot[c]
        r = (i / (2 * N_LANES)) * width + i % (2 * N_LANES)
        n = normal[c]
        tan = tangent(n)
        va = solved[body_a[c]]
        vb = solved[body_b[c]]
        dvx = vb[0] - va[0]
        dvy = vb[1] - va[1]
        vn = n[0] * dvx + n[1] * dvy + (cross(arm_b[c], n) * vb[2] - cross(arm_a[c], n) * va[2])
        vt = tan[0] * dvx + tan[1] * dvy + (cross(arm_b[c], tan) * vb[2] - cross(arm_a[c], tan) * va[2])
        free_n = -rows[r + EN] * (vn + rows[r + BIAS])
        free_t = -rows[r + ET] * vt
        new_n = wp.max(x[0] + free_n, real(0.0))
        limit = friction[c] * new_n
        new_t = wp.clamp(x[1] + free_t, -limit, limit)
        return vec4(free_n, free_t, new_n - x[0], new_t - x[1])

    @wp.func(module=module)
    def aitken(now: real, before: real, cap: real):
        """R / (1 - r) of the ratio r of two steps, from their squares, up to a cap."""
        ratio = wp.sqrt(now / (before + tiny))
        if ratio < cap * (one - ratio):
            return ratio / (one - ratio)
        return cap

    @wp.func(module=module)
    def cell(at: vec2, origin: vec2, spacing: real, squares: wp.array4d(dtype=real)):
        """The lower left of four nodes around a place, moved into the grid, and the place's shares of the cell."""
        x = wp.max((at[0] - origin[0]) / spacing, real(0.0))
        y = wp.max((at[1] - origin[1]) / spacing, real(0.0))
        i = wp.min(int(x), squares.shape[3] - 2)
        j = wp.min(int(y), squares.shape[2] - 2)
        return vec4(real(i), real(j), wp.min(x - real(i), real(1.0)), wp.min(y - real(j), real(1.0)))

    @wp.func(module=module)
    def corner_weight(found: vec4, corner: int):
        """Bilinear weight of one of the four nodes: lower left, lower right, upper left, upper right."""
        x = found[2]
        if corner % 2 == 0:
            x = real(1.0) - x
        y = found[3]
        if corner / 2 == 0:
            y = real(1.0) - y
        return x * y

    @wp.func(module=module)
    def add_squares(k: int, found: vec4, now: real, before: real, squares: wp.array4d(dtype=real)):
        """Squared steps of a contact to the nodes around it."""
        for corner in range(4):
            weight = corner_weight(found, corner)
            i = int(found[0]) + corner % 2
            j = int(found[1]) + corner / 2
            squares[k, 0, j, i] = squares[k, 0, j, i] + weight * now
            squares[k, 1, j, i] = squares[k, 1, j, i] + weight * before

    @wp.func(module=module)
    def rate_near(k: int, found: vec4, cap: real, squares: wp.array4d(dtype=real)):
        """Extrapolation of the steps around a place."""
        now = real(0.0)
        before = real(0.0)
        for corner in range(4):
            weight = corner_weight(found, corner)
            i = int(found[0]) + corner % 2
            j = int(found[1]) + corner / 2
            now += weight * squares[k, 0, j, i]
            before += weight * squares[k, 1, j, i]
        return aitken(now, before, cap)

    @wp.kernel(module=module, enable_backward=False)
    def solve_features(
        world_offset: int,
        begin: int,
        accelerated: int,
        tolerance: real,
        cap: real,
        rate_spacing: real,
        # What is asked for:
        active: wp.array(dtype=wp.int32),
        packed_start: wp.array(dtype=wp.int32),
        # Contacts, bodies and rows in:
        contact_start: wp.array(dtype=wp.int32),
        body_start: wp.array(dtype=wp.int32),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        friction: wp.array(dtype=real),
        age: wp.array(dtype=wp.int32),
        position: wp.array(dtype=vec2),
        slot: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        # Solve in flight in:
        impulse: wp.array(dtype=vec2),
        row_change: wp.array(dtype=real),
        row_before: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        known: wp.array(dtype=vec2),
        grid_origin: wp.array(dtype=vec2),
        # Scratch:
        body_sum: wp.array(dtype=vec4),
        squares: wp.array4d(dtype=real),
        # out:
        local: wp.array2d(dtype=real),
        image_value: wp.array2d(dtype=real),
        place: wp.array(dtype=vec2),
        place_a: wp.array(dtype=vec2),
        place_b: wp.array(dtype=vec2),
        step: wp.array(dtype=vec2),
        rate: wp.array(dtype=real),
        world_scale: wp.array(dtype=vec4),
    ):
        """Features of the contacts of the worlds ``active``, packed one world after the other (``solve_channels``).

        ``place`` holds the contact points, ``place_a`` and ``place_b`` the bodies' centres; ``known`` the impulses
        after the last correction; ``rate`` the extrapolation A = r / (1 - r) of the steps near the contact.
        ``world_scale``: RMS of the step and of the impulses, A of the world, 1 + A times the RMS of the step.
        """
        k = wp.tid() + world_offset
        base = packed_start[k]
        count = packed_start[k + 1] - base
        if count == 0:
            return
        w = active[k]
        first = contact_start[w]
        for b in range(body_start[w], body_start[w + 1]):
            body_sum[b] = vec4(zero, zero, zero, zero)
        q = w * N_COUNTERS
        p = w * N_NORMS
        total = zero
        carried = zero
        for k0 in range(count):
            c = first + k0
            x = impulse[c]
            s = vec2(zero, zero)
            if begin == 1:
                found = local_step(
                    c, slot, rows, body_a, body_b, normal, arm_a, arm_b, friction, solved, x
                )  # fmt: skip
                s = vec2(found[2], found[3])
            else:
                i = slot[c]
                s = vec2(row_change[i], row_change[i + N_LANES])
            step[base + k0] = s
            total += wp.dot(s, s)
            carried += wp.dot(x, x)
            n = normal[c]
            world_step = s[0] * n + s[1] * tangent(n)
            a = body_a[c]
            b = body_b[c]
            body_sum[a] = body_sum[a] + vec4(-world_step[0], -world_step[1], one, zero)
            body_sum[b] = body_sum[b] + vec4(world_step[0], world_step[1], one, zero)
        sigma = wp.sqrt(total / real(count)) + tiny
        size = wp.sqrt(carried / real(count)) + tiny
        extrapolation = real(UNKNOWN)
        if begin == 0:
            extrapolation = aitken(norms[p + 5], norms[p + 4], cap)
            for j in range(squares.shape[2]):
                for i in range(squares.shape[3]):
                    squares[k, 0, j, i] = zero
                    squares[k, 1, j, i] = zero
            for k0 in range(count):
                c = first + k0
                row = slot[c]
                s = step[base + k0]
                last = vec2(row_before[row], row_before[row + N_LANES])
                around = cell(position[body_a[c]] + arm_a[c], grid_origin[k], rate_spacing, squares)
                add_squares(k, around, wp.dot(s, s), wp.dot(last, last), squares)
        wide = one + extrapolation
        world_scale[k] = vec4(sigma, size, extrapolation, sigma * wide)
        inverse = one / sigma
        global_rate = wp.log(wide) * real(0.5)
        global_sweeps = wp.log(one + real(counters[q])) * real(0.25)
        global_size = wp.log(sigma / size) * real(0.25)
        global_left = wp.log(sigma / (tolerance + tiny)) * real(0.25)
        global_count = wp.log(real(count)) * real(0.25)
        for k0 in range(count):
            c = first + k0
            m = base + k0
            x = impulse[c]
            near = extrapolation
            if begin == 0:
                around = cell(position[body_a[c]] + arm_a[c], grid_origin[k], rate_spacing, squares)
                near = rate_near(k, around, cap, squares)
            rate[m] = near
            s = step[m] * inverse
            found = local_step(c, slot, rows, body_a, body_b, normal, arm_a, arm_b, friction, solved, x) * inverse
            since = (x - known[c]) * inverse
            if begin == 1:
                since = vec2(zero, zero)
            n = normal[c]
            tan = tangent(n)
            a = body_a[c]
            b = body_b[c]
            ma = solved[a][3]
            mb = solved[b][3]
            limit = friction[c] * x[0]
            used = zero
            sliding = zero
            if limit > zero:
                used = x[1] / limit
                if wp.abs(used) > real(0.999):
                    sliding = one
            closed = zero
            if x[0] > zero:
                closed = one
            fresh = zero
            if age[c] == 0:
                fresh = one
            double_x = n[0] * n[0] - n[1] * n[1]
            double_y = real(2.0) * n[0] * n[1]
            sum_a = body_sum[a]
            sum_b = body_sum[b]
            moving_a = zero
            if ma > zero:
                moving_a = inverse
            moving_b = zero
            if mb > zero:
                moving_b = inverse
            local[m, 0] = squash(s[0])
            local[m, 1] = squash(s[1])
            local[m, 2] = squash(found[2])
            local[m, 3] = squash(found[3])
            local[m, 4] = squash(since[0]) * real(0.5)
            local[m, 5] = squash(since[1]) * real(0.5)
            local[m, 6] = squash(x[0] * inverse) * real(0.25)
            local[m, 7] = squash(x[1] * inverse) * real(0.25)
            local[m, 8] = used
            local[m, 9] = closed
            local[m, 10] = sliding
            local[m, 11] = fresh
            local[m, 12] = double_x
            local[m, 13] = double_y
            local[m, 14] = squash(found[0])
            local[m, 15] = squash(found[1])
            local[m, 16] = squash((sum_a[0] * n[0] + sum_a[1] * n[1]) * moving_a)
            local[m, 17] = squash((sum_a[0] * tan[0] + sum_a[1] * tan[1]) * moving_a)
            local[m, 18] = squash((sum_b[0] * n[0] + sum_b[1] * n[1]) * moving_b)
            local[m, 19] = squash((sum_b[0] * tan[0] + sum_b[1] * tan[1]) * moving_b)
            local[m, 20] = real(0.25) * sum_a[2] * moving_a * sigma
            local[m, 21] = real(0.25) * sum_b[2] * moving_b * sigma
            local[m, 22] = ma / (ma + mb + tiny)
            local[m, 23] = global_rate
            local[m, 24] = real(begin)
            local[m, 25] = global_sweeps
            local[m, 26] = global_size
            local[m, 27] = global_left
            local[m, 28] = real(accelerated)
            local[m, 29] = global_count
            local[m, 30] = wp.log(one + near) * real(0.5)
            # p x n: what a contact passes on, the same from either side
            for j in range(3):
                u = s[0] * n + s[1] * tan
                weight = one
                if j == 1:
                    u = since[0] * n + since[1] * tan
                    weight = real(0.5)
                if j == 2:
                    u = (x[0] * n + x[1] * tan) * inverse
                    weight = real(0.25)
                length = wp.length(u) + tiny
                u = u * (weight * squash(length) / length)
                image_value[m, 4 * j] = u[0] * n[0]
                image_value[m, 4 * j + 1] = u[0] * n[1]
                image_value[m, 4 * j + 2] = u[1] * n[0]
                image_value[m, 4 * j + 3] = u[1] * n[1]
            image_value[m, 12] = one
            image_value[m, 13] = double_x
            image_value[m, 14] = double_y
            image_value[m, 15] = fresh
            image_value[m, 16] = closed
            image_value[m, 17] = sliding
            at = position[a] + arm_a[c]
            place[m] = at
            # the centre of what does not move says nothing of the contact
            place_a[m] = at
            if ma > zero:
                place_a[m] = position[a]
            place_b[m] = at
            if mb > zero:
                place_b[m] = position[b]

    @wp.func(module=module)
    def correction(
        m: int,
        x: vec2,
        output: wp.array2d(dtype=real),
        step: wp.array(dtype=vec2),
        rate: wp.array(dtype=real),
        scale: vec4,
    ):
        """What an output adds to the impulses x of a contact, before the cone."""
        s = step[m]
        dn = (one + rate[m]) * output[m, 0] * s[0] + scale[3] * (output[m, 2] + output[m, 4] * x[0] / scale[1])
        dt = (one + rate[m]) * output[m, 1] * s[1] + scale[3] * (output[m, 3] + output[m, 5] * x[1] / scale[1])
        return vec2(dn, dt)

    @wp.kernel(module=module, enable_backward=False)
    def correct_impulses(
        world_offset: int,
        limit_factor: real,
        # What is asked for:
        active: wp.array(dtype=wp.int32),
        packed_start: wp.array(dtype=wp.int32),
        output: wp.array2d(dtype=real),
        step: wp.array(dtype=vec2),
        rate: wp.array(dtype=real),
        world_scale: wp.array(dtype=vec4),
        # Contacts in:
        contact_start: wp.array(dtype=wp.int32),
        friction: wp.array(dtype=real),
        # in, out:
        impulse: wp.array(dtype=vec2),
        # out:
        before: wp.array(dtype=vec2),
        known: wp.array(dtype=vec2),
        replaced: wp.array(dtype=wp.int32),
    ):
        """Impulses plus the network's correction, on the friction cone; ``before``, ``known``: those before and after.

        Correction: [o_0, o_1] of 1 + A times the step, with the A near the contact; and of the RMS expected, 1 + A
        times that of the step, [o_2, o_3] alike for all and [o_4, o_5] by the impulse carried over its RMS. A world
        with an output that is not finite, or a correction of more than ``limit_factor`` times the RMS expected, is left
        as it is.
        """
        k = wp.tid() + world_offset
        base = packed_start[k]
        count = packed_start[k + 1] - base
        if count == 0:
            return
        w = active[k]
        first = contact_start[w]
        scale = world_scale[k]
        squares = zero
        for k0 in range(count):
            c = first + k0
            m = base + k0
            x = impulse[c]
            before[c] = x
            known[c] = x
            change = correction(m, x, output, step, rate, scale)
            squares += change[0] * change[0] + change[1] * change[1]
        rms = wp.sqrt(squares / real(count))
        # a comparison with NaN is false
        if not (rms <= limit_factor * scale[3]):
            return
        for k0 in range(count):
            c = first + k0
            m = base + k0
            x = impulse[c]
            change = correction(m, x, output, step, rate, scale)
            new_n = wp.max(x[0] + change[0], zero)
            limit = friction[c] * new_n
            x = vec2(new_n, wp.clamp(x[1] + change[1], -limit, limit))
            impulse[c] = x
            known[c] = x
        replaced[w] = 1

    return {"solve_features": solve_features, "correct_impulses": correct_impulses}
