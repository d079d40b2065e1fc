"""SIMD lanes: LANES rows of one colour solved side by side, as vectors of Taichi.

The arithmetic is that of ``row``, operation by operation, and that of Warp's lanes. Velocities are loaded as vec4 and
transposed in registers, as in ``_warp/native/solve/bodies.h``. What makes that as fast as there:

- A vector whose elements come from two others becomes one shuffle; but LLVM looks through several, and puts together a
  vector of eight others by chains of insertions. A product with ``one``, which is 1 without the compiler's knowledge,
  is what it does not look through: in float32 a sweep of discs then takes 1.2 times Warp's time, else 1.4 times. In
  float64, whose vectors fill two registers, it takes 1.1 and 0.95 times: there are no products then.
- Indices of bodies are loaded one by one: of a vector loaded whole they would be extracted, at 0.3 of the time.
- All that a block needs is loaded before anything is stored: where an array lies is looked up anew after each store.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.solve.rows import COLUMNS, JOINTED


@ti.func
def magnitude(v):
    """Absolute values of a vector, element by element."""
    return ti.max(v, v * -1.0)


@ti.func
def total(v):
    """Sum of the lanes, in a fixed order."""
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]))


@ti.func
def largest(v):
    """The largest lane that is above 0, else 0."""
    low = ti.max(ti.max(v[0], v[1]), ti.max(v[2], v[3]))
    return ti.max(ti.max(low, ti.max(ti.max(v[4], v[5]), ti.max(v[6], v[7]))), 0.0)


@cache
def body_functions(dtype: str) -> SimpleNamespace:
    """``load_bodies`` and ``store_bodies``: of the eight bodies of a block, a vector for each component."""
    t = group_types(dtype)
    vec4, vec8 = t.vec4, t.vec8
    opaque = dtype == "float32"

    @ti.func
    def kept(v, one):
        """A vector that the compiler does not take apart."""
        if ti.static(opaque):
            v = v * one
        return v

    @ti.func
    def low_halves(a, b, one):
        return kept(vec8(a[0], b[0], a[1], b[1], a[4], b[4], a[5], b[5]), one)

    @ti.func
    def high_halves(a, b, one):
        return kept(vec8(a[2], b[2], a[3], b[3], a[6], b[6], a[7], b[7]), one)

    @ti.func
    def low_pairs(a, b):
        return vec8(a[0], a[1], b[0], b[1], a[4], a[5], b[4], b[5])

    @ti.func
    def high_pairs(a, b):
        return vec8(a[2], a[3], b[2], b[3], a[6], a[7], b[6], b[7])

    @ti.func
    def transpose(a, b, c, d, one):
        """Its own inverse."""
        t0 = low_halves(a, b, one)
        t1 = low_halves(c, d, one)
        t2 = high_halves(a, b, one)
        t3 = high_halves(c, d, one)
        return low_pairs(t0, t1), high_pairs(t0, t1), low_pairs(t2, t3), high_pairs(t2, t3)

    @ti.func
    def load_pair(bodies: ti.template(), i, j, one):
        q = bodies[i]
        r = bodies[j]
        return kept(vec8(q[0], q[1], q[2], q[3], r[0], r[1], r[2], r[3]), one)

    @ti.func
    def store_pair(bodies: ti.template(), i, j, both):
        bodies[i] = vec4(both[0], both[1], both[2], both[3])
        bodies[j] = vec4(both[4], both[5], both[6], both[7])

    @ti.func
    def load_bodies(rows: t.Rows, k, bodies: ti.template(), one):
        """Velocity (x, y), spin and inverse mass of the bodies that ``rows.body[k]`` names."""
        return transpose(
            load_pair(bodies, rows.body[k][0], rows.body[k][4], one),
            load_pair(bodies, rows.body[k][1], rows.body[k][5], one),
            load_pair(bodies, rows.body[k][2], rows.body[k][6], one),
            load_pair(bodies, rows.body[k][3], rows.body[k][7], one),
            one,
        )

    @ti.func
    def store_bodies(rows: t.Rows, k, bodies: ti.template(), x, y, w, m, one):
        p0, p1, p2, p3 = transpose(x, y, w, m, one)
        store_pair(bodies, rows.body[k][0], rows.body[k][4], p0)
        store_pair(bodies, rows.body[k][1], rows.body[k][5], p1)
        store_pair(bodies, rows.body[k][2], rows.body[k][6], p2)
        store_pair(bodies, rows.body[k][3], rows.body[k][7], p3)

    return SimpleNamespace(load_bodies=load_bodies, store_bodies=store_bodies)


@cache
def lane_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``sweep``, ``apply``, ``push`` and ``extrapolate`` over the blocks b0 .. b1 of rows of a variant."""
    t = group_types(dtype)
    vec8 = t.vec8
    of_bodies = body_functions(dtype)
    load_bodies, store_bodies = of_bodies.load_bodies, of_bodies.store_bodies
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
    def sweep(rows: t.Rows, bodies: ti.template(), b0, b1, omega, one):
        """Projected Gauss-Seidel; the largest impulse change [N s].

        vn, vt: speeds of B against A along the normal and the tangent [m/s]; ln0, lt0: impulses along them before the
        sweep, ln, lt: after it, dn, dt: their changes [N s].
        """
        most = vec8(0.0)
        for b in range(b0, b1):
            k = b * width
            ax, ay, aw, am = load_bodies(rows, 2 * b, bodies, one)
            bx, by, bw, bm = load_bodies(rows, 2 * b + 1, bodies, one)
            nx = rows.column[k + NX]
            ny = rows.column[k + NY]
            rat = rows.column[k + RAT]
            rbt = rows.column[k + RBT]
            wa = rows.column[k + WA]
            wb = rows.column[k + WB]
            ran = vec8(0.0)
            rbn = vec8(0.0)
            if ti.static(not discs):
                ran = rows.column[k + RAN]
                rbn = rows.column[k + RBN]
            en = rows.column[k + EN]
            et = rows.column[k + ET]
            bias = rows.column[k + BIAS]
            mu = rows.column[k + MU]
            low = least(rows, k)
            ln0 = rows.impulse[2 * b]
            lt0 = rows.impulse[2 * b + 1]
            vn = nx * (bx - ax) + ny * (by - ay)
            if ti.static(own):
                vn = (nx * bx - rows.column[k + AX] * ax) + (ny * by - rows.column[k + AY] * ay)
                bias = bias + rows.column[k + SOFT] * ln0
            if ti.static(not discs):
                vn = vn + (rbn * bw - ran * aw)
            ln = ti.max(ln0 - (omega * en) * (vn + bias), low)
            if ti.static(own):
                ln = ti.min(ln, rows.column[k + HI])
            dn = ln - ln0
            vt = vec8(0.0)
            if ti.static(discs):  # a disc's normal impulse has no tangential effect: its tangent need not wait for it
                vt = (ny * (bx - ax) - nx * (by - ay)) + (rbt * bw + rat * aw)
            px = nx * dn
            py = ny * dn
            if ti.static(own):
                ax = ax - am * (rows.column[k + AX] * dn)
                ay = ay - am * (rows.column[k + AY] * dn)
            else:
                ax = ax - am * px
                ay = ay - am * py
            bx = bx + bm * px
            by = by + bm * py
            if ti.static(not discs):
                aw = aw - wa * (ran * dn)
                bw = bw + wb * (rbn * dn)
                vt = (ny * (bx - ax) - nx * (by - ay)) + (rbt * bw - rat * aw)
            limit = mu * ln
            lt = ti.min(ti.max(lt0 - (omega * et) * vt, limit * -1.0), limit)
            dt = lt - lt0
            qx = ny * dt
            qy = nx * dt
            ax = ax - am * qx
            ay = ay + am * qy
            bx = bx + bm * qx
            by = by - bm * qy
            if ti.static(discs):
                aw = aw + wa * dt
                bw = bw + wb * dt
            else:
                aw = aw - wa * (rat * dt)
                bw = bw + wb * (rbt * dt)
            rows.impulse[2 * b] = ln
            rows.impulse[2 * b + 1] = lt
            rows.change[2 * b] = dn
            rows.change[2 * b + 1] = dt
            most = ti.max(most, ti.max(magnitude(dn), magnitude(dt)))
            store_bodies(rows, 2 * b, bodies, ax, ay, aw, am, one)
            store_bodies(rows, 2 * b + 1, bodies, bx, by, bw, bm, one)
        return largest(most)

    @ti.func
    def apply(rows: t.Rows, bodies: ti.template(), anew, b0, b1, one):
        """Velocities after impulses, V += M^-1 J^T delta: after all of them where ``anew`` is 1, else their change."""
        for b in range(b0, b1):
            k = b * width
            ax, ay, aw, am = load_bodies(rows, 2 * b, bodies, one)
            bx, by, bw, bm = load_bodies(rows, 2 * b + 1, bodies, one)
            nx = rows.column[k + NX]
            ny = rows.column[k + NY]
            rat = rows.column[k + RAT]
            rbt = rows.column[k + RBT]
            wa = rows.column[k + WA]
            wb = rows.column[k + WB]
            ran = vec8(0.0)
            rbn = vec8(0.0)
            if ti.static(not discs):
                ran = rows.column[k + RAN]
                rbn = rows.column[k + RBN]
            dn = rows.change[2 * b]
            dt = rows.change[2 * b + 1]
            if anew == 1:
                dn = rows.impulse[2 * b]
                dt = rows.impulse[2 * b + 1]
            px = nx * dn
            py = ny * dn
            qx = ny * dt
            qy = nx * dt
            if ti.static(own):
                ax = (ax - am * (rows.column[k + AX] * dn)) - am * qx
                ay = (ay - am * (rows.column[k + AY] * dn)) + am * qy
            else:
                ax = (ax - am * px) - am * qx
                ay = (ay - am * py) + am * qy
            bx = (bx + bm * px) + bm * qx
            by = (by + bm * py) - bm * qy
            if ti.static(discs):
                aw = aw + wa * dt
                bw = bw + wb * dt
            else:
                aw = (aw - wa * (ran * dn)) - wa * (rat * dt)
                bw = (bw + wb * (rbn * dn)) + wb * (rbt * dt)
            store_bodies(rows, 2 * b, bodies, ax, ay, aw, am, one)
            store_bodies(rows, 2 * b + 1, bodies, bx, by, bw, bm, one)

    @ti.func
    def push(rows: t.Rows, bodies: ti.template(), b0, b1, factor, limit, one):
        """Position correction: displacements that remove a share of what overlaps; the largest push."""
        most = vec8(0.0)
        for b in range(b0, b1):
            k = b * width
            ax, ay, aw, am = load_bodies(rows, 2 * b, bodies, one)
            bx, by, bw, bm = load_bodies(rows, 2 * b + 1, bodies, one)
            nx = rows.column[k + NX]
            ny = rows.column[k + NY]
            vn = nx * (bx - ax) + ny * (by - ay)
            if ti.static(own):
                vn = (nx * bx - rows.column[k + AX] * ax) + (ny * by - rows.column[k + AY] * ay)
            if ti.static(not discs):
                vn = vn + (rows.column[k + RBN] * bw - rows.column[k + RAN] * aw)
            step = ti.max(factor * (vn + rows.column[k + GAP]), vec8(limit * -1.0))
            if ti.static(jointed):
                step = ti.min(step, vec8(limit))
            dn = ti.max((rows.column[k + EN] * step) * -1.0, least(rows, k))
            if ti.static(own):
                dn = rows.column[k + HELD] * ti.min(dn, rows.column[k + HI])
            px = nx * dn
            py = ny * dn
            if ti.static(own):
                ax = ax - am * (rows.column[k + AX] * dn)
                ay = ay - am * (rows.column[k + AY] * dn)
            else:
                ax = ax - am * px
                ay = ay - am * py
            bx = bx + bm * px
            by = by + bm * py
            if ti.static(not discs):
                aw = aw - rows.column[k + WA] * (rows.column[k + RAN] * dn)
                bw = bw + rows.column[k + WB] * (rows.column[k + RBN] * dn)
            most = ti.max(most, magnitude(dn))
            store_bodies(rows, 2 * b, bodies, ax, ay, aw, am, one)
            store_bodies(rows, 2 * b + 1, bodies, bx, by, bw, bm, one)
        return largest(most)

    @ti.func
    def extrapolate(rows: t.Rows, b0, b1, alpha):
        """Impulses moved on along their change, x <- clamp(x + alpha change); change is then what they moved by."""
        for b in range(b0, b1):
            k = b * width
            mu = rows.column[k + MU]
            low = least(rows, k)
            xn = rows.impulse[2 * b]
            xt = rows.impulse[2 * b + 1]
            dn = rows.change[2 * b]
            dt = rows.change[2 * b + 1]
            yn = ti.max(xn + alpha * dn, low)
            if ti.static(own):
                yn = ti.min(yn, rows.column[k + HI])
            limit = mu * yn
            yt = ti.min(ti.max(xt + alpha * dt, limit * -1.0), limit)
            rows.impulse[2 * b] = yn
            rows.impulse[2 * b + 1] = yt
            rows.change[2 * b] = yn - xn
            rows.change[2 * b + 1] = yt - xt

    return SimpleNamespace(sweep=sweep, apply=apply, push=push, extrapolate=extrapolate)
