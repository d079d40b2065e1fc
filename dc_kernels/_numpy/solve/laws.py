"""The laws of contact, each once: relative speed, Coulomb's cone, the natural map."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, cross


def direction(d: Array, ra: Array, rb: Array) -> Array:
    """J of a direction at two arms, (6,): J V is B's speed against A along it (Wu 2018, equations 2.21 and 2.22)."""
    return np.array([*-d, -cross(ra, d), *d, cross(rb, d)])


def project_cone(normal: Any, along: Any, friction: Any) -> tuple[Any, Any]:
    """The nearest point with |along| <= friction * normal."""
    if normal >= 0 and abs(along) <= friction * normal:
        return normal, along
    if friction * abs(along) <= -normal:
        return 0.0, 0.0
    nearest = (normal + friction * abs(along)) / (1.0 + friction * friction)
    return nearest, np.sign(along) * friction * nearest


def natural_map_squared(x: Array, z: Array, friction: Any) -> Any:
    """Squared distance of an impulse x from the projection of z, a step from it, on Coulomb's cone [(N s)^2]."""
    zn, zt = project_cone(z[0], z[1], friction)
    return (x[0] - zn) ** 2 + (x[1] - zt) ** 2
