"""Rows by Jacobian (seed, 2.2.1), packed into blocks colour by colour.

J = [-n, -r_A x n, n, r_B x n] (2.21), the tangent alike (2.22), a distance joint along its line (2.20);
effective mass 1 / (J M^-1 J^T) (2.24-2.25).
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, rotate, scalar_types, tangent
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import BodyType, Flag
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES

DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
ROW_OVERFLOW = wp.constant(int(Flag.ROW_OVERFLOW))
JACOBI = wp.constant(METHODS["jacobi"])
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
OPEN = wp.constant(1e6)  # a row that lets this many times the gap close within the step never acts


@cache
def row_store(dtype: str, variant: str) -> Any:
    """Native store of one row's columns: one base pointer and constant offsets, 8 ns a row less than array stores."""
    real = scalar_types(dtype).real
    lines = [f"row[{i * LANES}] = {name};" for i, name in enumerate(COLUMNS[variant])]
    code = "auto* row = rows.data + r; " + " ".join(lines)
    # fmt: off
    if variant == "discs":

        @wp.func_native(code)
        def store_row(
            rows: wp.array(dtype=real), r: wp.int32,
            nx: real, ny: real, dA: real, dB: real, kA: real, kB: real, en: real, et: real,
            bias: real, mu: real, gap: real,
        ): ...

    elif variant == "general":

        @wp.func_native(code)
        def store_row(
            rows: wp.array(dtype=real), r: wp.int32,
            nx: real, ny: real, rAn: real, rBn: real, rAt: real, rBt: real, iA: real, iB: real,
            en: real, et: real, bias: real, mu: real, gap: real,
        ): ...

    else:

        @wp.func_native(code)
        def store_row(
            rows: wp.array(dtype=real), r: wp.int32,
            nx: real, ny: real, rAn: real, rBn: real, rAt: real, rBt: real, iA: real, iB: real,
            en: real, et: real, bias: real, mu: real, gap: real, lo: real,
        ): ...

    # fmt: on
    return store_row


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``pack_rows`` and ``unpack_impulses``; one thread a world."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("rows", dtype, variant)
    columns = COLUMNS[variant]
    discs = variant == "discs"
    joints = variant == "joints"
    width = wp.constant(len(columns) * LANES)
    store_row = row_store(dtype, variant)
    minus_infinity = real(float("-inf"))

    @wp.func(module=module)
    def inverse(x: real):
        if x > real(0.0):
            return real(1.0) / x
        return real(0.0)

    @wp.kernel(module=module, enable_backward=False)
    def pack_rows(
        world_offset: int,
        slop_factor: real,
        baumgarte: real,
        max_correction: real,
        restitution_threshold: real,
        method: int,
        # Model:
        body_start: wp.array(dtype=wp.int32),
        length_scale: wp.array(dtype=real),
        body_type: wp.array(dtype=wp.int32),
        inv_inertia: wp.array(dtype=real),
        padding_body: int,
        # State in:
        position: wp.array(dtype=vec2),
        angle: wp.array(dtype=real),
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
        step_dt: wp.array(dtype=real),
        predicted: wp.array(dtype=vec4),
        # Joints in:
        joint_start: wp.array(dtype=wp.int32),
        joint_body_a: wp.array(dtype=wp.int32),
        joint_body_b: wp.array(dtype=wp.int32),
        joint_anchor_a: wp.array(dtype=vec2),
        joint_anchor_b: wp.array(dtype=vec2),
        joint_length: wp.array(dtype=real),
        joint_color: wp.array(dtype=wp.int32),
        # Contacts in:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        gap: wp.array(dtype=real),
        friction: wp.array(dtype=real),
        restitution: wp.array(dtype=real),
        color: wp.array(dtype=wp.int32),
        # State in, out:
        flags: wp.array(dtype=wp.int32),
        # Rows out:
        block_start: wp.array(dtype=wp.int32),
        block_needed: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        color_fill: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        row_scale: wp.array(dtype=real),
        deepest: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        body_rows: wp.array(dtype=wp.int32),
    ):
        """Rows of a world's contacts and joints, in blocks of LANES colour by colour.

        Bias velocity: a gap may close within the step (gap / dt), but one below the slop counts as closed: the
        round-off of resting gaps would change the problem in each step and cost the warm start a tenth of its gain.
        A contact that hits within the step faster than the threshold leaves with -e times the speed that it had before
        the step's forces: bounces then mirror semi-implicit Euler, and an elastic ball returns to its height to
        round-off for ever. A gap of a bouncing pair that stays open is left alone: what another impact pushes across it
        bounces in the next step. A closed separating contact of such a pair may be left approaching with e times its
        speed at most (Moreau 1988), without which several impacts at once can gain energy.

        A joint's bias makes up for what the turn of its line and of its anchors' arms lengthens it by within the step,
        to second order; without it a pendulum loses (w dt)^2 / 2 of its speed in each step.
        """
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        dt = step_dt[w]
        per_dt = real(1.0) / dt
        slop = slop_factor * length_scale[w]
        limit = max_correction * length_scale[w]
        start = contact_start[w]
        end = start + contact_count[w]
        count = w * N_COLORS
        for k in range(count, count + N_COLORS):
            color_fill[k] = 0
        used = int(0)
        for c in range(start, end):
            color_fill[count + color[c]] += 1
            used = wp.max(used, color[c] + 1)
        for j in range(joint_start[w], joint_start[w + 1]):
            color_fill[count + joint_color[j]] += 1
            used = wp.max(used, joint_color[j] + 1)
        first = block_start[w]
        ends = w * (N_COLORS + 1)
        block = first
        for k in range(N_COLORS):
            color_block[ends + k] = block
            block += (color_fill[count + k] + N_LANES - 1) / N_LANES
        color_block[ends + N_COLORS] = block
        block_needed[w] = block - first
        if block > block_start[w + 1]:
            flags[w] = flags[w] | ROW_OVERFLOW
            return
        # empty lanes of a colour's last block
        for k in range(used):
            filled = color_fill[count + k]
            color_fill[count + k] = 0
            if filled % N_LANES != 0:
                last = color_block[ends + k + 1] - 1
                for i in range(last * width, (last + 1) * width):
                    rows[i] = real(0.0)
                for i in range(last * 2 * N_LANES, (last + 1) * 2 * N_LANES):
                    row_body[i] = padding_body
        if method == JACOBI:
            for b in range(body_start[w], body_start[w + 1]):
                body_rows[b] = 0
        scale = real(0.0)
        least = real(0.0)
        for c in range(start, end):
            k = color[c]
            index = color_fill[count + k]
            color_fill[count + k] = index + 1
            block = color_block[ends + k] + index / N_LANES
            lane = index % N_LANES
            r = block * width + lane
            i = block * 2 * N_LANES + lane
            slot[c] = i
            a = body_a[c]
            b = body_b[c]
            row_body[i] = a
            row_body[i + N_LANES] = b
            if method == JACOBI:
                body_rows[a] += 1
                body_rows[b] += 1
            va = predicted[a]
            vb = predicted[b]
            ia = inv_inertia[a]
            ib = inv_inertia[b]
            n = normal[c]
            tan = tangent(n)
            rat = cross(arm_a[c], tan)
            rbt = cross(arm_b[c], tan)
            ran = real(0.0)
            rbn = real(0.0)
            if wp.static(not discs):
                ran = cross(arm_a[c], n)
                rbn = cross(arm_b[c], n)
            dvx = vb[0] - va[0]
            dvy = vb[1] - va[1]
            un = (n[0] * dvx + n[1] * dvy) + (rbn * vb[2] - ran * va[2])
            ut = (tan[0] * dvx + tan[1] * dvy) + (rbt * vb[2] - rat * va[2])
            g = gap[c]
            least = wp.min(least, g)
            e = restitution[c]
            bias = real(0.0)
            if g > slop:
                bias = g * per_dt
            elif baumgarte > real(0.0) and g < -slop:
                bias = wp.max(baumgarte * (g + slop), -limit) * per_dt
            counted = real(1.0)
            if e > real(0.0):
                if g > slop and g + un * dt >= real(0.0):
                    bias = real(OPEN) * g * per_dt
                    counted = real(0.0)
                else:
                    dv = velocity[b] - velocity[a]
                    turn = rbn * angular_velocity[b] - ran * angular_velocity[a]
                    before = (n[0] * dv[0] + n[1] * dv[1]) + turn
                    if before > real(0.0):
                        bias = wp.max(bias, e * before)
                    elif before < -restitution_threshold:
                        bias = wp.min(bias, e * before)
            ma = va[3]
            mb = vb[3]
            en = inverse(ma + mb + ia * ran * ran + ib * rbn * rbn)
            et = inverse(ma + mb + ia * rat * rat + ib * rbt * rbt)
            mu = friction[c]
            if wp.static(discs):
                store_row(rows, r, n[0], n[1], -rat, rbt, -(ia * rat), ib * rbt, en, et, bias, mu, g + slop)
            if wp.static(variant == "general"):
                store_row(rows, r, n[0], n[1], ran, rbn, rat, rbt, ia, ib, en, et, bias, mu, g + slop)
            if wp.static(joints):
                store_row(rows, r, n[0], n[1], ran, rbn, rat, rbt, ia, ib, en, et, bias, mu, g + slop, real(0.0))
            scale += counted * ((en * (un + bias)) * (en * (un + bias)) + (en * ut) * (en * ut))
        if wp.static(joints):
            for j in range(joint_start[w], joint_start[w + 1]):
                k = joint_color[j]
                index = color_fill[count + k]
                color_fill[count + k] = index + 1
                block = color_block[ends + k] + index / N_LANES
                lane = index % N_LANES
                r = block * width + lane
                i = block * 2 * N_LANES + lane
                joint_slot[j] = i
                a = joint_body_a[j]
                b = joint_body_b[j]
                row_body[i] = a
                row_body[i + N_LANES] = b
                if method == JACOBI:
                    body_rows[a] += 1
                    body_rows[b] += 1
                va = predicted[a]
                vb = predicted[b]
                ra = rotate(wp.cos(angle[a]), wp.sin(angle[a]), joint_anchor_a[j])
                rb = rotate(wp.cos(angle[b]), wp.sin(angle[b]), joint_anchor_b[j])
                d = (position[b] + rb) - (position[a] + ra)
                length = wp.length(d)
                n = vec2(real(1.0), real(0.0))
                if length > real(0.0):
                    n = d / length
                ran = cross(ra, n)
                rbn = cross(rb, n)
                ia = inv_inertia[a]
                ib = inv_inertia[b]
                en = inverse(va[3] + vb[3] + ia * ran * ran + ib * rbn * rbn)
                un = (n[0] * (vb[0] - va[0]) + n[1] * (vb[1] - va[1])) + (rbn * vb[2] - ran * va[2])
                # before the step's forces, which the joints of a chain at rest will balance
                tan = tangent(n)
                wa = angular_velocity[a]
                wb = angular_velocity[b]
                ut = wp.dot(tan, velocity[b] - velocity[a]) + (cross(rb, tan) * wb - cross(ra, tan) * wa)
                bend = wa * wa * wp.dot(n, ra) - wb * wb * wp.dot(n, rb)
                if length > real(0.0):
                    bend += ut * ut / length
                grow = wp.clamp(real(0.5) * dt * dt * bend, -limit, limit)
                off = length - joint_length[j]
                bias = (wp.clamp(baumgarte * off, -limit, limit) + grow) * per_dt
                off += grow
                none = real(0.0)
                store_row(
                    rows, r, n[0], n[1], ran, rbn, none, none, ia, ib, en, none, bias, none, off, minus_infinity
                )  # fmt: skip
                scale += (en * (un + bias)) * (en * (un + bias))
        row_scale[w] = wp.sqrt(scale)
        deepest[w] = least
        colors[w] = used

    @wp.kernel(module=module, enable_backward=False)
    def unpack_impulses(
        world_offset: int,
        flags: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        row_impulse: wp.array(dtype=real),
        # out:
        impulse: wp.array(dtype=vec2),
        joint_impulse: wp.array(dtype=real),
    ):
        """Solved impulses back to contacts and joints."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        start = contact_start[w]
        for c in range(start, start + contact_count[w]):
            i = slot[c]
            impulse[c] = vec2(row_impulse[i], row_impulse[i + N_LANES])
        if wp.static(joints):
            for j in range(joint_start[w], joint_start[w + 1]):
                joint_impulse[j] = row_impulse[joint_slot[j]]

    return {"pack_rows": pack_rows, "unpack_impulses": unpack_impulses}
