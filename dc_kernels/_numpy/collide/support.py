"""What the static shapes that a shape comes to first leave of its motion, before it is asked where it meets others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from dc_kernels._numpy.collide.manifold import Manifold, length
from dc_kernels._numpy.common import Array, dot


def closes(m: Manifold, velocity: Array, dt: Any, slack: Any) -> bool:
    """Whether a manifold that another axis could replace is in the way of the motion, and within its reach."""
    if not m.points or not m.beside:
        return False
    return bool(-dot(m.normal, velocity) * dt > slack and length(velocity) * dt > m.least_gap)


def supported(velocity: Array, manifolds: Iterable[Manifold], dt: Any, slack: Any) -> Array:
    """What is left of the velocity of a shape where static ones stop it that one axis alone parts from it.

    Args:
        velocity: of the shape, in world axes.
        manifolds: of its pairs with static hulls, in the order opposite to that of the pairs.
        dt: time step.
        slack: a motion in the step that is none.
    """
    for m in manifolds:
        if m.points and not m.beside:
            gap, closing = max(m.least_gap, 0), -dot(m.normal, velocity) * dt
            if closing > gap + slack:
                velocity = velocity + m.normal * ((closing - gap) / dt)
    return velocity
