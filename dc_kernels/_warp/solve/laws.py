"""The laws of contact, each once: relative speed, Coulomb's cone, the natural map. Generic in the scalar type."""

from typing import Any

import warp as wp


@wp.func
def linear_speed(d: Any, va: Any, vb: Any):
    """Speed of B's centre of mass against A's along a direction [m/s]."""
    return d[0] * (vb[0] - va[0]) + d[1] * (vb[1] - va[1])


@wp.func
def relative_speed(d: Any, va: Any, vb: Any, ra: Any, rb: Any):
    """Speed of B against A at their contact along a direction, J V (Wu 2018, equations 2.21 and 2.22) [m/s].

    Args:
        d: unit direction; its first two components count.
        va: velocity of A and spin, (x, y, w, ...).
        vb: velocity of B and spin.
        ra: arm of the contact from A's centre of mass, crossed with d [m].
        rb: arm from B's centre of mass, crossed with d [m].
    """
    return linear_speed(d, va, vb) + (rb * vb[2] - ra * va[2])


@wp.func
def inverse_or_zero(x: Any):
    """1 / x, or 0 where x is not positive: what cannot move has no effective mass (Wu 2018, equation 2.25)."""
    if x > type(x)(0.0):
        return type(x)(1.0) / x
    return type(x)(0.0)


@wp.func
def clamped(v: Any, limit: Any):
    """V within limits, or the upper one where it is NaN; signs of zeros are those of ``clamp`` in native/prelude.h."""
    least = limit * type(limit)(-1.0)  # Warp's minus makes 0 of 0, not -0
    low = limit
    if v < limit:
        low = v
    if least > low:
        low = least
    return low


@wp.func
def stiffened(inverse: Any, added: Any):
    """The inverse of an inertia to which some is added [1/(kg m^2)]."""
    return inverse / (type(inverse)(1.0) + inverse * added)


@wp.func
def project_cone(z: Any, mu: Any):
    """The nearest point to z = (normal, tangential) in Coulomb's cone, |tangential| <= mu * normal."""
    zn = z[0]
    zt = z[1]
    size = wp.abs(zt)
    if zn < type(zn)(0.0) or size > mu * zn:
        if mu * size <= -zn:
            zn = type(zn)(0.0)
            zt = type(zn)(0.0)
        else:
            zn = (zn + mu * size) / (type(zn)(1.0) + mu * mu)
            zt = wp.sign(zt) * (mu * zn)
    return type(z)(zn, zt)


@wp.func
def natural_map_squared(x: Any, z: Any, mu: Any):
    """Squared distance of a contact's impulse x from the projection of z, a step from it, on Coulomb's cone.

    z is x minus an effective mass times (u_n + mu |u_t|, u_t), De Saxce's augmented velocity; all in N s.
    """
    p = project_cone(z, mu)
    return (x[0] - p[0]) * (x[0] - p[0]) + (x[1] - p[1]) * (x[1] - p[1])
