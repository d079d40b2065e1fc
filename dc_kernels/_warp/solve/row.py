"""The scalar arithmetic of one row (seed, 2.2.2): oracle of the SIMD lanes, and what runs where there are none."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels.solve.rows import COLUMNS, LANES

N_LANES = wp.constant(LANES)


@cache
def row_functions(dtype: str, variant: str) -> dict[str, Any]:
    """``sweep_row``, ``jacobi_row``, ``apply_row``, ``push_row`` and ``natural_map_row``: one row each.

    They are the oracle of the lanes, the serial colour, the colour schedule and the path on a GPU.
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    module = kernel_module("solver", dtype, variant)
    columns = COLUMNS[variant]
    discs = variant == "discs"
    joints = variant == "joints"
    width = wp.constant(len(columns) * LANES)
    at = {name: wp.constant(i * LANES) for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # the variant that lacks a column never reads it
    RAN, RBN, RAT, RBT, IA, IB = (at.get(c, 0) for c in ("rAn", "rBn", "rAt", "rBt", "iA", "iB"))
    DA, DB, KA, KB, LO = (at.get(c, 0) for c in ("dA", "dB", "kA", "kB", "lo"))

    @wp.func(module=module)
    def normal_speed(rows: wp.array(dtype=real), r: int, va: vec4, vb: vec4):
        vn = rows[r + NX] * (vb[0] - va[0]) + rows[r + NY] * (vb[1] - va[1])
        if wp.static(not discs):
            vn = vn + (rows[r + RBN] * vb[2] - rows[r + RAN] * va[2])
        return vn

    @wp.func(module=module)
    def tangent_speed(rows: wp.array(dtype=real), r: int, va: vec4, vb: vec4):
        vt = rows[r + NY] * (vb[0] - va[0]) - rows[r + NX] * (vb[1] - va[1])
        if wp.static(discs):
            vt = vt + (rows[r + DB] * vb[2] + rows[r + DA] * va[2])
        else:
            vt = vt + (rows[r + RBT] * vb[2] - rows[r + RAT] * va[2])
        return vt

    @wp.func(module=module)
    def normal_change(rows: wp.array(dtype=real), r: int, v: vec4, side: int, dn: real):
        """Velocity of body A (side 0) or B (side 1) after a normal impulse."""
        px = rows[r + NX] * dn
        py = rows[r + NY] * dn
        x = v[0]
        y = v[1]
        spin = v[2]
        if side == 0:
            x = x - v[3] * px
            y = y - v[3] * py
            if wp.static(not discs):
                spin = spin - rows[r + IA] * (rows[r + RAN] * dn)
        else:
            x = x + v[3] * px
            y = y + v[3] * py
            if wp.static(not discs):
                spin = spin + rows[r + IB] * (rows[r + RBN] * dn)
        return vec4(x, y, spin, v[3])

    @wp.func(module=module)
    def tangent_change(rows: wp.array(dtype=real), r: int, v: vec4, side: int, dt: real):
        """Velocity of body A (side 0) or B (side 1) after a tangential impulse."""
        qx = rows[r + NY] * dt
        qy = rows[r + NX] * dt
        x = v[0]
        y = v[1]
        spin = v[2]
        if side == 0:
            x = x - v[3] * qx
            y = y + v[3] * qy
            if wp.static(discs):
                spin = spin + rows[r + KA] * dt
            else:
                spin = spin - rows[r + IA] * (rows[r + RAT] * dt)
        else:
            x = x + v[3] * qx
            y = y - v[3] * qy
            if wp.static(discs):
                spin = spin + rows[r + KB] * dt
            else:
                spin = spin + rows[r + IB] * (rows[r + RBT] * dt)
        return vec4(x, y, spin, v[3])

    @wp.func(module=module)
    def sweep_row(
        block: int,
        lane: int,
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        omega: real,
    ):
        """Projected Gauss-Seidel on one row, normal before friction; the larger impulse change [N s]."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = row_body[i]
        b = row_body[i + N_LANES]
        va = bodies[a]
        vb = bodies[b]
        ln0 = row_impulse[i]
        lt0 = row_impulse[i + N_LANES]
        low = real(0.0)
        if wp.static(joints):
            low = rows[r + LO]
        ln = wp.max(ln0 - (omega * rows[r + EN]) * (normal_speed(rows, r, va, vb) + rows[r + BIAS]), low)
        dn = ln - ln0
        # a disc's normal impulse has no tangential effect: its tangent need not wait for it
        vt = tangent_speed(rows, r, va, vb)
        va = normal_change(rows, r, va, 0, dn)
        vb = normal_change(rows, r, vb, 1, dn)
        if wp.static(not discs):
            vt = tangent_speed(rows, r, va, vb)
        limit = rows[r + MU] * ln
        lt = wp.min(wp.max(lt0 - (omega * rows[r + ET]) * vt, -limit), limit)
        dt = lt - lt0
        bodies[a] = tangent_change(rows, r, va, 0, dt)
        bodies[b] = tangent_change(rows, r, vb, 1, dt)
        row_impulse[i] = ln
        row_impulse[i + N_LANES] = lt
        row_change[i] = dn
        row_change[i + N_LANES] = dt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def split_mass(rows: wp.array(dtype=real), r: int, na: real, nb: real, ma: real, mb: real, direction: int):
        """J M^-1 J^T with each body's mass shared among its rows (direction 0 normal, 1 tangent, 2 mixed)."""
        if wp.static(discs):
            if direction == 0:
                return na * ma + nb * mb
            if direction == 1:
                return na * (ma + rows[r + KA] * rows[r + DA]) + nb * (mb + rows[r + KB] * rows[r + DB])
            return real(0.0)
        else:
            if direction == 0:
                wa = rows[r + IA] * rows[r + RAN] * rows[r + RAN]
                wb = rows[r + IB] * rows[r + RBN] * rows[r + RBN]
                return na * (ma + wa) + nb * (mb + wb)
            if direction == 1:
                wa = rows[r + IA] * rows[r + RAT] * rows[r + RAT]
                wb = rows[r + IB] * rows[r + RBT] * rows[r + RBT]
                return na * (ma + wa) + nb * (mb + wb)
            wa = rows[r + IA] * rows[r + RAN] * rows[r + RAT]
            wb = rows[r + IB] * rows[r + RBN] * rows[r + RBT]
            return na * wa + nb * wb

    @wp.func(module=module)
    def jacobi_row(
        block: int,
        lane: int,
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        body_rows: wp.array(dtype=wp.int32),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        summed: wp.array(dtype=vec4),
        omega: real,
    ):
        """Jacobi with mass splitting (Tonge et al. 2012): each row meets its own share of both bodies.

        Velocities are read from ``bodies`` and the changes added to ``summed``: the average over a body's shares.
        """
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = row_body[i]
        b = row_body[i + N_LANES]
        va = bodies[a]
        vb = bodies[b]
        na = real(body_rows[a])
        nb = real(body_rows[b])
        ln0 = row_impulse[i]
        lt0 = row_impulse[i + N_LANES]
        low = real(0.0)
        if wp.static(joints):
            low = rows[r + LO]
        ln = ln0
        mass_n = split_mass(rows, r, na, nb, va[3], vb[3], 0)
        if mass_n > real(0.0):
            ln = wp.max(ln0 - omega * (normal_speed(rows, r, va, vb) + rows[r + BIAS]) / mass_n, low)
        dn = ln - ln0
        lt = lt0
        mass_t = split_mass(rows, r, na, nb, va[3], vb[3], 1)
        limit = rows[r + MU] * ln
        if mass_t > real(0.0):
            vt = tangent_speed(rows, r, va, vb) + split_mass(rows, r, na, nb, va[3], vb[3], 2) * dn
            lt = wp.min(wp.max(lt0 - omega * vt / mass_t, -limit), limit)
        dt = lt - lt0
        summed[a] = tangent_change(rows, r, normal_change(rows, r, summed[a], 0, dn), 0, dt)
        summed[b] = tangent_change(rows, r, normal_change(rows, r, summed[b], 1, dn), 1, dt)
        row_impulse[i] = ln
        row_impulse[i + N_LANES] = lt
        row_change[i] = dn
        row_change[i + N_LANES] = dt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def apply_row(
        block: int,
        lane: int,
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        delta: wp.array(dtype=real),
    ):
        """Velocities after given impulses: V += M^-1 J^T delta (2.26)."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = row_body[i]
        b = row_body[i + N_LANES]
        dn = delta[i]
        dt = delta[i + N_LANES]
        va = tangent_change(rows, r, normal_change(rows, r, bodies[a], 0, dn), 0, dt)
        vb = tangent_change(rows, r, normal_change(rows, r, bodies[b], 1, dn), 1, dt)
        bodies[a] = va
        bodies[b] = vb

    @wp.func(module=module)
    def push_row(
        block: int,
        lane: int,
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        factor: real,
        limit: real,
    ):
        """Position correction of one row: displacements that remove a share of what overlaps after the step."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = row_body[i]
        b = row_body[i + N_LANES]
        va = bodies[a]
        vb = bodies[b]
        step = wp.max(factor * (normal_speed(rows, r, va, vb) + rows[r + GAP]), -limit)
        low = real(0.0)
        if wp.static(joints):
            low = rows[r + LO]
            step = wp.min(step, limit)
        dn = wp.max(-(rows[r + EN] * step), low)
        bodies[a] = normal_change(rows, r, va, 0, dn)
        bodies[b] = normal_change(rows, r, vb, 1, dn)
        return wp.abs(dn)

    @wp.func(module=module)
    def natural_map_row(
        block: int,
        lane: int,
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
    ):
        """Squared natural map of one row [(N s)^2]: impulse minus its projected step on the friction cone.

        The step r - e (u_n + mu |u_t|, u_t) is scaled by the row's effective mass e, so that both are impulses.
        """
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        va = bodies[row_body[i]]
        vb = bodies[row_body[i + N_LANES]]
        un = normal_speed(rows, r, va, vb) + rows[r + BIAS]
        e = rows[r + EN]
        if wp.static(joints):
            if rows[r + LO] < real(0.0):
                return (e * un) * (e * un)
        ut = tangent_speed(rows, r, va, vb)
        mu = rows[r + MU]
        ln = row_impulse[i]
        lt = row_impulse[i + N_LANES]
        zn = ln - e * (un + mu * wp.abs(ut))
        zt = lt - e * ut
        size = wp.abs(zt)
        if zn < real(0.0) or size > mu * zn:
            if mu * size <= -zn:
                zn = real(0.0)
                zt = real(0.0)
            else:
                zn = (zn + mu * size) / (real(1.0) + mu * mu)
                zt = wp.sign(zt) * (mu * zn)
        return (ln - zn) * (ln - zn) + (lt - zt) * (lt - zt)

    return {
        "sweep_row": sweep_row,
        "jacobi_row": jacobi_row,
        "apply_row": apply_row,
        "push_row": push_row,
        "natural_map_row": natural_map_row,
    }
