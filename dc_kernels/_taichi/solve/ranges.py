"""Sums and combinations over the impulses i0 .. i1 of a world, whole vectors of LANES.

Sums are taken in LANES parts and in pieces whose order is fixed: that of Warp's native code.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.bodies import total
from dc_kernels.solve.iteration import MOST_SUMS, SUMMED
from dc_kernels.solve.rows import LANES


@ti.func
def piece(count, numbers: ti.template()):
    """Items of so many numbers each that are summed up in one go, of ``count`` in all."""
    least = SUMMED // numbers
    even = (count + MOST_SUMS - 1) // MOST_SUMS
    length = least
    if even > least:
        length = (even + LANES - 1) // LANES * LANES
    return length


@cache
def range_functions(dtype: str) -> SimpleNamespace:
    """What accelerations do to impulses ``rows.impulse`` and their ``rows.change``; ``at``: a world's part of the past.

    ``squares`` is the sum of squares of the change, ``along`` its product with the move before; ``conjugate`` makes a
    step of nonlinear CG, ``onward`` and ``onward_bodies`` one of momentum; ``products``, ``remember`` and ``combine``
    are the parts of Anderson's update. ``beyond`` is what bodies were given, ``fastest`` their largest speed before.
    ``copy`` keeps a world's impulses, or its changes.
    """
    t = group_types(dtype)
    vec8 = t.vec8

    @ti.func
    def squares(rows: t.Rows, i0, i1):
        """Sum of squares of the change."""
        sums = vec8(0.0)
        length = piece(i1 - i0, 1) // LANES
        end = i1 // LANES
        begin = i0 // LANES
        while begin < end:
            part = vec8(0.0)
            for i in range(begin, ti.min(begin + length, end)):
                d = rows.change[i]
                part = part + d * d
            sums = sums + part
            begin += length
        return total(sums)

    @ti.func
    def fastest(motion: t.Motion, b0, b1):
        """The largest speed along x or y before the impulses."""
        most = 0.0
        for b in range(b0, b1):
            v = motion.predicted[b]
            most = ti.max(most, ti.max(ti.abs(v[0]), ti.abs(v[1])))
        return most

    @ti.func
    def beyond(motion: t.Motion, b0, b1, fall):
        """By how much impulses have changed velocities beyond ``fall``, the mean over the mass of what they moved."""
        pushes = vec8(0.0)
        masses = vec8(0.0)
        length = piece(b1 - b0, 4)
        begin = b0
        while begin < b1:
            end = ti.min(begin + length, b1)
            push = vec8(0.0)
            mass = vec8(0.0)
            for n in range((end - begin + LANES - 1) // LANES):
                given = vec8(0.0)
                weight = vec8(0.0)
                for k in ti.static(range(LANES)):
                    b = begin + LANES * n + k
                    if b < end:
                        v = motion.solved[b]
                        u = motion.predicted[b]
                        given[k] = ti.max(ti.abs(v[0] - u[0]), ti.abs(v[1] - u[1]))
                        if given[k] > 0.0:
                            weight[k] = 1.0 / v[3]
                push = push + weight * ti.max(given - fall, vec8(0.0))
                mass = mass + weight
            pushes = pushes + push
            masses = masses + mass
            begin = end
        mean = total(pushes) / total(masses)
        if not mean < 1e30:  # NaN where there is no mass
            mean = 0.0
        return mean

    @ti.func
    def copy(source: ti.template(), target: ti.template(), at, i0, i1):
        """Elements i0 .. i1 of an array to another, from ``at`` on."""
        for i in range((i1 - i0) // LANES):
            target[at // LANES + i] = source[i0 // LANES + i]

    @ti.func
    def conjugate(rows: t.Rows, i0, i1, beta):
        """A step along the conjugate direction, which is then beta direction + change."""
        for i in range(i0 // LANES, i1 // LANES):
            step = vec8(0.0)
            if beta > 0.0:
                step = beta * rows.direction[i]  # else it may hold NaN of the solve before
            rows.direction[i] = step + rows.change[i]
            rows.impulse[i] = rows.impulse[i] + step
            rows.change[i] = step

    @ti.func
    def along(rows: t.Rows, at, i0, i1):
        """Scalar product of the change with the move before it, change . (x - before)."""
        sums = vec8(0.0)
        past = (at - i0) // LANES
        length = piece(i1 - i0, 1) // LANES
        end = i1 // LANES
        begin = i0 // LANES
        while begin < end:
            part = vec8(0.0)
            for i in range(begin, ti.min(begin + length, end)):
                part = part + rows.change[i] * (rows.impulse[i] - rows.past[past + i])
            sums = sums + part
            begin += length
        return total(sums)

    @ti.func
    def onward(rows: t.Rows, at, i0, i1, beta):
        """Momentum: x <- x + beta (x - before), before <- x."""
        past = (at - i0) // LANES
        for i in range(i0 // LANES, i1 // LANES):
            v = rows.impulse[i]
            rows.impulse[i] = v + beta * (v - rows.past[past + i])
            rows.past[past + i] = v

    @ti.func
    def keep_bodies(rows: t.Rows, bodies: ti.template(), at, b0, b1):
        """Velocities of the bodies b0 .. b1 to the past."""
        for b in range(b0, b1):
            i = at + 4 * (b - b0)
            v = bodies[b]
            for k in ti.static(range(4)):
                rows.past[i // LANES][i % LANES + k] = v[k]

    @ti.func
    def onward_bodies(rows: t.Rows, bodies: ti.template(), at, b0, b1, beta):
        """Momentum of the velocities of the bodies b0 .. b1, which follow the impulses by linearity."""
        for b in range(b0, b1):
            i = at + 4 * (b - b0)
            v = bodies[b]
            last = t.vec4(0.0)
            for k in ti.static(range(4)):
                last[k] = rows.past[i // LANES][i % LANES + k]
                rows.past[i // LANES][i % LANES + k] = v[k]
            bodies[b] = v + beta * (v - last)

    @ti.func
    def products(rows: t.Rows, at, i0, i1, kept):
        """The scalar products that Anderson's least squares needs.

        They are those of differences to the remembered iterates and steps: f1 f1, f1 f2, f2 f2, f1 d, f2 d, e1 e1,
        e1 e2, e2 e2, with d the step, f of steps, e of iterates.
        """
        s0 = vec8(0.0)
        s1 = vec8(0.0)
        s2 = vec8(0.0)
        s3 = vec8(0.0)
        s4 = vec8(0.0)
        s5 = vec8(0.0)
        s6 = vec8(0.0)
        s7 = vec8(0.0)
        past = (at - i0) // LANES
        stride = (i1 - i0) // LANES
        length = piece(i1 - i0, 1) // LANES
        end = i1 // LANES
        begin = i0 // LANES
        while begin < end:
            p0 = vec8(0.0)
            p1 = vec8(0.0)
            p2 = vec8(0.0)
            p3 = vec8(0.0)
            p4 = vec8(0.0)
            p5 = vec8(0.0)
            p6 = vec8(0.0)
            p7 = vec8(0.0)
            for i in range(begin, ti.min(begin + length, end)):
                d = rows.change[i]
                v = rows.impulse[i]
                e1 = v - rows.past[past + i]
                f1 = d - rows.past[past + i + stride]
                e2 = vec8(0.0)
                f2 = vec8(0.0)
                if kept > 1:
                    e2 = v - rows.past[past + i + 2 * stride]
                    f2 = d - rows.past[past + i + 3 * stride]
                p0 = p0 + f1 * f1
                p1 = p1 + f1 * f2
                p2 = p2 + f2 * f2
                p3 = p3 + f1 * d
                p4 = p4 + f2 * d
                p5 = p5 + e1 * e1
                p6 = p6 + e1 * e2
                p7 = p7 + e2 * e2
            s0 = s0 + p0
            s1 = s1 + p1
            s2 = s2 + p2
            s3 = s3 + p3
            s4 = s4 + p4
            s5 = s5 + p5
            s6 = s6 + p6
            s7 = s7 + p7
            begin += length
        return vec8(total(s0), total(s1), total(s2), total(s3), total(s4), total(s5), total(s6), total(s7))

    @ti.func
    def remember(rows: t.Rows, at, i0, i1):
        """The latest iterate and its step go in front of the remembered ones."""
        past = (at - i0) // LANES
        stride = (i1 - i0) // LANES
        for i in range(i0 // LANES, i1 // LANES):
            p = past + i
            rows.past[p + 2 * stride] = rows.past[p]
            rows.past[p + 3 * stride] = rows.past[p + stride]
            rows.past[p] = rows.impulse[i]
            rows.past[p + stride] = rows.change[i]

    @ti.func
    def combine(rows: t.Rows, at, i0, i1, kept, a, b):
        """Anderson's update into the change, -(a e1 + b e2), and the latest iterate remembered."""
        past = (at - i0) // LANES
        stride = (i1 - i0) // LANES
        for i in range(i0 // LANES, i1 // LANES):
            p = past + i
            v = rows.impulse[i]
            d = rows.change[i]
            move = a * (v - rows.past[p])
            if kept > 1:
                move = move + b * (v - rows.past[p + 2 * stride])
            rows.past[p + 2 * stride] = rows.past[p]
            rows.past[p + 3 * stride] = rows.past[p + stride]
            rows.past[p] = v
            rows.past[p + stride] = d
            rows.change[i] = move * -1.0

    return SimpleNamespace(
        squares=squares,
        beyond=beyond,
        fastest=fastest,
        copy=copy,
        conjugate=conjugate,
        along=along,
        onward=onward,
        keep_bodies=keep_bodies,
        onward_bodies=onward_bodies,
        products=products,
        remember=remember,
        combine=combine,
    )
