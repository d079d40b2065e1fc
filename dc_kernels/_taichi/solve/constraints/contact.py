"""The rows of contacts: J = [-n, -r_A x n, n, r_B x n] along the normal of each and, with t for n, its tangent.

These are equations 2.21 and 2.22 of Wu (2018), and the effective mass, 1 / (J M^-1 J^T), is 2.24 and 2.25.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.bodies import body_functions, largest, pairs_at, values_at
from dc_kernels.model.config import POSITION_CORRECTIONS
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
OPEN = 1e6  # a row that lets this many times the gap close within the step never acts
INFINITY = float("inf")


@cache
def contact_rows(dtype: str, variant: str) -> Any:
    """The function that makes the rows of a block of contacts, side by side."""
    t = group_types(dtype)
    vec8 = t.vec8
    of_bodies = body_functions(dtype)
    bodies_at, indices = of_bodies.bodies_at, of_bodies.indices
    columns = COLUMNS[variant]
    width = len(columns)
    discs = variant == "discs"
    jointed, own = variant in JOINTED, variant == "rows"
    at = {name: i for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # the variant that lacks a column never writes it
    RAN, RBN, RAT, RBT, IA, IB = (at.get(c, 0) for c in ("rAn", "rBn", "rAt", "rBt", "iA", "iB"))
    DA, DB, KA, KB, LO = (at.get(c, 0) for c in ("dA", "dB", "kA", "kB", "lo"))
    HI, AX, AY, SOFT, HELD = (at.get(c, 0) for c in ("hi", "ax", "ay", "soft", "held"))

    @ti.func
    def inverse_or_zero(x):
        return ti.select(x > 0.0, 1.0 / x, vec8(0.0))

    @ti.func
    def along_normal(nx, ny, ran, rbn, x, y, spin_a, spin_b):
        """Speeds along the normals of bodies that move by (x, y) against each other."""
        speed = nx * x + ny * y
        if ti.static(not discs):
            speed = speed + (rbn * spin_b - ran * spin_a)
        return speed

    @ti.func
    def make_contact_rows(
        w,
        block,
        floor,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """The rows of a block of world w whose contacts stand where its bodies A then do; ``floor``: see ``lanes``.

        Bias velocity: a gap may close within the step (gap / dt), but one below the slop counts as closed: the
        round-off of resting gaps would change the problem in each step and cost the warm start a tenth of its gain.
        A contact that hits within the step faster than the threshold, which is 0 where e is 1, leaves with -e times the
        speed that it had before the step's forces: bounces then mirror semi-implicit Euler, and an elastic ball returns
        to its height to round-off for ever. A gap of a bouncing pair that stays open is left alone: what another impact
        pushes across it bounces in the next step. A closed separating contact of such a pair may be left approaching
        with e times its speed at most (Moreau 1988), without which several impacts at once can gain energy.
        """
        dt = motion.step_dt[w]
        per_dt = 1.0 / dt
        size = model.length_scale[w]
        slop = config.slop * size
        pull = model.gravity[w]
        hardly = config.restitution_threshold * ti.sqrt(ti.sqrt(pull[0] * pull[0] + pull[1] * pull[1]) * size)
        k = block * width
        c = indices(rows, 2 * block)
        a = values_at(contacts.body_a, c)
        b = values_at(contacts.body_b, c)
        nx, ny = pairs_at(contacts.normal, c)
        arm_ax, arm_ay = pairs_at(contacts.arm_a, c)
        arm_bx, arm_by = pairs_at(contacts.arm_b, c)
        gap = values_at(contacts.gap, c)
        e = values_at(contacts.restitution, c)
        mu = values_at(contacts.friction, c)
        rows.body[2 * block] = a
        rows.body[2 * block + 1] = b
        ax, ay, aw, am = bodies_at(motion.predicted, a, floor)
        bx, by, bw, bm = bodies_at(motion.predicted, b, floor)
        ia = values_at(model.inv_inertia, a)
        ib = values_at(model.inv_inertia, b)
        if ti.static(own):
            ia = ia / (1.0 + ia * values_at(rows.stiff_inertia, a))
            ib = ib / (1.0 + ib * values_at(rows.stiff_inertia, b))
        rat = arm_ax * (nx * -1.0) - arm_ay * ny
        rbt = arm_bx * (nx * -1.0) - arm_by * ny
        ran = vec8(0.0)
        rbn = vec8(0.0)
        en = inverse_or_zero(am + bm)
        if ti.static(not discs):
            ran = arm_ax * ny - arm_ay * nx
            rbn = arm_bx * ny - arm_by * nx
            en = inverse_or_zero(am + bm + ia * ran * ran + ib * rbn * rbn)
        et = inverse_or_zero(am + bm + ia * rat * rat + ib * rbt * rbt)
        x = bx - ax
        y = by - ay
        un = along_normal(nx, ny, ran, rbn, x, y, aw, bw)
        ut = (ny * x + (nx * -1.0) * y) + (rbt * bw - rat * aw)
        bias = ti.select(gap > slop, gap * per_dt, vec8(0.0))
        counted = vec8(1.0)
        if config.position_correction == BAUMGARTE:
            limit = vec8(0.0 - config.max_correction * size)
            bias = ti.select(gap < -slop, ti.max(config.position_factor * (gap + slop), limit) * per_dt, bias)
        if largest(e) > 0.0:
            vax, vay = pairs_at(state.velocity, a)
            vbx, vby = pairs_at(state.velocity, b)
            spin_a = values_at(state.angular_velocity, a)
            spin_b = values_at(state.angular_velocity, b)
            before = along_normal(nx, ny, ran, rbn, vbx - vax, vby - vay, spin_a, spin_b)
            after = e * before
            threshold = ti.select(e < 1.0, vec8(hardly), vec8(0.0))
            closed = ti.select(before < threshold * -1.0, ti.min(bias, after), bias)
            closed = ti.select(before > 0.0, ti.max(bias, after), closed)
            # a gap that stays open
            open_bias = ti.select(gap + un * dt >= 0.0, OPEN * gap * per_dt, closed)
            open_counted = ti.select(gap + un * dt >= 0.0, vec8(0.0), counted)
            bias = ti.select(e > 0.0, ti.select(gap > slop, open_bias, closed), bias)
            counted = ti.select(e > 0.0, ti.select(gap > slop, open_counted, counted), counted)
        rows.column[k + NX] = nx
        rows.column[k + NY] = ny
        if ti.static(discs):
            rows.column[k + DA] = rat * -1.0
            rows.column[k + DB] = rbt
            rows.column[k + KA] = (ia * rat) * -1.0
            rows.column[k + KB] = ib * rbt
        else:
            rows.column[k + RAN] = ran
            rows.column[k + RBN] = rbn
            rows.column[k + RAT] = rat
            rows.column[k + RBT] = rbt
            rows.column[k + IA] = ia
            rows.column[k + IB] = ib
        rows.column[k + EN] = en
        rows.column[k + ET] = et
        rows.column[k + BIAS] = bias
        rows.column[k + MU] = mu
        rows.column[k + GAP] = gap + slop
        if ti.static(jointed):
            rows.column[k + LO] = vec8(0.0)
        if ti.static(own):  # one normal serves both bodies, and pushes without bound
            rows.column[k + HI] = vec8(INFINITY)
            rows.column[k + AX] = nx
            rows.column[k + AY] = ny
            rows.column[k + SOFT] = vec8(0.0)
            rows.column[k + HELD] = vec8(1.0)
        alone = counted * ((en * (un + bias)) * (en * (un + bias)) + (en * ut) * (en * ut))
        for lane in ti.static(range(LANES)):
            rows.square[c[lane]] = alone[lane]

    return make_contact_rows
