"""What a network reads of a solve in flight, contact by contact, and its correction of the impulses."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, tangent
from dc_kernels._warp.groups import contiguity, contiguous_groups, group_types, struct_type
from dc_kernels._warp.solve.accelerate.aitken import series_limit
from dc_kernels._warp.solve.laws import relative_speed
from dc_kernels.learn.channels import Channel, Feature, Output, Scale
from dc_kernels.learn.groups import READING, SETTINGS
from dc_kernels.solve.rows import COLUMNS, LANES

N_LANES = wp.constant(LANES)
UNKNOWN = wp.constant(4.0)  # A before the first sweep
ON_CONE = wp.constant(0.999)  # of the limit, from which on a contact slides


@wp.func
def squash(x: Any):
    """asinh: linear for small values, logarithmic for large ones."""
    y = wp.min(wp.abs(x), type(x)(1e18))  # whose square is finite: at exact rest the step is none
    z = wp.log(y + wp.sqrt(y * y + type(x)(1.0)))
    if x < type(x)(0.0):
        return -z
    return z


@wp.func
def extrapolation_of(now: Any, before: Any, cap: Any):
    """A = r / (1 - r) of the ratio r of two steps, from their squares, up to a cap."""
    return series_limit(wp.sqrt(now / (before + type(now)(1e-20))), cap)


@wp.func
def stopped(x: Any, friction: Any):
    """Impulses with the normal one stopped at 0, then the tangential one at its limit, as a sweep does."""
    n = wp.max(x[0], type(friction)(0.0))
    limit = friction * n
    return type(x)(n, wp.clamp(x[1], -limit, limit))


@wp.func
def corner_weight(found: Any, corner: int):
    """Bilinear weight of one of the four nodes: lower left, lower right, upper left, upper right."""
    x = found[2]
    if corner % 2 == 0:
        x = type(x)(1.0) - x
    y = found[3]
    if corner / 2 == 0:
        y = type(y)(1.0) - y
    return x * y


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``solve_features`` and ``correct_impulses``; a thread each world that is asked for."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    vec3 = wp.types.vector(3, real)
    Reading, Settings = struct_type("reading", dtype, READING), struct_type("reading_settings", dtype, SETTINGS)
    module = kernel_module("in_flight", dtype, variant)
    contiguous = contiguous_groups(dtype)
    columns = COLUMNS[variant]
    width = wp.constant(len(columns) * LANES)
    EN, ET, BIAS = (wp.constant(columns.index(name) * LANES) for name in ("en", "et", "bias"))
    zero, one = real(0.0), real(1.0)
    tiny = real(1e-20)

    @wp.func_native(contiguity(READING))
    def contiguous_reading(group: Reading): ...

    @wp.func(module=module)
    def local_step(c: int, x: vec2, contacts: t.Contacts, rows: t.Rows, motion: t.Motion):
        """Unprojected normal and tangential steps of a contact alone, and the projected ones [N s]."""
        i = rows.slot[c]
        r = (i / (2 * N_LANES)) * width + i % (2 * N_LANES)
        n = contacts.normal[c]
        tan = tangent(n)
        va = motion.solved[contacts.body_a[c]]
        vb = motion.solved[contacts.body_b[c]]
        arm_a = contacts.arm_a[c]
        arm_b = contacts.arm_b[c]
        vn = relative_speed(n, va, vb, cross(arm_a, n), cross(arm_b, n))
        vt = relative_speed(tan, va, vb, cross(arm_a, tan), cross(arm_b, tan))
        free_n = -rows.column[r + EN] * (vn + rows.column[r + BIAS])
        free_t = -rows.column[r + ET] * vt
        new = stopped(vec2(x[0] + free_n, x[1] + free_t), contacts.friction[c])
        return vec4(free_n, free_t, new[0] - x[0], new[1] - x[1])

    @wp.func(module=module)
    def cell(at: vec2, origin: vec2, spacing: real, squares: wp.array4d(dtype=real)):
        """The lower left of four nodes around a place, moved into the grid, and the place's shares of the cell."""
        x = wp.max((at[0] - origin[0]) / spacing, zero)
        y = wp.max((at[1] - origin[1]) / spacing, zero)
        i = wp.min(int(x), squares.shape[3] - 2)
        j = wp.min(int(y), squares.shape[2] - 2)
        return vec4(real(i), real(j), wp.min(x - real(i), one), wp.min(y - real(j), one))

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
        now = zero
        before = zero
        for corner in range(4):
            weight = corner_weight(found, corner)
            i = int(found[0]) + corner % 2
            j = int(found[1]) + corner / 2
            now += weight * squares[k, 0, j, i]
            before += weight * squares[k, 1, j, i]
        return extrapolation_of(now, before, cap)

    @wp.func(module=module)
    def read_steps(
        k: int,
        settings: Settings,
        model: t.Model,
        contacts: t.Contacts,
        rows: t.Rows,
        motion: t.Motion,
        reading: Reading,
    ):
        """Steps of the contacts, their sums at the bodies, and the RMS of steps and of impulses."""
        base = reading.packed_start[k]
        count = reading.packed_start[k + 1] - base
        w = reading.active[k]
        for b in range(model.body_start[w], model.body_start[w + 1]):
            reading.body_sum[b] = vec4(zero, zero, zero, zero)
        total = zero
        carried = zero
        for k0 in range(count):
            c = contacts.contact_start[w] + k0
            x = contacts.impulse[c]
            s = vec2(zero, zero)
            if settings.begin == 1:
                found = local_step(c, x, contacts, rows, motion)
                s = vec2(found[2], found[3])
            else:
                i = rows.slot[c]
                s = vec2(rows.change[i], rows.change[i + N_LANES])
            reading.step[base + k0] = s
            total += wp.dot(s, s)
            carried += wp.dot(x, x)
            n = contacts.normal[c]
            world_step = s[0] * n + s[1] * tangent(n)
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            reading.body_sum[a] = reading.body_sum[a] + vec4(-world_step[0], -world_step[1], one, zero)
            reading.body_sum[b] = reading.body_sum[b] + vec4(world_step[0], world_step[1], one, zero)
        return vec2(wp.sqrt(total / real(count)) + tiny, wp.sqrt(carried / real(count)) + tiny)

    @wp.func(module=module)
    def contact_point(c: int, state: t.State, contacts: t.Contacts):
        return state.position[contacts.body_a[c]] + contacts.arm_a[c]

    @wp.func(module=module)
    def splat_squares(k: int, settings: Settings, state: t.State, contacts: t.Contacts, rows: t.Rows, reading: Reading):
        """Squared steps of the last two sweeps on the coarse grid."""
        base = reading.packed_start[k]
        for j in range(reading.squares.shape[2]):
            for i in range(reading.squares.shape[3]):
                reading.squares[k, 0, j, i] = zero
                reading.squares[k, 1, j, i] = zero
        for k0 in range(reading.packed_start[k + 1] - base):
            c = contacts.contact_start[reading.active[k]] + k0
            i = rows.slot[c]
            s = reading.step[base + k0]
            last = vec2(rows.before[i], rows.before[i + N_LANES])
            at = contact_point(c, state, contacts)
            around = cell(at, reading.grid_origin[k], settings.rate_spacing, reading.squares)
            add_squares(k, around, wp.dot(s, s), wp.dot(last, last), reading.squares)

    @wp.func(module=module)
    def put_pair(row: int, column: int, n: real, tan: real, values: wp.array2d(dtype=real)):
        """Normal and tangential value side by side."""
        values[row, column] = n
        values[row, column + 1] = tan

    @wp.func(module=module)
    def passed_on(x: vec2, scale: real, weight: real, n: vec2):
        """Outer product of p and n, row by row: what a contact passes on to the grid.

        p is the vector whose components along the normal and the tangent are x, scaled, its length squashed and
        weighted. Seen from its other body, a contact turns n and p around, which leaves the product as it is.
        """
        u = (x[0] * n + x[1] * tangent(n)) * scale
        length = wp.length(u) + tiny
        u = u * (weight * squash(length) / length)
        return vec4(u[0] * n[0], u[0] * n[1], u[1] * n[0], u[1] * n[1])

    @wp.func(module=module)
    def put_four(row: int, column: int, value: vec4, values: wp.array2d(dtype=real)):
        for k in range(4):
            values[row, column + k] = value[k]

    @wp.func(module=module)
    def where(condition: bool, value: real):
        """The value where the condition holds, else 0."""
        if condition:
            return value
        return zero

    @wp.func(module=module)
    def at_body(total: vec4, moving: real, sigma: real, n: vec2):
        """The steps that act on a body, along normal and tangent, and how many they are; ``moving``: 1 / sigma or 0."""
        tan = tangent(n)
        along_n = squash((total[0] * n[0] + total[1] * n[1]) * moving)
        along_t = squash((total[0] * tan[0] + total[1] * tan[1]) * moving)
        return vec3(along_n, along_t, real(0.25) * total[2] * moving * sigma)

    @wp.func(module=module)
    def read_contact(
        k: int,
        c: int,
        m: int,
        inverse: real,
        settings: Settings,
        state: t.State,
        contacts: t.Contacts,
        rows: t.Rows,
        motion: t.Motion,
        reading: Reading,
    ):
        """Columns of one contact that are not the whole world's; ``inverse``: 1 / sigma."""
        local = reading.local
        image = reading.image_value
        sigma = reading.scale[k][Scale.STEP]
        x = contacts.impulse[c]
        at = contact_point(c, state, contacts)
        near = reading.scale[k][Scale.RATE]
        if settings.begin == 0:
            around = cell(at, reading.grid_origin[k], settings.rate_spacing, reading.squares)
            near = rate_near(k, around, settings.cap, reading.squares)
        reading.rate[m] = near
        s = reading.step[m] * inverse
        found = local_step(c, x, contacts, rows, motion) * inverse
        since = (x - reading.known[c]) * inverse
        if settings.begin == 1:
            since = vec2(zero, zero)
        n = contacts.normal[c]
        a = contacts.body_a[c]
        b = contacts.body_b[c]
        ma = motion.solved[a][3]
        mb = motion.solved[b][3]
        limit = contacts.friction[c] * x[0]
        used = zero
        if limit > zero:
            used = x[1] / limit
        sliding = where(wp.abs(used) > real(ON_CONE), one)
        closed = where(x[0] > zero, one)
        new = where(contacts.age[c] == 0, one)
        double_cos = n[0] * n[0] - n[1] * n[1]
        double_sin = real(2.0) * n[0] * n[1]
        put_pair(m, Feature.STEP_N, squash(s[0]), squash(s[1]), local)
        put_pair(m, Feature.LOCAL_N, squash(found[2]), squash(found[3]), local)
        put_pair(m, Feature.SINCE_N, squash(since[0]) * real(0.5), squash(since[1]) * real(0.5), local)
        carried_n = squash(x[0] * inverse) * real(0.25)
        put_pair(m, Feature.IMPULSE_N, carried_n, squash(x[1] * inverse) * real(0.25), local)
        local[m, Feature.CONE] = used
        local[m, Feature.CLOSED] = closed
        local[m, Feature.SLIDING] = sliding
        local[m, Feature.NEW] = new
        put_pair(m, Feature.NORMAL_COS, double_cos, double_sin, local)
        put_pair(m, Feature.FREE_N, squash(found[0]), squash(found[1]), local)
        at_a = at_body(reading.body_sum[a], where(ma > zero, inverse), sigma, n)
        at_b = at_body(reading.body_sum[b], where(mb > zero, inverse), sigma, n)
        put_pair(m, Feature.BODY_A_N, at_a[0], at_a[1], local)
        put_pair(m, Feature.BODY_B_N, at_b[0], at_b[1], local)
        put_pair(m, Feature.DEGREE_A, at_a[2], at_b[2], local)
        local[m, Feature.SHARE_A] = ma / (ma + mb + tiny)
        local[m, Feature.RATE_NEAR] = wp.log(one + near) * real(0.5)
        put_four(m, Channel.STEP_XX, passed_on(s, one, one, n), image)
        put_four(m, Channel.SINCE_XX, passed_on(since, one, real(0.5), n), image)
        put_four(m, Channel.IMPULSE_XX, passed_on(x, inverse, real(0.25), n), image)
        image[m, Channel.CONTACTS] = one
        put_pair(m, Channel.NORMAL_COS, double_cos, double_sin, image)
        image[m, Channel.NEW] = new
        image[m, Channel.CLOSED] = closed
        image[m, Channel.SLIDING] = sliding
        # the centre of what does not move says nothing of the contact
        reading.place[m] = at
        reading.place_a[m] = at
        if ma > zero:
            reading.place_a[m] = state.position[a]
        reading.place_b[m] = at
        if mb > zero:
            reading.place_b[m] = state.position[b]

    @wp.kernel(module=module, enable_backward=False)
    def solve_features(
        world_offset: int,
        settings: Settings,
        model: t.Model,
        state: t.State,
        contacts: t.Contacts,
        rows: t.Rows,
        motion: t.Motion,
        stats: t.Stats,
        # out:
        reading: Reading,
    ):
        """Read the contacts of the worlds that are asked for: columns, images, places (``Feature``, ``Channel``)."""
        contiguous(model)
        contiguous(state)
        contiguous(contacts)
        contiguous(rows)
        contiguous(motion)
        contiguous_reading(reading)
        k = wp.tid() + world_offset
        base = reading.packed_start[k]
        count = reading.packed_start[k + 1] - base
        if count == 0:
            return
        w = reading.active[k]
        rms = read_steps(k, settings, model, contacts, rows, motion, reading)
        sigma = rms[0]
        size = rms[1]
        rate = real(UNKNOWN)
        if settings.begin == 0:
            rate = extrapolation_of(stats.iteration[w].step_last, stats.iteration[w].step_before, settings.cap)
            splat_squares(k, settings, state, contacts, rows, reading)
        wide = one + rate
        reading.scale[k] = vec4(sigma, size, rate, sigma * wide)
        log_rate = wp.log(wide) * real(0.5)
        log_sweeps = wp.log(one + real(stats.iteration[w].sweeps)) * real(0.25)
        log_size = wp.log(sigma / size) * real(0.25)
        log_left = wp.log(sigma / (settings.tolerance + tiny)) * real(0.25)
        log_count = wp.log(real(count)) * real(0.25)
        local = reading.local
        inverse = one / sigma
        first = contacts.contact_start[w]
        for k0 in range(count):
            m = base + k0
            read_contact(k, first + k0, m, inverse, settings, state, contacts, rows, motion, reading)
            local[m, Feature.RATE] = log_rate
            local[m, Feature.BEGIN] = real(settings.begin)
            local[m, Feature.SWEEPS] = log_sweeps
            local[m, Feature.SIZE] = log_size
            local[m, Feature.LEFT] = log_left
            local[m, Feature.ACCELERATED] = real(settings.accelerated)
            local[m, Feature.CONTACTS] = log_count

    @wp.func(module=module)
    def correction(m: int, x: vec2, scale: vec4, reading: Reading, output: wp.array2d(dtype=real)):
        """What an output adds to the impulses x of a contact, before the cone."""
        s = reading.step[m]
        wide = one + reading.rate[m]
        free_n = output[m, Output.FREE_N] + output[m, Output.CARRIED_N] * x[0] / scale[Scale.IMPULSE]
        free_t = output[m, Output.FREE_T] + output[m, Output.CARRIED_T] * x[1] / scale[Scale.IMPULSE]
        dn = wide * output[m, Output.STEP_N] * s[0] + scale[Scale.EXPECTED] * free_n
        dt = wide * output[m, Output.STEP_T] * s[1] + scale[Scale.EXPECTED] * free_t
        return vec2(dn, dt)

    @wp.kernel(module=module, enable_backward=False)
    def correct_impulses(
        world_offset: int,
        settings: Settings,
        output: wp.array2d(dtype=real),
        # in, out:
        contacts: t.Contacts,
        reading: Reading,
        # out:
        stats: t.Stats,
    ):
        """Add the network's correction to the impulses and stop them at their cones.

        The correction (columns ``Output``) is multiples of 1 + A times the step, with the A near the contact; and, of
        the RMS expected, 1 + A times that of the step, parts alike for all contacts and parts by the impulse carried
        over its RMS. A world with an output that is not finite, or with a correction of more than ``limit`` times the
        RMS expected, is left as it is.
        """
        k = wp.tid() + world_offset
        base = reading.packed_start[k]
        count = reading.packed_start[k + 1] - base
        if count == 0:
            return
        w = reading.active[k]
        first = contacts.contact_start[w]
        scale = reading.scale[k]
        squares = zero
        for k0 in range(count):
            c = first + k0
            x = contacts.impulse[c]
            reading.before[c] = x
            reading.known[c] = x
            change = correction(base + k0, x, scale, reading, output)
            squares += change[0] * change[0] + change[1] * change[1]
        rms = wp.sqrt(squares / real(count))
        # a comparison with NaN is false
        if not (rms <= settings.limit * scale[Scale.EXPECTED]):
            return
        for k0 in range(count):
            c = first + k0
            x = contacts.impulse[c]
            change = correction(base + k0, x, scale, reading, output)
            x = stopped(x + change, contacts.friction[c])
            contacts.impulse[c] = x
            reading.known[c] = x
        stats.replaced[w] = 1

    return {"solve_features": solve_features, "correct_impulses": correct_impulses}
