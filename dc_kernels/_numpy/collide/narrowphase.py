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
from dc_kernels.model.enums import BodyType, Flag, ShapeType
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
        """The hull in another frame: turned by r, then moved by x."""
        return Hull(rotate(r, self.vertices) + x, rotate(r, self.normals), self.radius)


@dataclass
class Manifold:
    """Contact points of a pair: (midpoint between the surfaces, gap, feature) each; normal from the first shape."""

    normal: Array
    points: list[tuple[Array, Any, int]]

    def placed(self, r: Array, x: Array, flip: bool = False) -> Manifold:
        """The manifold in another frame: turned by r, then moved by x; ``flip`` turns its normal around."""
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
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        motion: Any,
        pairs: Any,
        contacts: Any,
        rows: Any,
    ) -> None:
        """Contacts of a world: gap below the speculative distance, or closing within the step."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return

        def hull_of(shape: int) -> Hull:
            first, last = model.vertex_start[shape], model.vertex_start[shape + 1]
            if model.shape_type[shape] == ShapeType.POLYGON:
                return Hull(model.vertices[first:last], model.vertex_normals[first:last], model.shape_radius[shape])
            v1, v2, before, beyond = model.vertices[first : first + 4]
            return Hull(
                model.vertices[first : first + 2],
                model.vertex_normals[first : first + 2],
                model.shape_radius[shape],
                None if (before == v1).all() else before,
                None if (beyond == v2).all() else beyond,
            )

        def manifold(a: int, b: int) -> Manifold:
            """Points of a pair in world axes."""
            xa, xb = state.position[model.shape_body[a]], state.position[model.shape_body[b]]
            turn_a, turn_b = rotation(state.angle[model.shape_body[a]]), rotation(state.angle[model.shape_body[b]])
            centre_a, centre_b = xa + rotate(turn_a, model.shape_center[a]), xb + rotate(turn_b, model.shape_center[b])
            disc_a, disc_b = model.shape_type[a] == ShapeType.DISC, model.shape_type[b] == ShapeType.DISC
            if disc_a and disc_b:
                return disc_disc(centre_a, model.shape_radius[a], centre_b, model.shape_radius[b], epsilon)
            if disc_a:
                local = rotate(turn_b.T, centre_a - xb)
                return hull_disc(hull_of(b), local, model.shape_radius[a], epsilon).placed(turn_b, xb, flip=True)
            if disc_b:
                local = rotate(turn_a.T, centre_b - xa)
                return hull_disc(hull_of(a), local, model.shape_radius[b], epsilon).placed(turn_a, xa)
            relative = rotation(state.angle[model.shape_body[b]] - state.angle[model.shape_body[a]])
            hull_b = hull_of(b).placed(relative, rotate(turn_a.T, xb - xa))
            va, vb = motion.predicted[model.shape_body[a]], motion.predicted[model.shape_body[b]]
            spin = sum(
                abs(v[2]) * (length(model.shape_center[s]) + model.shape_extent[s]) for v, s in ((va, a), (vb, b))
            )
            within = speculative + motion.step_dt[w] * (length(vb - va) + spin)
            return hull_hull(hull_of(a), hull_b, within, slack, epsilon).placed(turn_a, xa)

        speculative = motion.reach[w]
        slack = config.slack * model.length_scale[w]
        found = []
        for pair in range(pairs.start[w], pairs.start[w] + pairs.count[w]):
            a, b = int(pairs.shape_a[pair]), int(pairs.shape_b[pair])
            m = manifold(a, b)
            ba, bb = model.shape_body[a], model.shape_body[b]
            va, vb = motion.predicted[ba], motion.predicted[bb]
            shapes = (a - int(model.shape_start[w])) << KEY_SHAPE_BITS | (b - int(model.shape_start[w]))
            for point, g, feature in m.points:
                to_a, to_b = point - state.position[ba], point - state.position[bb]
                speed = dot(m.normal, vb - va) + cross(to_b, m.normal) * vb[2] - cross(to_a, m.normal) * va[2]
                if g <= speculative + max(-speed * motion.step_dt[w], 0.0):
                    found.append((shapes << KEY_FEATURE_BITS | feature, a, b, m.normal, to_a, to_b, g))
        found.sort(key=lambda contact: contact[0])
        rows.contact_needed[w] = len(found)
        if len(found) > contacts.contact_start[w + 1] - contacts.contact_start[w]:
            state.flags[w] |= Flag.CONTACT_OVERFLOW
            contacts.contact_count[w] = 0
            return
        contacts.contact_count[w] = len(found)
        for c, (number, a, b, n, to_a, to_b, g) in enumerate(found, contacts.contact_start[w]):
            contacts.key[c] = number
            contacts.body_a[c], contacts.body_b[c] = model.shape_body[a], model.shape_body[b]
            contacts.normal[c], contacts.arm_a[c], contacts.arm_b[c], contacts.gap[c] = n, to_a, to_b, g
            contacts.friction[c] = np.sqrt(model.shape_friction[a] * model.shape_friction[b])
            contacts.restitution[c] = max(model.shape_restitution[a], model.shape_restitution[b])

    return {"narrowphase": narrowphase}


def stage_kernels(dtype: str) -> Kernels:
    """What a stage for anybody's arrays runs before and after ``narrowphase``; the arrays bring their scalar type."""
    return {"take_pairs": take_pairs, "place_contacts": place_contacts}


def take_pairs(
    tid: int, launch: Any, model: Any, state: Any, pair: Array, pair_count: Array, pairs: Any, contacts: Any
) -> None:
    """Take a world's pairs of shapes in the order given, A static or the lower index, and look at its bodies."""
    w = tid + launch.world_offset
    state.flags[w] = contacts.contact_count[w] = 0
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    if not (np.isfinite(state.position[bodies]).all() and np.isfinite(state.angle[bodies]).all()):
        state.flags[w] = Flag.INVALID
    if len(pair) == 0:
        return
    first, count = pairs.start[w], pair_count[w]
    given = np.sort(pair[first : first + max(count, 0)], axis=1)
    a, b = given.T
    inside = (a >= model.shape_start[w]) & (b < model.shape_start[w + 1]) & (a != b)
    if not 0 <= count <= pairs.start[w + 1] - first or not inside.all():
        state.flags[w] = Flag.INVALID
        return
    static = model.body_type[model.shape_body[b]] == BodyType.STATIC
    pairs.shape_a[first : first + count] = np.where(static, b, a)
    pairs.shape_b[first : first + count] = np.where(static, a, b)
    pairs.count[w] = count


def place_contacts(tid: int, launch: Any, state: Any, contacts: Any, point: Array) -> None:
    """Where the contacts of a world are, midway between the surfaces."""
    w = tid + launch.world_offset
    first = contacts.contact_start[w]
    used = slice(first, first + contacts.contact_count[w])
    point[used] = state.position[contacts.body_a[used]] + contacts.arm_a[used]
