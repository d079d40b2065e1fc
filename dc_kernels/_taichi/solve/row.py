"""The sweep of one row, which clamps its friction to Coulomb's cone (Wu 2018, section 2.2.2), in scalar arithmetic.

``0.0 - x`` is what Warp makes of ``-x``: it has no zero with a sign.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.laws import clamped, linear_speed, relative_speed
from dc_kernels.solve.rows import COLUMNS, JOINTED


@cache
def row_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``sweep_row``, ``jacobi_row``, ``apply_row`` and ``push_row``: one row each.

    They are the oracle of the lanes, the serial colour and the colour schedule. Velocities ``bodies`` are those of
    ``motion`` that a sweep changes: solved ones, or displacements. ``k`` is a block's first column.
    """
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    columns = COLUMNS[variant]
    discs = variant == "discs"
    jointed, own = variant in JOINTED, variant == "rows"
    width = len(columns)
    at = {name: i for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # the variant that lacks a column never reads it
    RAN, RBN, RAT, RBT, IA, IB = (at.get(c, 0) for c in ("rAn", "rBn", "rAt", "rBt", "iA", "iB"))
    DA, DB, KA, KB, LO = (at.get(c, 0) for c in ("dA", "dB", "kA", "kB", "lo"))
    HI, AX, AY, SOFT, HELD = (at.get(c, 0) for c in ("hi", "ax", "ay", "soft", "held"))

    @ti.func
    def normal_speed(rows: t.Rows, k, lane, va, vb):
        n = vec2(rows.column[k + NX][lane], rows.column[k + NY][lane])
        speed = linear_speed(n, va, vb)
        if ti.static(own):
            speed = (n[0] * vb[0] - rows.column[k + AX][lane] * va[0]) + (
                n[1] * vb[1] - rows.column[k + AY][lane] * va[1]
            )
            speed = speed + (rows.column[k + RBN][lane] * vb[2] - rows.column[k + RAN][lane] * va[2])
        elif ti.static(not discs):
            speed = relative_speed(n, va, vb, rows.column[k + RAN][lane], rows.column[k + RBN][lane])
        return speed

    @ti.func
    def tangent_speed(rows: t.Rows, k, lane, va, vb):
        tangent = vec2(rows.column[k + NY][lane], 0.0 - rows.column[k + NX][lane])
        speed = real(0.0)
        if ti.static(discs):
            speed = relative_speed(tangent, va, vb, 0.0 - rows.column[k + DA][lane], rows.column[k + DB][lane])
        else:
            speed = relative_speed(tangent, va, vb, rows.column[k + RAT][lane], rows.column[k + RBT][lane])
        return speed

    @ti.func
    def mixed(rows: t.Rows, k, lane, na, nb):
        """Tangential speed that a unit of normal impulse gives, by shares of each body's mass [1/kg]: 0 of discs."""
        speed = real(0.0)
        if ti.static(not discs):
            wa = rows.column[k + IA][lane] * rows.column[k + RAN][lane] * rows.column[k + RAT][lane]
            wb = rows.column[k + IB][lane] * rows.column[k + RBN][lane] * rows.column[k + RBT][lane]
            speed = na * wa + nb * wb
        return speed

    @ti.func
    def normal_change_a(rows: t.Rows, k, lane, v, dn):
        """Velocity of body A after a normal impulse."""
        px = rows.column[k + (AX if own else NX)][lane] * dn
        py = rows.column[k + (AY if own else NY)][lane] * dn
        spin = v[2]
        if ti.static(not discs):
            spin = spin - rows.column[k + IA][lane] * (rows.column[k + RAN][lane] * dn)
        return vec4(v[0] - v[3] * px, v[1] - v[3] * py, spin, v[3])

    @ti.func
    def normal_change_b(rows: t.Rows, k, lane, v, dn):
        """Velocity of body B after a normal impulse."""
        px = rows.column[k + NX][lane] * dn
        py = rows.column[k + NY][lane] * dn
        spin = v[2]
        if ti.static(not discs):
            spin = spin + rows.column[k + IB][lane] * (rows.column[k + RBN][lane] * dn)
        return vec4(v[0] + v[3] * px, v[1] + v[3] * py, spin, v[3])

    @ti.func
    def changed_a(rows: t.Rows, k, lane, v, dn, dt):
        """Velocity of body A after an impulse along the normal and one along the tangent."""
        px = rows.column[k + (AX if own else NX)][lane] * dn + rows.column[k + NY][lane] * dt
        py = rows.column[k + (AY if own else NY)][lane] * dn - rows.column[k + NX][lane] * dt
        spin = v[2]
        if ti.static(discs):
            spin = spin + rows.column[k + KA][lane] * dt
        else:
            turn = rows.column[k + RAN][lane] * dn + rows.column[k + RAT][lane] * dt
            spin = spin - rows.column[k + IA][lane] * turn
        return vec4(v[0] - v[3] * px, v[1] - v[3] * py, spin, v[3])

    @ti.func
    def changed_b(rows: t.Rows, k, lane, v, dn, dt):
        """Velocity of body B after an impulse along the normal and one along the tangent."""
        px = rows.column[k + NX][lane] * dn + rows.column[k + NY][lane] * dt
        py = rows.column[k + NY][lane] * dn - rows.column[k + NX][lane] * dt
        spin = v[2]
        if ti.static(discs):
            spin = spin + rows.column[k + KB][lane] * dt
        else:
            turn = rows.column[k + RBN][lane] * dn + rows.column[k + RBT][lane] * dt
            spin = spin + rows.column[k + IB][lane] * turn
        return vec4(v[0] + v[3] * px, v[1] + v[3] * py, spin, v[3])

    @ti.func
    def least_normal(rows: t.Rows, k, lane):
        """Least normal impulse of a row: 0 of a contact, minus infinity of a joint."""
        low = real(0.0)
        if ti.static(jointed):
            low = rows.column[k + LO][lane]
        return low

    @ti.func
    def within(rows: t.Rows, k, lane, impulse):
        """A normal impulse within its bounds."""
        bounded = ti.max(impulse, least_normal(rows, k, lane))
        if ti.static(own):
            bounded = ti.min(bounded, rows.column[k + HI][lane])
        return bounded

    @ti.func
    def bias_of(rows: t.Rows, k, lane, impulse):
        """What the normal speed is to be zero with: the bias, and what a soft row gives way by for its impulse."""
        bias = rows.column[k + BIAS][lane]
        if ti.static(own):
            bias = bias + rows.column[k + SOFT][lane] * impulse
        return bias

    @ti.func
    def sweep_row(block, lane, rows: t.Rows, bodies: ti.template(), omega):
        """Projected Gauss-Seidel on one row, normal before friction; the larger impulse change [N s]."""
        k = block * width
        a = rows.body[2 * block][lane]
        b = rows.body[2 * block + 1][lane]
        va = bodies[a]
        vb = bodies[b]
        ln0 = rows.impulse[2 * block][lane]
        lt0 = rows.impulse[2 * block + 1][lane]
        vn = normal_speed(rows, k, lane, va, vb)
        step = (omega * rows.column[k + EN][lane]) * (vn + bias_of(rows, k, lane, ln0))
        ln = within(rows, k, lane, ln0 - step)
        dn = ln - ln0
        vt = tangent_speed(rows, k, lane, va, vb)
        if ti.static(not discs):
            vt = vt + mixed(rows, k, lane, 1.0, 1.0) * dn
        limit = rows.column[k + MU][lane] * ln
        lt = clamped(lt0 - (omega * rows.column[k + ET][lane]) * vt, limit)
        dt = lt - lt0
        bodies[a] = changed_a(rows, k, lane, va, dn, dt)
        bodies[b] = changed_b(rows, k, lane, vb, dn, dt)
        rows.impulse[2 * block][lane] = ln
        rows.impulse[2 * block + 1][lane] = lt
        rows.change[2 * block][lane] = dn
        rows.change[2 * block + 1][lane] = dt
        return ti.max(ti.abs(dn), ti.abs(dt))

    @ti.func
    def split_mass(rows: t.Rows, k, lane, na, nb, ma, mb):
        """J M^-1 J^T with each body's mass shared among its rows, along (normal, tangent)."""
        normal = real(0.0)
        along = real(0.0)
        if ti.static(discs):
            normal = na * ma + nb * mb
            ka = rows.column[k + KA][lane] * rows.column[k + DA][lane]
            kb = rows.column[k + KB][lane] * rows.column[k + DB][lane]
            along = na * (ma + ka) + nb * (mb + kb)
        else:
            ia = rows.column[k + IA][lane]
            ib = rows.column[k + IB][lane]
            ran = rows.column[k + RAN][lane]
            rbn = rows.column[k + RBN][lane]
            rat = rows.column[k + RAT][lane]
            rbt = rows.column[k + RBT][lane]
            normal = na * (ma + ia * ran * ran) + nb * (mb + ib * rbn * rbn)
            if ti.static(own):
                nx = rows.column[k + NX][lane]
                ny = rows.column[k + NY][lane]
                ax = rows.column[k + AX][lane]
                ay = rows.column[k + AY][lane]
                of_a = ma * (ax * ax + ay * ay) + ia * ran * ran
                of_b = mb * (nx * nx + ny * ny) + ib * rbn * rbn
                normal = na * of_a + nb * of_b + rows.column[k + SOFT][lane]
            along = na * (ma + ia * rat * rat) + nb * (mb + ib * rbt * rbt)
        return normal, along

    @ti.func
    def jacobi_row(block, lane, rows: t.Rows, solved: ti.template(), summed: ti.template(), omega):
        """Jacobi with mass splitting (Tonge et al. 2012): each row meets its own share of both bodies.

        Velocities are read from ``solved`` and the changes added to ``summed``: the average over a body's shares.
        """
        k = block * width
        a = rows.body[2 * block][lane]
        b = rows.body[2 * block + 1][lane]
        va = solved[a]
        vb = solved[b]
        na = ti.cast(rows.body_rows[a], real)
        nb = ti.cast(rows.body_rows[b], real)
        ln0 = rows.impulse[2 * block][lane]
        lt0 = rows.impulse[2 * block + 1][lane]
        ln = ln0
        mass_n, mass_t = split_mass(rows, k, lane, na, nb, va[3], vb[3])
        if mass_n > 0.0:
            speed = normal_speed(rows, k, lane, va, vb) + bias_of(rows, k, lane, ln0)
            ln = within(rows, k, lane, ln0 - omega * speed / mass_n)
        dn = ln - ln0
        lt = lt0
        limit = rows.column[k + MU][lane] * ln
        if mass_t > 0.0:
            vt = tangent_speed(rows, k, lane, va, vb) + mixed(rows, k, lane, na, nb) * dn
            lt = clamped(lt0 - omega * vt / mass_t, limit)
        dt = lt - lt0
        summed[a] = changed_a(rows, k, lane, summed[a], dn, dt)
        summed[b] = changed_b(rows, k, lane, summed[b], dn, dt)
        rows.impulse[2 * block][lane] = ln
        rows.impulse[2 * block + 1][lane] = lt
        rows.change[2 * block][lane] = dn
        rows.change[2 * block + 1][lane] = dt
        return ti.max(ti.abs(dn), ti.abs(dt))

    @ti.func
    def apply_row(block, lane, rows: t.Rows, bodies: ti.template(), anew):
        """Velocities after impulses, V += M^-1 J^T delta: after all of them where ``anew`` is 1, else their change."""
        k = block * width
        a = rows.body[2 * block][lane]
        b = rows.body[2 * block + 1][lane]
        dn = rows.change[2 * block][lane]
        dt = rows.change[2 * block + 1][lane]
        if anew == 1:
            dn = rows.impulse[2 * block][lane]
            dt = rows.impulse[2 * block + 1][lane]
        va = changed_a(rows, k, lane, bodies[a], dn, dt)
        vb = changed_b(rows, k, lane, bodies[b], dn, dt)
        bodies[a] = va
        bodies[b] = vb

    @ti.func
    def push_row(block, lane, rows: t.Rows, bodies: ti.template(), factor, limit):
        """Position correction of one row: displacements that remove a share of what overlaps after the step."""
        k = block * width
        a = rows.body[2 * block][lane]
        b = rows.body[2 * block + 1][lane]
        va = bodies[a]
        vb = bodies[b]
        step = ti.max(factor * (normal_speed(rows, k, lane, va, vb) + rows.column[k + GAP][lane]), 0.0 - limit)
        if ti.static(jointed):
            step = ti.min(step, limit)
        dn = within(rows, k, lane, 0.0 - rows.column[k + EN][lane] * step)
        if ti.static(own):
            dn = rows.column[k + HELD][lane] * dn
        bodies[a] = normal_change_a(rows, k, lane, va, dn)
        bodies[b] = normal_change_b(rows, k, lane, vb, dn)
        return ti.abs(dn)

    return SimpleNamespace(
        sweep_row=sweep_row,
        jacobi_row=jacobi_row,
        apply_row=apply_row,
        push_row=push_row,
    )
