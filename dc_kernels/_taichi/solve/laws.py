"""The laws of contact of single rows: relative speed, effective mass; ``lanes`` has the natural map."""

from dc_kernels._taichi.runtime.compiler import ti


@ti.func
def linear_speed(d, va, vb):
    """Speed of B's centre of mass against A's along a direction [m/s]."""
    return d[0] * (vb[0] - va[0]) + d[1] * (vb[1] - va[1])


@ti.func
def clamped(v, limit):
    """V within limits, or the upper one where it is NaN: to ignore NaN takes three times as many instructions."""
    low = ti.select(v < limit, v, limit)
    return ti.select(limit * -1.0 > low, limit * -1.0, low)


@ti.func
def relative_speed(d, va, vb, ra, rb):
    """Speed of B against A at their contact along a direction, J V (Wu 2018, equations 2.21 and 2.22) [m/s].

    Args:
        d: unit direction; its first two components count.
        va: velocity of A and spin, (x, y, w, ...).
        vb: velocity of B and spin.
        ra: arm of the contact from A's centre of mass, crossed with d [m].
        rb: arm from B's centre of mass, crossed with d [m].
    """
    return linear_speed(d, va, vb) + (rb * vb[2] - ra * va[2])


@ti.func
def inverse_or_zero(x):
    """1 / x, or 0 where x is not positive: what cannot move has no effective mass (Wu 2018, equation 2.25)."""
    inverse = 0.0
    if x > 0.0:
        inverse = 1.0 / x
    return inverse
