"""When two shapes meet that turn against each other, and how: their manifold at the time of impact.

Their motion is followed by conservative advancement (Mirtich 1996; Coumans, Continuous collision detection, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dc_kernels._numpy.collide.manifold import Hull, Manifold, hull_disc, hull_hull
from dc_kernels._numpy.common import Array, cross, dot, rotate, rotation

ADVANCES = 128  # of the time in a step; what has not met by then is left to the next step
NEAR = 0.5  # of the overlap that is open: distance that counts as none


@dataclass
class Path:
    """How a hull A and a shape B move: place and angle of their bodies, velocity and spin.

    ``hull_b`` is None where B is a disc about ``center`` of its body; ``size``: the farthest point of either from the
    centre of its body [m]; ``slack`` and ``overlap`` [m]: see ``hull_hull``.
    """

    hull_a: Hull
    hull_b: Hull | None
    radius: Any
    center: Array
    xa: Array
    xb: Array
    angle_a: Any
    angle_b: Any
    va: Array
    vb: Array
    size_a: Any
    size_b: Any
    dt: Any
    slack: Any
    overlap: Any
    epsilon: float

    def manifold_at(self, time: Any) -> Manifold:
        """The manifold at a time, in world axes; its points are measured from the centre of A's body then."""
        turn_a, turn_b = rotation(self.angle_a + self.va[2] * time), rotation(self.angle_b + self.vb[2] * time)
        offset = self.xb - self.xa + (self.vb - self.va)[:2] * time
        if self.hull_b is None:
            m = hull_disc(
                self.hull_a, rotate(turn_a.T, offset + rotate(turn_b, self.center)), self.radius, self.epsilon
            )
        else:
            b = self.hull_b.placed(turn_a.T @ turn_b, rotate(turn_a.T, offset))
            m = hull_hull(self.hull_a, b, float("inf"), self.slack, self.overlap, self.epsilon)
        m = m.placed(turn_a, offset * 0)
        m.moved = offset - (self.xb - self.xa)
        return m

    def speed_at(self, m: Manifold, point: Array) -> Any:
        """Relative speed along the normal where the shapes meet; negative where they close."""
        to_b = point - (self.xb - self.xa) - m.moved
        spins = cross(to_b, m.normal) * self.vb[2] - cross(point, m.normal) * self.va[2]
        return dot(m.normal, (self.vb - self.va)[:2]) + spins


def hulls_turning(path: Path, now: Manifold) -> Manifold:
    """A hull and another shape that are apart, at the time at which they meet; ``now`` is their manifold, as is."""
    near, time, m = NEAR * path.overlap, path.dt * 0, now
    for _ in range(ADVANCES):
        if time >= path.dt:
            break
        m = path.manifold_at(time)
        if not m.points:
            break
        if any(gap <= near and path.speed_at(m, point) < 0 for point, gap, _ in m.points):
            points = [(p, gap + max(-path.speed_at(m, p), 0) * time, feature) for p, gap, feature in m.points]
            m.points = [(p + path.xa, gap, feature) for p, gap, feature in points]
            return m
        speed = abs(path.va[2]) * path.size_a + abs(path.vb[2]) * path.size_b - dot(m.normal, (path.vb - path.va)[:2])
        if speed <= 0:
            break
        time += max(m.least_gap - 0.5 * near, 0.5 * near) / speed
    now.points = [(p, max(g, path.slack - path.speed_at(now, p - path.xa) * path.dt), f) for p, g, f in now.points]
    return now
