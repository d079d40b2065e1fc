"""The sweep of one row, which clamps its friction to Coulomb's cone (Wu 2018, section 2.2.2), in scalar arithmetic.

It is the oracle of the SIMD lanes, and what a GPU runs.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.laws import clamped, linear_speed, natural_map_squared, relative_speed
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.iteration import ALIKE, ASTRAY, FAR, MOVING, SCARCE
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES, OWN, SURFACED

N_LANES = wp.constant(LANES)
IN_ALL = wp.constant(MOVING)
FAR_IN_ALL = wp.constant(SCARCE)
LED_ASTRAY = wp.constant(ASTRAY)


@cache
def row_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``sweep_row``, ``jacobi_row``, ``apply_row``, ``push_row``, ``moving_row`` and ``natural_map_row``: one row each.

    They are the oracle of the lanes, the serial colour, the colour schedule and the path on a GPU. Velocities
    ``bodies`` are those of ``motion`` that a sweep changes: solved ones, or displacements.
    """
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("solver", dtype, variant)
    columns = COLUMNS[variant]
    discs = variant == "discs"
    jointed, own, surfaced = variant in JOINTED, variant in OWN, variant in SURFACED
    width = wp.constant(len(columns) * LANES)
    at = {name: wp.constant(i * LANES) for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # the variant that lacks a column never reads it
    RAN, RBN, RAT, RBT, IA, IB = (at.get(c, 0) for c in ("rAn", "rBn", "rAt", "rBt", "iA", "iB"))
    DA, DB, KA, KB, LO = (at.get(c, 0) for c in ("dA", "dB", "kA", "kB", "lo"))
    HI, AX, AY, SOFT, HELD, SLIP, ROLL = (at.get(c, 0) for c in ("hi", "ax", "ay", "soft", "held", "slip", "roll"))
    infinity = real(float("inf"))
    one = real(1.0)
    bounded = real(UNBOUNDED)

    @wp.func(module=module)
    def normal_speed(column: wp.array(dtype=real), r: int, va: vec4, vb: vec4):
        n = vec2(column[r + NX], column[r + NY])
        if wp.static(own):
            along = (n[0] * vb[0] - column[r + AX] * va[0]) + (n[1] * vb[1] - column[r + AY] * va[1])
            return along + (column[r + RBN] * vb[2] - column[r + RAN] * va[2])
        elif wp.static(discs):
            return linear_speed(n, va, vb)
        else:
            return relative_speed(n, va, vb, column[r + RAN], column[r + RBN])

    @wp.func(module=module)
    def tangent_speed(column: wp.array(dtype=real), r: int, va: vec4, vb: vec4):
        tangent = vec2(column[r + NY], -column[r + NX])
        if wp.static(discs):
            return relative_speed(tangent, va, vb, -column[r + DA], column[r + DB])
        elif wp.static(surfaced):
            return relative_speed(tangent, va, vb, column[r + RAT], column[r + RBT]) + column[r + SLIP]
        else:
            return relative_speed(tangent, va, vb, column[r + RAT], column[r + RBT])

    @wp.func(module=module)
    def mixed(column: wp.array(dtype=real), r: int, na: real, nb: real):
        """Tangential speed that a unit of normal impulse gives, by shares of each body's mass [1/kg]: 0 of discs."""
        if wp.static(discs):
            return real(0.0)
        else:
            wa = column[r + IA] * column[r + RAN] * column[r + RAT]
            wb = column[r + IB] * column[r + RBN] * column[r + RBT]
            return na * wa + nb * wb

    @wp.func(module=module)
    def tangent_speed_after(column: wp.array(dtype=real), r: int, va: vec4, vb: vec4, dn: real):
        """What the tangential speed is after a normal impulse, from the velocities before it."""
        speed = tangent_speed(column, r, va, vb)
        if wp.static(not discs):
            speed = speed + mixed(column, r, one, one) * dn
        return speed

    @wp.func(module=module)
    def normal_change(column: wp.array(dtype=real), r: int, v: vec4, side: int, dn: real):
        """Velocity of body A (side 0) or B (side 1) after a normal impulse."""
        px = column[r + NX] * dn
        py = column[r + NY] * dn
        x = v[0]
        y = v[1]
        spin = v[2]
        if side == 0:
            if wp.static(own):
                px = column[r + AX] * dn
                py = column[r + AY] * dn
            x = x - v[3] * px
            y = y - v[3] * py
            if wp.static(not discs):
                spin = spin - column[r + IA] * (column[r + RAN] * dn)
        else:
            x = x + v[3] * px
            y = y + v[3] * py
            if wp.static(not discs):
                spin = spin + column[r + IB] * (column[r + RBN] * dn)
        return vec4(x, y, spin, v[3])

    @wp.func(module=module)
    def changed(column: wp.array(dtype=real), r: int, v: vec4, side: int, dn: real, dt: real):
        """Velocity of body A (side 0) or B (side 1) after an impulse along the normal and one along the tangent."""
        qx = column[r + NY] * dt
        qy = column[r + NX] * dt
        px = column[r + NX] * dn + qx
        py = column[r + NY] * dn - qy
        x = v[0]
        y = v[1]
        spin = v[2]
        if side == 0:
            if wp.static(own):
                px = column[r + AX] * dn + qx
                py = column[r + AY] * dn - qy
            x = x - v[3] * px
            y = y - v[3] * py
            if wp.static(discs):
                spin = spin + column[r + KA] * dt
            else:
                spin = spin - column[r + IA] * (column[r + RAN] * dn + column[r + RAT] * dt)
        else:
            x = x + v[3] * px
            y = y + v[3] * py
            if wp.static(discs):
                spin = spin + column[r + KB] * dt
            else:
                spin = spin + column[r + IB] * (column[r + RBN] * dn + column[r + RBT] * dt)
        return vec4(x, y, spin, v[3])

    @wp.func(module=module)
    def least_normal(column: wp.array(dtype=real), r: int):
        """Least normal impulse of a row: 0 of a contact, minus infinity of a joint."""
        low = real(0.0)
        if wp.static(jointed):
            low = column[r + LO]
        return low

    @wp.func(module=module)
    def within(column: wp.array(dtype=real), r: int, impulse: real):
        """A normal impulse within its bounds."""
        bounded = wp.max(impulse, least_normal(column, r))
        if wp.static(own):
            bounded = wp.min(bounded, column[r + HI])
        return bounded

    @wp.func(module=module)
    def bias_of(column: wp.array(dtype=real), r: int, impulse: real):
        """What the normal speed is to be zero with: the bias, and what a soft row gives way by for its impulse."""
        bias = column[r + BIAS]
        if wp.static(own):
            bias = bias + column[r + SOFT] * impulse
        return bias

    @wp.func(module=module)
    def sweep_row(block: int, lane: int, rows: t.Rows, bodies: wp.array(dtype=vec4), omega: real):
        """Projected Gauss-Seidel on one row, normal before friction; the larger impulse change [N s]."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        va = bodies[a]
        vb = bodies[b]
        ln0 = rows.impulse[i]
        lt0 = rows.impulse[i + N_LANES]
        speed = normal_speed(rows.column, r, va, vb)
        ln = within(rows.column, r, ln0 - (omega * rows.column[r + EN]) * (speed + bias_of(rows.column, r, ln0)))
        dn = ln - ln0
        vt = tangent_speed_after(rows.column, r, va, vb, dn)
        limit = rows.column[r + MU] * ln
        lt = clamped(lt0 - (omega * rows.column[r + ET]) * vt, limit)
        dt = lt - lt0
        bodies[a] = changed(rows.column, r, va, 0, dn, dt)
        bodies[b] = changed(rows.column, r, vb, 1, dn, dt)
        rows.impulse[i] = ln
        rows.impulse[i + N_LANES] = lt
        rows.change[i] = dn
        rows.change[i + N_LANES] = dt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def split_mass(column: wp.array(dtype=real), r: int, na: real, nb: real, ma: real, mb: real, direction: int):
        """J M^-1 J^T with each body's mass shared among its rows (direction 0 normal, 1 tangent)."""
        if wp.static(discs):
            if direction == 0:
                return na * ma + nb * mb
            return na * (ma + column[r + KA] * column[r + DA]) + nb * (mb + column[r + KB] * column[r + DB])
        else:
            if direction == 0:
                wa = column[r + IA] * column[r + RAN] * column[r + RAN]
                wb = column[r + IB] * column[r + RBN] * column[r + RBN]
                if wp.static(own):
                    la = column[r + AX] * column[r + AX] + column[r + AY] * column[r + AY]
                    lb = column[r + NX] * column[r + NX] + column[r + NY] * column[r + NY]
                    return na * (ma * la + wa) + nb * (mb * lb + wb) + column[r + SOFT]
                return na * (ma + wa) + nb * (mb + wb)
            wa = column[r + IA] * column[r + RAT] * column[r + RAT]
            wb = column[r + IB] * column[r + RBT] * column[r + RBT]
            return na * (ma + wa) + nb * (mb + wb)

    @wp.func(module=module)
    def jacobi_row(block: int, lane: int, rows: t.Rows, motion: t.Motion, omega: real):
        """Jacobi with mass splitting (Tonge et al. 2012): each row meets its own share of both bodies.

        Velocities are read from ``motion.solved`` and the changes added to ``motion.summed``: the average over a
        body's shares.
        """
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        va = motion.solved[a]
        vb = motion.solved[b]
        na = real(rows.body_rows[a])
        nb = real(rows.body_rows[b])
        ln0 = rows.impulse[i]
        lt0 = rows.impulse[i + N_LANES]
        ln = ln0
        mass_n = split_mass(rows.column, r, na, nb, va[3], vb[3], 0)
        if mass_n > real(0.0):
            speed = normal_speed(rows.column, r, va, vb) + bias_of(rows.column, r, ln0)
            ln = within(rows.column, r, ln0 - omega * speed / mass_n)
        dn = ln - ln0
        lt = lt0
        mass_t = split_mass(rows.column, r, na, nb, va[3], vb[3], 1)
        limit = rows.column[r + MU] * ln
        if mass_t > real(0.0):
            vt = tangent_speed(rows.column, r, va, vb) + mixed(rows.column, r, na, nb) * dn
            lt = clamped(lt0 - omega * vt / mass_t, limit)
        dt = lt - lt0
        motion.summed[a] = changed(rows.column, r, motion.summed[a], 0, dn, dt)
        motion.summed[b] = changed(rows.column, r, motion.summed[b], 1, dn, dt)
        rows.impulse[i] = ln
        rows.impulse[i + N_LANES] = lt
        rows.change[i] = dn
        rows.change[i + N_LANES] = dt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def apply_row(block: int, lane: int, rows: t.Rows, bodies: wp.array(dtype=vec4), delta: wp.array(dtype=real)):
        """Velocities after given impulses: V += M^-1 J^T delta (Wu 2018, equation 2.26)."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        dn = delta[i]
        dt = delta[i + N_LANES]
        va = changed(rows.column, r, bodies[a], 0, dn, dt)
        vb = changed(rows.column, r, bodies[b], 1, dn, dt)
        bodies[a] = va
        bodies[b] = vb

    @wp.func(module=module)
    def push_row(block: int, lane: int, rows: t.Rows, bodies: wp.array(dtype=vec4), factor: real, limit: real):
        """Position correction of one row: displacements that remove a share of what overlaps after the step."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        va = bodies[a]
        vb = bodies[b]
        step = wp.max(factor * (normal_speed(rows.column, r, va, vb) + rows.column[r + GAP]), -limit)
        if wp.static(jointed):
            step = wp.min(step, limit)
        if wp.static(surfaced):
            if rows.column[r + ROLL] > real(0.0):  # what rolls is where it should be
                step = real(0.0)
        dn = within(rows.column, r, -(rows.column[r + EN] * step))
        if wp.static(own):
            dn = rows.column[r + HELD] * dn
        bodies[a] = normal_change(rows.column, r, va, 0, dn)
        bodies[b] = normal_change(rows.column, r, vb, 1, dn)
        return wp.abs(dn)

    @wp.func(module=module)
    def moving_row(block: int, lane: int, rows: t.Rows, motion: t.Motion, span: t.Span, shares: t.vec4):
        """What a row adds to a world's ``moving``: MOVING where the last sweep moved it, less one where it can move.

        SCARCE more where it moved it by FAR times as much, and ASTRAY where its bodies are not ALIKE then, or it moved
        farther than ``shares`` allow.
        """
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        va = motion.solved[a] - motion.predicted[a]
        vb = motion.solved[b] - motion.predicted[b]
        given = wp.max(wp.max(wp.abs(va[0]), wp.abs(va[1])), wp.max(wp.abs(vb[0]), wp.abs(vb[1])))
        limit = span.still + wp.max(wp.min(shares[0] * (given - span.fall), shares[1]), shares[2])
        dn = wp.abs(rows.change[i])
        dt = wp.abs(rows.change[i + N_LANES])
        n = limit * rows.column[r + EN]
        tangential = limit * rows.column[r + ET]
        count = int(0)
        if rows.column[r + EN] > real(0.0):
            count = -1
        if not (dn <= n and dt <= tangential):  # NaN is moved, and far
            count += IN_ALL
        if not (dn <= real(FAR) * n and dt <= real(FAR) * tangential):
            count += FAR_IN_ALL
            heavier = wp.min(motion.solved[a][3], motion.solved[b][3])
            if heavier > real(0.0) and wp.max(motion.solved[a][3], motion.solved[b][3]) > real(ALIKE) * heavier:
                count = LED_ASTRAY
        if not (dn <= shares[3] * n and dt <= shares[3] * tangential):
            count = LED_ASTRAY
        return count

    @wp.func(module=module)
    def lacking_row(block: int, lane: int, rows: t.Rows, still: real):
        """1 where a row without bounds lacked more than a speed as the last sweep came to it."""
        r = block * width + lane
        if rows.column[r + LO] >= -bounded or rows.column[r + HI] <= bounded:
            return 0
        return wp.where(wp.abs(rows.change[block * 2 * N_LANES + lane]) <= still * rows.column[r + EN], 0, 1)

    @wp.func(module=module)
    def natural_map_row(block: int, lane: int, rows: t.Rows, bodies: wp.array(dtype=vec4)):
        """Squared natural map of one row [(N s)^2]: impulse minus its projected step on the friction cone.

        The step r - e (u_n + mu |u_t|, u_t) is scaled by the row's effective mass e, so that both are impulses.
        """
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        va = bodies[rows.body[i]]
        vb = bodies[rows.body[i + N_LANES]]
        un = normal_speed(rows.column, r, va, vb) + bias_of(rows.column, r, rows.impulse[i])
        e = rows.column[r + EN]
        if wp.static(own):
            if rows.column[r + LO] != real(0.0) or rows.column[r + HI] < infinity:
                held = rows.impulse[i]
                off = held - within(rows.column, r, held - e * un)
                return off * off
        elif wp.static(jointed):
            if rows.column[r + LO] < real(0.0):
                return (e * un) * (e * un)
        ut = tangent_speed(rows.column, r, va, vb)
        mu = rows.column[r + MU]
        x = vec2(rows.impulse[i], rows.impulse[i + N_LANES])
        return natural_map_squared(x, vec2(x[0] - e * (un + mu * wp.abs(ut)), x[1] - e * ut), mu)

    return SimpleNamespace(
        normal_speed=normal_speed,
        tangent_speed_after=tangent_speed_after,
        normal_change=normal_change,
        changed=changed,
        least_normal=least_normal,
        within=within,
        sweep_row=sweep_row,
        jacobi_row=jacobi_row,
        apply_row=apply_row,
        push_row=push_row,
        moving_row=moving_row,
        lacking_row=lacking_row,
        natural_map_row=natural_map_row,
    )
