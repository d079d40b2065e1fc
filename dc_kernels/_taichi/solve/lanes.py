"""SIMD lanes: LANES rows of one colour solved side by side, as vectors of Taichi.

The arithmetic is that of ``row``, operation by operation, and that of Warp's lanes. All that a block needs is loaded
before anything is stored: where an array lies is looked up anew after each store. The compiler knows of an index after
``MASK``, which leaves it as it is, that adding a column's number to it does not overflow: each then takes no
instruction of its own, a tenth of a sweep's.

A sweep takes two blocks of a colour side by side, as Warp's does (``_warp/native/solve/take_blocks.h``): on one core at
2.5 GHz with AVX-512 a contact of 1 000 discs and a sweep take 5 ns, where they took 6.4 ns one after the other. Tried
and left: two blocks in ``apply``, ``push`` and ``extrapolate`` gain nothing, and take longer to compile; a sweep that
always takes two, the last of an odd number twice, loses 5 % of a step of 100 discs.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.lanes import MASK
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.bodies import body_functions, largest, magnitude, total
from dc_kernels._taichi.solve.laws import clamped
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.iteration import ALIKE, ASTRAY, FAR, MOVING, SCARCE
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES, SERIAL_COLOR

INFINITY = float("inf")


@cache
def lane_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``sweep`` over a world's colours, ``apply``, ``push`` and ``extrapolate`` over the blocks b0 .. b1 of its rows.

    A block is a tuple of its indices and of the velocities of its bodies A and B, each a vector for each component;
    functions of a stage give back new ones, so that one text serves one block and two.
    ``moving``, ``lacking`` and ``natural_map`` write nothing: they are of blocks whose rows share bodies, too.
    """
    t = group_types(dtype)
    vec8 = t.vec8
    of_bodies = body_functions(dtype)
    load_bodies, store_bodies, pushed = of_bodies.load_bodies, of_bodies.store_bodies, of_bodies.pushed
    columns = COLUMNS[variant]
    width = len(columns)
    discs = variant == "discs"
    jointed, own = variant in JOINTED, variant == "rows"
    at = {name: i for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # discs have dA, dB, kA and kB for arms along the tangent and turns by an impulse along it
    RAN, RBN = at.get("rAn", 0), at.get("rBn", 0)
    RAT, RBT, WA, WB = (at[c] for c in (("dA", "dB", "kA", "kB") if discs else ("rAt", "rBt", "iA", "iB")))
    LO, HI, SOFT, HELD = (at.get(c, 0) for c in ("lo", "hi", "soft", "held"))
    AX, AY = at.get("ax", NX), at.get("ay", NY)  # of a caller's own rows; else one normal serves both bodies

    @ti.func
    def least(rows: t.Rows, k):
        """The least normal impulses: 0 of a contact, minus infinity of a joint."""
        low = vec8(0.0)
        if ti.static(jointed):
            low = rows.column[k + LO]
        return low

    @ti.func
    def load_block(rows: t.Rows, bodies: ti.template(), b, floor):
        """Indices of a block's first column and first vector of impulses, and what moves its bodies."""
        k = (b * width) & MASK
        r = (2 * b) & MASK
        return k, r, load_bodies(rows, r, bodies, floor), load_bodies(rows, r + 1, bodies, floor)

    @ti.func
    def store_block(rows: t.Rows, bodies: ti.template(), r, of_a, of_b, floor):
        """Velocities of a block's bodies to memory."""
        ax, ay, aw, am = of_a
        bx, by, bw, bm = of_b
        store_bodies(rows, r, bodies, ax, ay, aw, am, floor)
        store_bodies(rows, r + 1, bodies, bx, by, bw, bm, floor)

    @ti.func
    def normal_speed(rows: t.Rows, k, of_a, of_b):
        """Speed of B against A along the normal [m/s]."""
        ax, ay, aw, _ = of_a
        bx, by, bw, _ = of_b
        vn = rows.column[k + NX] * (bx - ax) + rows.column[k + NY] * (by - ay)
        if ti.static(own):
            vn = (rows.column[k + NX] * bx - rows.column[k + AX] * ax) + (
                rows.column[k + NY] * by - rows.column[k + AY] * ay
            )
        if ti.static(not discs):
            vn = vn + (rows.column[k + RBN] * bw - rows.column[k + RAN] * aw)
        return vn

    @ti.func
    def tangent_speed(rows: t.Rows, k, of_a, of_b):
        """Speed of B against A along the tangent [m/s]."""
        ax, ay, aw, _ = of_a
        bx, by, bw, _ = of_b
        vt = rows.column[k + NY] * (bx - ax) - rows.column[k + NX] * (by - ay)
        if ti.static(discs):
            vt = vt + (rows.column[k + RBT] * bw + rows.column[k + RAT] * aw)
        else:
            vt = vt + (rows.column[k + RBT] * bw - rows.column[k + RAT] * aw)
        return vt

    @ti.func
    def add_normal(rows: t.Rows, k, of_a, of_b, dn):
        """The bodies after an impulse along the normal."""
        ax, ay, aw, am = of_a
        bx, by, bw, bm = of_b
        ax = ax - am * (rows.column[k + AX] * dn)
        ay = ay - am * (rows.column[k + AY] * dn)
        bx = bx + bm * (rows.column[k + NX] * dn)
        by = by + bm * (rows.column[k + NY] * dn)
        if ti.static(not discs):
            aw = aw - rows.column[k + WA] * (rows.column[k + RAN] * dn)
            bw = bw + rows.column[k + WB] * (rows.column[k + RBN] * dn)
        return (ax, ay, aw, am), (bx, by, bw, bm)

    @ti.func
    def add_both(rows: t.Rows, k, of_a, of_b, dn, dt):
        """The bodies after an impulse along the normal and one along the tangent."""
        ax, ay, aw, am = of_a
        bx, by, bw, bm = of_b
        qx = rows.column[k + NY] * dt
        qy = rows.column[k + NX] * dt
        ax = ax - am * (rows.column[k + AX] * dn + qx)
        ay = ay - am * (rows.column[k + AY] * dn - qy)
        bx = bx + bm * (rows.column[k + NX] * dn + qx)
        by = by + bm * (rows.column[k + NY] * dn - qy)
        if ti.static(discs):
            aw = aw + rows.column[k + WA] * dt
            bw = bw + rows.column[k + WB] * dt
        else:
            aw = aw - rows.column[k + WA] * (rows.column[k + RAN] * dn + rows.column[k + RAT] * dt)
            bw = bw + rows.column[k + WB] * (rows.column[k + RBN] * dn + rows.column[k + RBT] * dt)
        return (ax, ay, aw, am), (bx, by, bw, bm)

    @ti.func
    def swept_normal(rows: t.Rows, block, omega):
        """A block, its normal impulses after a sweep, their change, and the speeds along the tangent after it.

        The latter follow from what they were: nothing waits for the bodies' new velocities.
        """
        k, r, of_a, of_b = block
        ln0 = rows.impulse[r]
        bias = rows.column[k + BIAS]
        if ti.static(own):
            bias = bias + rows.column[k + SOFT] * ln0
        vn = normal_speed(rows, k, of_a, of_b)
        ln = ti.max(ln0 - (omega * rows.column[k + EN]) * (vn + bias), least(rows, k))
        if ti.static(own):
            ln = ti.min(ln, rows.column[k + HI])
        dn = ln - ln0
        vt = tangent_speed(rows, k, of_a, of_b)
        if ti.static(not discs):  # a disc's normal impulse has no tangential effect
            wa = rows.column[k + WA] * rows.column[k + RAN] * rows.column[k + RAT]
            wb = rows.column[k + WB] * rows.column[k + RBN] * rows.column[k + RBT]
            vt = vt + (wa + wb) * dn
        return k, r, of_a, of_b, ln, dn, vt

    @ti.func
    def swept_tangent(rows: t.Rows, block, omega):
        """A block after the impulses of a sweep, and these and their changes along both."""
        k, r, of_a, of_b, ln, dn, vt = block
        lt0 = rows.impulse[r + 1]
        limit = rows.column[k + MU] * ln
        lt = clamped(lt0 - (omega * rows.column[k + ET]) * vt, limit)
        dt = lt - lt0
        new_a, new_b = add_both(rows, k, of_a, of_b, dn, dt)
        return r, new_a, new_b, ln, lt, dn, dt

    @ti.func
    def sweep_blocks(rows: t.Rows, bodies: ti.template(), b, count: ti.template(), omega, floor):
        """Sweep some blocks side by side; the largest impulse changes [N s]."""
        most = vec8(0.0)
        some = [load_block(rows, bodies, b + i, floor) for i in ti.static(range(count))]
        half = [swept_normal(rows, block, omega) for block in ti.static(some)]
        full = [swept_tangent(rows, block, omega) for block in ti.static(half)]
        for r, _a, _b, ln, lt, dn, dt in ti.static(full):
            rows.impulse[r] = ln
            rows.impulse[r + 1] = lt
            rows.change[r] = dn
            rows.change[r + 1] = dt
            most = ti.max(most, ti.max(magnitude(dn), magnitude(dt)))
        for block in ti.static(full):
            store_block(rows, bodies, block[0], block[1], block[2], floor)
        return most

    @ti.func
    def sweep(rows: t.Rows, bodies: ti.template(), at, omega, floor):
        """Projected Gauss-Seidel on a world's colours but the serial one; the largest impulse change [N s].

        ``at``: where the world's colours begin in ``rows.color_block``. Two blocks of a colour share no body that
        moves: one computes while the other waits for what it has just computed. vn, vt: speeds of B against A along
        the normal and the tangent [m/s]; ln0, lt0: impulses along them before the sweep, ln, lt: after it, dn, dt:
        their changes [N s].
        """
        most = vec8(0.0)
        b = rows.color_block[at]
        last = rows.color_block[at + SERIAL_COLOR]
        color = at
        while b < last:
            color += 1
            end = rows.color_block[color]
            while b + 2 <= end:
                most = ti.max(most, sweep_blocks(rows, bodies, b, 2, omega, floor))
                b += 2
            if b < end:
                most = ti.max(most, sweep_blocks(rows, bodies, b, 1, omega, floor))
                b += 1
        return largest(most)

    @ti.func
    def apply(rows: t.Rows, bodies: ti.template(), anew, b0, b1, floor):
        """Velocities after impulses, V += M^-1 J^T delta: after all of them where ``anew`` is 1, else their change."""
        for b in range(b0, b1):
            k, r, of_a, of_b = load_block(rows, bodies, b, floor)
            dn = rows.change[r]
            dt = rows.change[r + 1]
            if anew == 1:
                dn = rows.impulse[r]
                dt = rows.impulse[r + 1]
            new_a, new_b = add_both(rows, k, of_a, of_b, dn, dt)
            store_block(rows, bodies, r, new_a, new_b, floor)

    @ti.func
    def push(rows: t.Rows, bodies: ti.template(), b0, b1, factor, limit, floor):
        """Position correction: displacements that remove a share of what overlaps; the largest push."""
        most = vec8(0.0)
        for b in range(b0, b1):
            k, r, of_a, of_b = load_block(rows, bodies, b, floor)
            vn = normal_speed(rows, k, of_a, of_b)
            step = ti.max(factor * (vn + rows.column[k + GAP]), vec8(limit * -1.0))
            if ti.static(jointed):
                step = ti.min(step, vec8(limit))
            dn = ti.max((rows.column[k + EN] * step) * -1.0, least(rows, k))
            if ti.static(own):
                dn = rows.column[k + HELD] * ti.min(dn, rows.column[k + HI])
            new_a, new_b = add_normal(rows, k, of_a, of_b, dn)
            most = ti.max(most, magnitude(dn))
            store_block(rows, bodies, r, new_a, new_b, floor)
        return largest(most)

    @ti.func
    def extrapolate(rows: t.Rows, b0, b1, alpha):
        """Impulses moved on along their change, x <- clamp(x + alpha change); change is then what they moved by."""
        for b in range(b0, b1):
            k = (b * width) & MASK
            r = (2 * b) & MASK
            mu = rows.column[k + MU]
            low = least(rows, k)
            xn = rows.impulse[r]
            xt = rows.impulse[r + 1]
            dn = rows.change[r]
            dt = rows.change[r + 1]
            yn = ti.max(xn + alpha * dn, low)
            if ti.static(own):
                yn = ti.min(yn, rows.column[k + HI])
            limit = mu * yn
            yt = clamped(xt + alpha * dt, limit)
            rows.impulse[r] = yn
            rows.impulse[r + 1] = yt
            rows.change[r] = yn - xn
            rows.change[r + 1] = yt - xt

    @ti.func
    def moving(rows: t.Rows, motion: t.Motion, b0, b1, still, fall, shares, floor):
        """MOVING times the rows that the last sweep still moved, SCARCE times those moved FAR, less all that can move.

        ASTRAY where it moved one farther than ``shares`` allow, or one by FAR whose bodies are not ALIKE. Moved is one
        whose speed it changed by more than ``still`` + a share times what the impulses of the step have changed the
        velocity of the faster body by, beyond ``fall``, ``most`` at most, or than ``still`` + ``least`` where that is
        more; ``shares``: this share, ``most``, ``least``, and how many times as much no row may be moved.
        """
        all = LANES * (b1 - b0)
        count = 0
        b = b0
        while b < b1:
            k = (b * width) & MASK
            r = (2 * b) & MASK
            given = ti.max(pushed(rows, r, motion, floor), pushed(rows, r + 1, motion, floor))
            limit = still + ti.max(ti.min(shares[0] * (given - fall), vec8(shares[1])), vec8(shares[2]))
            dn = magnitude(rows.change[r])
            dt = magnitude(rows.change[r + 1])
            n = limit * rows.column[k + EN]
            tangential = limit * rows.column[k + ET]
            # NaN is moved, and farthest
            moved = ti.select(dn <= n, ti.select(dt <= tangential, vec8(0.0), vec8(1.0)), vec8(1.0))
            far = ti.select(dn <= FAR * n, ti.select(dt <= FAR * tangential, vec8(0.0), vec8(1.0)), vec8(1.0))
            within = ti.select(dt <= shares[3] * tangential, vec8(0.0), vec8(1.0))
            away = ti.select(dn <= shares[3] * n, within, vec8(1.0))
            if total(far) > 0.0:
                _, _, _, ma = load_bodies(rows, r, motion.solved, floor)
                _, _, _, mb = load_bodies(rows, r + 1, motion.solved, floor)
                heavier = ti.min(ma, mb)
                unlike = ti.select(ti.max(ma, mb) > ALIKE * heavier, far, vec8(0.0))
                away = ti.max(away, ti.select(heavier > 0.0, unlike, vec8(0.0)))
            moves = ti.select(rows.column[k + EN] > 0.0, vec8(1.0), vec8(0.0))
            count += ti.cast(total(MOVING * moved + SCARCE * far - moves), ti.i32)
            b += 1
            if total(away) > 0.0 or count > all:
                count = ASTRAY
                b = b1
        return count

    @ti.func
    def lacking(rows: t.Rows, b0, b1, still, enough):
        """Rows without bounds, as joints are held by, that lacked more of their speed than ``still`` in the sweep.

        They are counted until there are ``enough``.
        """
        found = 0
        b = b0
        while b < b1 and found < enough:
            k = (b * width) & MASK
            # NaN is lacking
            lacks = ti.select(magnitude(rows.change[2 * b]) <= still * rows.column[k + EN], vec8(0.0), vec8(1.0))
            lacks = ti.select(rows.column[k + LO] < -UNBOUNDED, lacks, vec8(0.0))
            lacks = ti.select(rows.column[k + HI] > UNBOUNDED, lacks, vec8(0.0))
            found += ti.cast(total(lacks), ti.i32)
            b += 1
        return found

    @ti.func
    def natural_map(rows: t.Rows, bodies: ti.template(), b0, b1, before, floor):
        """Sum of the squared natural maps of rows [(N s)^2], row after row, added to what was ``before``.

        That of a contact is the distance of its impulse x from the nearest point, in Coulomb's cone, to a step from it,
        x - e (u_n + mu |u_t|, u_t) with De Saxce's augmented velocity, which the row's effective mass e makes an
        impulse; that of a joint what would stop it; of a row with bounds the distance to a step within them.
        """
        squares = before
        for b in range(b0, b1):
            k, r, of_a, of_b = load_block(rows, bodies, b, floor)
            mass = rows.column[k + EN]
            mu = rows.column[k + MU]
            xn = rows.impulse[r]
            xt = rows.impulse[r + 1]
            un = normal_speed(rows, k, of_a, of_b)
            if ti.static(own):
                un = un + (rows.column[k + BIAS] + rows.column[k + SOFT] * xn)
            else:
                un = un + rows.column[k + BIAS]
            ut = tangent_speed(rows, k, of_a, of_b)
            zn = xn - mass * (un + mu * magnitude(ut))
            zt = xt - mass * ut
            # the nearest point in Coulomb's cone: z itself inside, the apex behind it, else on the cone's edge
            size = magnitude(zt)
            edge = (zn + mu * size) / (1.0 + mu * mu)
            behind = mu * size <= zn * -1.0
            edge = ti.select(behind, vec8(0.0), edge)
            along = mu * edge
            along = ti.select(zt < 0.0, along * -1.0, along)
            pn = ti.select(zn < 0.0, edge, ti.select(size > mu * zn, edge, zn))
            pt = ti.select(zn < 0.0, along, ti.select(size > mu * zn, along, zt))
            square = (xn - pn) * (xn - pn) + (xt - pt) * (xt - pt)
            if ti.static(own):
                off = xn - ti.min(ti.max(xn - mass * un, rows.column[k + LO]), rows.column[k + HI])
                square = ti.select(rows.column[k + HI] < INFINITY, off * off, square)
                square = ti.select(rows.column[k + LO] != 0.0, off * off, square)
            elif ti.static(jointed):
                square = ti.select(rows.column[k + LO] < 0.0, (mass * un) * (mass * un), square)
            for lane in ti.static(range(LANES)):
                squares += square[lane]
        return squares

    return SimpleNamespace(
        sweep=sweep,
        apply=apply,
        push=push,
        extrapolate=extrapolate,
        moving=moving,
        lacking=lacking,
        natural_map=natural_map,
    )
