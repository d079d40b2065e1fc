"""Contact manifolds of two shapes, each the hull of its vertices plus a radius.

Discs meet discs and hulls in closed form; hulls meet hulls by separating axes and clipping of the incident edge
(as in Box2D v3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, cross, dot, rotate

PARALLEL = -0.999  # cosine of two outward normals below which they are of one axis


@dataclass
class Hull:
    """A shape's core in some frame: vertices, counter-clockwise, and the normals of the edges that start there."""

    vertices: Array  # (n, 2)
    normals: Array  # (n, 2)
    radius: Any
    before: Array | None = None  # of a chain's segment: the neighbouring vertices, where there are any
    beyond: Array | None = None
    segment: bool = False  # of a chain

    def placed(self, r: Array, x: Array) -> Hull:
        """The hull in another frame: turned by r, then moved by x."""
        before, beyond = (None if v is None else rotate(r, v) + x for v in (self.before, self.beyond))
        vertices, normals = rotate(r, self.vertices) + x, rotate(r, self.normals)
        return Hull(vertices, normals, self.radius, before, beyond, self.segment)

    def moved(self, x: Array) -> Hull:
        """The hull moved by x."""
        before, beyond = (None if v is None else v + x for v in (self.before, self.beyond))
        return Hull(self.vertices + x, self.normals, self.radius, before, beyond, self.segment)


@dataclass
class Manifold:
    """Contact points of a pair: (midpoint between the surfaces, gap, feature) each; normal from the first shape.

    ``corner``: the normal joins two corners. ``beside``: another axis than the normal's parts the shapes too, or they
    touch along it.
    """

    normal: Array
    points: list[tuple[Array, Any, int]]
    corner: bool = False
    beside: bool = False

    @property
    def distance(self) -> Any:
        """Gap of the first point."""
        return self.points[0][1]

    @property
    def least_gap(self) -> Any:
        """Of its points."""
        return min(gap for _, gap, _ in self.points)

    def placed(self, r: Array, x: Array, flip: bool = False) -> Manifold:
        """The manifold in another frame: turned by r, then moved by x; ``flip`` turns its normal around."""
        normal = rotate(r, self.normal)
        points = [(rotate(r, p) + x, gap, f) for p, gap, f in self.points]
        return Manifold(-normal if flip else normal, points, self.corner, self.beside)


def length(v: Array) -> Any:
    """2-norm."""
    return np.sqrt(dot(v, v))


def disc_disc(pa: Array, ra: Any, pb: Array, rb: Any, epsilon: float) -> Manifold:
    """Two discs; coincident centres have no direction and take the x axis."""
    distance = length(pb - pa)
    n = (pb - pa) / distance if distance > epsilon * (ra + rb) else np.array([1.0, 0.0], pa.dtype)
    gap = distance - ra - rb
    return Manifold(n, [(pa + n * (ra + 0.5 * gap), gap, 0)])


def hull_disc(hull: Hull, p: Array, r: Any, epsilon: float) -> Manifold:
    """Hull against a disc at p in the hull's frame; normal from the hull to the disc."""
    n = len(hull.vertices)
    heights = dot(hull.normals, p - hull.vertices)
    edge = int(np.argmax(heights))
    after = (edge + 1) % n
    along = hull.vertices[after] - hull.vertices[edge]
    u = dot(p - hull.vertices[edge], along)
    normal, distance = hull.normals[edge], heights[edge]
    corner = None
    if distance > 0:  # the nearest point is on the edge or one of its ends
        corner = edge if u <= 0 else after if u >= dot(along, along) else None
    elif n == 2:  # on the line of two vertices: beyond an end it sees the corner
        corner = edge if u < 0 else after if u > dot(along, along) else None
    if corner is not None:
        d = p - hull.vertices[corner]
        distance = length(d)
        if distance > epsilon * (hull.radius + r):
            normal = d / distance
        # a chain's corner is the later segment's, unless the earlier one's edge faces the disc
        if corner == 0 and hull.before is not None:
            before = hull.vertices[0] - hull.before
            if dot(d, before) < -1e-4 * distance * length(before):
                return Manifold(normal, [])
        if corner == 1 and hull.beyond is not None:
            return Manifold(normal, [])
    gap = distance - hull.radius - r
    return Manifold(normal, [(p - normal * (r + 0.5 * gap), gap, 0)], corner=corner is not None)


def max_separation(hull: Hull, other: Hull) -> tuple[Any, int, Any]:
    """Largest over the edges of ``hull`` of the smallest distance of the other's vertices, the edge, second largest."""
    distance = dot(hull.normals[:, None], other.vertices[None] - hull.vertices[:, None]).min(axis=1)
    edge = int(np.argmax(distance))
    return distance[edge], edge, np.delete(distance, edge).max()


def closest_corners(one: Hull, two: Hull, feature: Callable[[int, int], int]) -> Manifold:
    """One point between the nearest vertices of two hulls that are apart, along the line that joins them."""
    between = two.vertices[:, None] - one.vertices
    of_two, of_one = np.unravel_index(np.argmin(dot(between, between)), between.shape[:2])
    d = between[of_two, of_one]
    gap = length(d) - one.radius - two.radius
    n = d / length(d)
    at = one.vertices[of_one] + n * (one.radius + 0.5 * gap)
    return Manifold(n, [(at, gap, feature(int(of_one), int(of_two)))], corner=True)


def clip(
    edge: int, flip: bool, forced: bool, separation: Any, slack: Any, one: Hull, two: Hull, epsilon: float
) -> Manifold:
    """Manifold on an edge of hull one: the incident edge of hull two clipped to it, or the closest corners.

    Both hulls are in the same frame; ``flip``: hull one is the pair's second shape, which orders the feature;
    ``forced``: the normal has to be the edge's, and what lies past its ends is not its own.
    """

    def feature(of_one: int, of_two: int) -> int:
        return (of_two << 8) | of_one if flip else (of_one << 8) | of_two

    r1, r2 = edge, (edge + 1) % len(one.vertices)
    p1, p2 = one.vertices[r1], one.vertices[r2]
    normal = one.normals[edge]
    i1 = int(np.argmin(dot(normal, two.normals)))  # the edge that looks most against the normal
    i2 = (i1 + 1) % len(two.vertices)
    q1, q2 = two.vertices[i1], two.vertices[i2]
    size = length(p2 - p1)
    along = (p2 - p1) / size
    u1, u2 = dot(q1 - p1, along), dot(q2 - p1, along)
    radii = one.radius + two.radius
    outside = max(u1, u2) < 0 or min(u1, u2) > size
    if forced and outside:
        return Manifold(normal, [])
    w1, w2 = np.clip([u1, u2], 0.0, size)
    span = u2 - u1
    upright = abs(span) <= epsilon * size
    k1, k2 = (q1, q2) if upright else (q1 + (q2 - q1) * ((w1 - u1) / span), q1 + (q2 - q1) * ((w2 - u1) / span))
    # how far the edge is from what it faces: farther than the separation if the nearest point lies beside it
    faced = min(dot(normal, k1 - p1), dot(normal, k2 - p1))
    segments = len(one.vertices) == len(two.vertices) == 2  # past the end of one another they cannot overlap
    if (separation > slack and (outside or faced > separation + slack)) or (outside and segments):
        return closest_corners(one, two, feature)
    if outside:  # deep overlap: the incident edge's own ends, not points of its extension
        k1, k2 = q1, q2
    points = []
    # the incident edge runs against the reference edge: its first end meets the reference's second
    for k, f in ((k1, feature(r2, i1)), (k2, feature(r1, i2))):
        g = dot(normal, k - p1)
        points.append((k + normal * (0.5 * (one.radius - two.radius) - 0.5 * g), g - radii, f))
    if w1 == w2 or upright:  # one point only: the deeper end
        points = [min(points, key=lambda point: point[1])]
    return Manifold(normal, points)


def hull_hull(a: Hull, b: Hull, reach: Any, slack: Any, overlap: Any, epsilon: float) -> Manifold:
    """Two hulls in the frame of A, at most ``reach`` apart; normal from A to B.

    A segment of a chain, which knows its neighbours, is met as the first one; two segments never meet.
    """
    if a.segment and b.segment:
        return Manifold(a.normals[0], [])
    if b.segment:
        m = hull_hull(b, a, reach, slack, overlap, epsilon)
        m.normal = -m.normal
        m.points = [(point, gap, (feature & 255) << 8 | feature >> 8) for point, gap, feature in m.points]
        return m
    separation_a, edge_a, second_a = max_separation(a, b)
    separation_b, edge_b, second_b = max_separation(b, a)
    if max(separation_a, separation_b) > reach + a.radius + b.radius:
        return Manifold(a.normals[edge_a], [])
    # prefer A's edge, so that round-off does not switch between the two
    if separation_b > separation_a + slack:
        m = clip(edge_b, True, False, separation_b, slack, b, a, epsilon)
        m.normal = -m.normal
    else:
        m = clip(edge_a, False, False, separation_a, slack, a, b, epsilon)
    face = catches_corner(a, m.normal, edge_a) if m.points else None
    if face is not None:
        m = clip(face, False, True, 0.0, np.inf, a, b, epsilon)
    touching = a.radius + b.radius - overlap
    m.beside = m.corner or second_a >= touching or second_b >= touching
    if min(separation_a, separation_b) >= touching:
        m.beside = m.beside or dot(a.normals[edge_a], b.normals[edge_b]) > PARALLEL
    return m


def catches_corner(segment: Hull, normal: Array, nearest: int) -> int | None:
    """The segment's face if a normal at an inner corner of a chain lies outside those of the two segments there.

    ``nearest``: the face with less of the other hull beyond it, on which the segments of a flat chain have to agree.
    """
    v1, v2 = segment.vertices[:2]
    face = 0 if dot(segment.normals[0], normal) >= 0 else 1
    side = 1.0 if face == 0 else -1.0
    own = segment.normals[face]
    if abs(cross(own, normal)) <= 1e-3:
        return None
    at_start = dot(normal, v2 - v1) < 0
    ghost = segment.before if at_start else segment.beyond
    if ghost is None:
        return None
    neighbour = v1 - ghost if at_start else ghost - v2
    turn = side * (cross(neighbour, v2 - v1) if at_start else cross(v2 - v1, neighbour))
    if abs(turn) <= 1e-3 * length(neighbour) * length(v2 - v1):
        return nearest
    if turn <= 0:
        return face  # a hollow corner has no normals of its own
    theirs = side * np.array([neighbour[1], -neighbour[0]])
    # farther from this segment's normal than the neighbour's is
    return face if dot(normal, own) * length(theirs) < dot(theirs, own) else None
