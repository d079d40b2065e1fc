"""Candidate pairs -> contact points with normals from A to B and stable keys, sorted by key.

Shapes are hulls of vertices plus a radius. Discs meet discs and hulls in closed form; hulls meet hulls by
separating axes and clipping of the incident edge (as in Box2D v3). Each pair is treated in the frame of one of
its shapes and turned to world axes at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, cross, dot, rotate, rotation
from dc_kernels.model.enums import Flag, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS


@dataclass
class Hull:
    """A shape's core in some frame: vertices, counter-clockwise, and the normals of the edges that start there."""

    vertices: Array  # (n, 2)
    normals: Array  # (n, 2)
    radius: Any
    before: Array | None = None  # of a chain's segment: the neighbouring vertices, where there are any
    beyond: Array | None = None

    def placed(self, r: Array, x: Array) -> Hull:
        """The same hull in another frame: turned by r, then moved by x."""
        return Hull(rotate(r, self.vertices) + x, rotate(r, self.normals), self.radius)


@dataclass
class Manifold:
    """Contact points of a pair: (midpoint between the surfaces, gap, feature) each; normal from the first shape."""

    normal: Array
    points: list[tuple[Array, Any, int]]

    def placed(self, r: Array, x: Array, flip: bool = False) -> Manifold:
        """The same in another frame; with ``flip`` the normal turns around."""
        normal = rotate(r, self.normal)
        return Manifold(-normal if flip else normal, [(rotate(r, p) + x, gap, f) for p, gap, f in self.points])


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
    return Manifold(normal, [(p - normal * (r + 0.5 * gap), gap, 0)])


def max_separation(hull: Hull, other: Hull) -> tuple[Any, int]:
    """Largest over the edges of ``hull`` of the smallest distance of the other's vertices, and the edge."""
    distance = dot(hull.normals[:, None], other.vertices[None] - hull.vertices[:, None]).min(axis=1)
    edge = int(np.argmax(distance))
    return distance[edge], edge


def closest_corners(one: Hull, two: Hull, feature: Callable[[int, int], int]) -> Manifold:
    """One point between the nearest vertices of two hulls that are apart, along the line that joins them."""
    between = two.vertices[:, None] - one.vertices
    of_two, of_one = np.unravel_index(np.argmin(dot(between, between)), between.shape[:2])
    d = between[of_two, of_one]
    gap = length(d) - one.radius - two.radius
    n = d / length(d)
    at = one.vertices[of_one] + n * (one.radius + 0.5 * gap)
    return Manifold(n, [(at, gap, feature(int(of_one), int(of_two)))])


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


def hull_hull(a: Hull, b: Hull, reach: Any, slack: Any, epsilon: float) -> Manifold:
    """Two hulls in the frame of A, at most ``reach`` apart; normal from A to B."""
    separation_a, edge_a = max_separation(a, b)
    separation_b, edge_b = max_separation(b, a)
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


def kernels(dtype: str, only_discs: bool) -> Kernels:
    """``narrowphase``, the same whatever moves.

    Args:
        dtype: "float32" or "float64": what counts as zero distance.
        only_discs: whether all that moves are discs about their centre of mass.
    """
    epsilon = 1e-9 if dtype == "float32" else 1e-15

    def narrowphase(
        tid: int,
        world_offset: int,
        slack_factor: float,
        uniform_friction: float,
        uniform_restitution: float,
        shape_start: Array,
        length_scale: Array,
        shape_body: Array,
        shape_type: Array,
        shape_radius: Array,
        shape_center: Array,
        shape_extent: Array,
        shape_friction: Array,
        shape_restitution: Array,
        vertex_start: Array,
        vertices: Array,
        vertex_normals: Array,
        position: Array,
        angle: Array,
        step_dt: Array,
        reach: Array,
        predicted: Array,
        pair_start: Array,
        pair_count: Array,
        pair_a: Array,
        pair_b: Array,
        flags: Array,
        contact_start: Array,
        contact_count: Array,
        contact_needed: Array,
        key: Array,
        body_a: Array,
        body_b: Array,
        normal: Array,
        arm_a: Array,
        arm_b: Array,
        gap: Array,
        friction: Array,
        restitution: Array,
    ) -> None:
        """Contacts of a world: gap below the speculative distance, or closing within the step."""
        w = tid + world_offset
        if flags[w]:
            return

        def hull_of(shape: int) -> Hull:
            first, last = vertex_start[shape], vertex_start[shape + 1]
            if shape_type[shape] == ShapeType.POLYGON:
                return Hull(vertices[first:last], vertex_normals[first:last], shape_radius[shape])
            v1, v2, before, beyond = vertices[first : first + 4]
            return Hull(
                vertices[first : first + 2],
                vertex_normals[first : first + 2],
                shape_radius[shape],
                None if (before == v1).all() else before,
                None if (beyond == v2).all() else beyond,
            )

        def manifold(a: int, b: int) -> Manifold:
            """Points of a pair in world axes."""
            xa, xb = position[shape_body[a]], position[shape_body[b]]
            turn_a, turn_b = rotation(angle[shape_body[a]]), rotation(angle[shape_body[b]])
            centre_a, centre_b = xa + rotate(turn_a, shape_center[a]), xb + rotate(turn_b, shape_center[b])
            disc_a, disc_b = shape_type[a] == ShapeType.DISC, shape_type[b] == ShapeType.DISC
            if disc_a and disc_b:
                return disc_disc(centre_a, shape_radius[a], centre_b, shape_radius[b], epsilon)
            if disc_a:
                local = rotate(turn_b.T, centre_a - xb)
                return hull_disc(hull_of(b), local, shape_radius[a], epsilon).placed(turn_b, xb, flip=True)
            if disc_b:
                local = rotate(turn_a.T, centre_b - xa)
                return hull_disc(hull_of(a), local, shape_radius[b], epsilon).placed(turn_a, xa)
            relative = rotation(angle[shape_body[b]] - angle[shape_body[a]])
            hull_b = hull_of(b).placed(relative, rotate(turn_a.T, xb - xa))
            va, vb = predicted[shape_body[a]], predicted[shape_body[b]]
            spin = sum(abs(v[2]) * (length(shape_center[s]) + shape_extent[s]) for v, s in ((va, a), (vb, b)))
            within = speculative + step_dt[w] * (length(vb - va) + spin)
            return hull_hull(hull_of(a), hull_b, within, slack, epsilon).placed(turn_a, xa)

        speculative = reach[w]
        slack = slack_factor * length_scale[w]
        found = []
        for pair in range(pair_start[w], pair_start[w] + pair_count[w]):
            a, b = int(pair_a[pair]), int(pair_b[pair])
            m = manifold(a, b)
            ba, bb = shape_body[a], shape_body[b]
            va, vb = predicted[ba], predicted[bb]
            shapes = (a - int(shape_start[w])) << KEY_SHAPE_BITS | (b - int(shape_start[w]))
            for point, g, feature in m.points:
                to_a, to_b = point - position[ba], point - position[bb]
                speed = dot(m.normal, vb - va) + cross(to_b, m.normal) * vb[2] - cross(to_a, m.normal) * va[2]
                if g <= speculative + max(-speed * step_dt[w], 0.0):
                    found.append((shapes << KEY_FEATURE_BITS | feature, a, b, m.normal, to_a, to_b, g))
        found.sort(key=lambda contact: contact[0])
        contact_needed[w] = len(found)
        if len(found) > contact_start[w + 1] - contact_start[w]:
            flags[w] |= Flag.CONTACT_OVERFLOW
            contact_count[w] = 0
            return
        contact_count[w] = len(found)
        for c, (number, a, b, n, to_a, to_b, g) in enumerate(found, contact_start[w]):
            key[c] = number
            body_a[c], body_b[c] = shape_body[a], shape_body[b]
            normal[c], arm_a[c], arm_b[c], gap[c] = n, to_a, to_b, g
            friction[c] = np.sqrt(shape_friction[a] * shape_friction[b])
            restitution[c] = max(shape_restitution[a], shape_restitution[b])

    return {"narrowphase": narrowphase}
