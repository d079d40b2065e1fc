"""Contact manifolds of two shapes, each the hull of its vertices plus a radius.

Discs meet discs and hulls in closed form; hulls meet hulls by separating axes and clipping of the incident edge
(as in Box2D v3), in the frame of the first one.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, rotate, rotate_back, scalar_types
from dc_kernels.model.enums import ShapeType

EPSILON = {"float32": 1e-9, "float64": 1e-15}  # distance over size below which there is no direction
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
PARALLEL = wp.constant(-0.999)  # cosine of two outward normals below which they are of one axis


@cache
def manifold_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """The structs ``Manifold``, ``Hull`` and ``Frame``, and the functions of two shapes.

    ``disc_disc``, ``hull_disc`` and ``hull_hull`` make a manifold; ``hull_of`` and ``frame_of`` what they take.
    """
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    epsilon = real(EPSILON[dtype])

    class Points:
        """Up to two points: normal from the first shape to the second, midpoint between the surfaces, gap, feature.

        ``corner``: the normal joins two corners. ``beside``: another axis than the normal's parts the shapes too, or
        they touch along it, so that their motion decides where they will meet.
        """

        count: wp.int32
        corner: wp.bool
        beside: wp.bool
        normal: vec2
        point0: vec2
        point1: vec2
        gap0: real
        gap1: real
        feature0: wp.int32
        feature1: wp.int32

    Manifold = wp.struct(Points, module=module)

    class HullFields:
        """A shape's core: its vertices from ``first`` on, two of them for a segment of a chain, and its radius."""

        first: wp.int32
        count: wp.int32
        segment: wp.bool
        radius: real

    Hull = wp.struct(HullFields, module=module)

    class FrameFields:
        """Takes points of one frame to another: rotation by (cosine, sine), then translation."""

        c: real
        s: real
        x: vec2

    Frame = wp.struct(FrameFields, module=module)

    @wp.func(module=module)
    def frame_of(c: real, s: real, x: vec2):
        frame = Frame()
        frame.c = c
        frame.s = s
        frame.x = x
        return frame

    @wp.func(module=module)
    def inverse_of(frame: Frame):
        return frame_of(frame.c, -frame.s, -rotate_back(frame.c, frame.s, frame.x))

    @wp.func(module=module)
    def disc_disc(pa: vec2, ra: real, pb: vec2, rb: real):
        m = Manifold()
        d = pb - pa
        length = wp.length(d)
        # coincident centres have no direction: take the world's x axis
        n = vec2(real(1.0), real(0.0))
        if length > epsilon * (ra + rb):
            n = d / length
        m.count = 1
        m.normal = n
        m.gap0 = length - ra - rb
        m.point0 = pa + n * (ra + real(0.5) * m.gap0)
        return m

    @wp.func(module=module)
    def hull_of(shape: int, kind: int, radius: real, vertex_start: wp.array(dtype=wp.int32)):
        hull = Hull()
        hull.first = vertex_start[shape]
        hull.count = vertex_start[shape + 1] - hull.first
        hull.segment = kind == SEGMENT
        if hull.segment:
            hull.count = 2
        hull.radius = radius
        return hull

    @wp.func(module=module)
    def hull_disc(hull: Hull, p: vec2, r: real, vertices: wp.array(dtype=vec2), vertex_normals: wp.array(dtype=vec2)):
        """Hull against a disc at p, both in the hull's frame; normal from the hull to the disc."""
        first = hull.first
        n = hull.count
        radius = hull.radius
        m = Manifold()
        best = real(-1e30)
        edge = int(0)
        for i in range(n):
            s = wp.dot(vertex_normals[first + i], p - vertices[first + i])
            if s > best:
                best = s
                edge = i
        v1 = vertices[first + edge]
        after = edge + 1
        if after == n:
            after = 0
        v2 = vertices[first + after]
        along = v2 - v1
        u = wp.dot(p - v1, along)
        length2 = wp.dot(along, along)
        normal = vertex_normals[first + edge]
        distance = best
        corner = int(-1)
        if best > real(0.0):
            if u <= real(0.0):
                corner = edge
            elif u >= length2:
                corner = after
        elif n == 2:
            # the centre lies on the line of the two vertices (best = 0): beyond an end it sees the corner
            if u < real(0.0):
                corner = edge
            elif u > length2:
                corner = after
        m.count = 1
        m.corner = corner >= 0
        if corner >= 0:
            q = vertices[first + corner]
            d = p - q
            distance = wp.length(d)
            if distance > epsilon * (radius + r):
                normal = d / distance
            if hull.segment:
                # a neighbour of the chain owns this corner's side, or the corner itself if it comes earlier
                before = vertices[first + 2]
                beyond = vertices[first + 3]
                if corner == 0 and (before[0] != q[0] or before[1] != q[1]):
                    if wp.dot(d, q - before) < real(-1e-4) * distance * wp.length(q - before):
                        m.count = 0
                if corner == 1 and (beyond[0] != q[0] or beyond[1] != q[1]):
                    m.count = 0
        m.normal = normal
        m.gap0 = distance - radius - r
        m.point0 = p - normal * (r + real(0.5) * m.gap0)
        return m

    @wp.func(module=module)
    def max_separation(
        one: Hull,
        two: Hull,
        frame: Frame,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """Largest over hull 1's edges of the smallest distance of hull 2's vertices; (distance, edge, second largest).

        ``frame`` takes hull 2's frame to hull 1's.
        """
        first1 = one.first
        n1 = one.count
        first2 = two.first
        n2 = two.count
        c = frame.c
        s = frame.s
        x = frame.x
        best = real(-1e30)
        second = real(-1e30)
        edge = int(0)
        for i in range(n1):
            normal = vertex_normals[first1 + i]
            offset = wp.dot(normal, vertices[first1 + i] - x)
            turned = rotate_back(c, s, normal)
            low = real(1e30)
            for j in range(n2):
                low = wp.min(low, wp.dot(turned, vertices[first2 + j]))
            distance = low - offset
            second = wp.max(second, wp.min(best, distance))
            if distance > best:
                best = distance
                edge = i
        return best, edge, second

    @wp.func(module=module)
    def feature_of(v_ref: int, v_inc: int, flip: bool):
        if flip:
            return (v_inc << 8) | v_ref
        return (v_ref << 8) | v_inc

    @wp.func(module=module)
    def clip(
        edge: int,
        flip: bool,
        forced: bool,
        separation: real,
        slack: real,
        reference: Hull,
        incident: Hull,
        frame: Frame,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """Manifold on a reference edge: the incident edge clipped to it, or the closest corners unless forced.

        All in the frame of the reference hull, to which ``frame`` takes the incident one's.
        """
        first1 = reference.first
        n1 = reference.count
        radius1 = reference.radius
        first2 = incident.first
        n2 = incident.count
        radius2 = incident.radius
        c = frame.c
        s = frame.s
        x = frame.x
        m = Manifold()
        r1 = edge
        r2 = edge + 1
        if r2 == n1:
            r2 = 0
        p1 = vertices[first1 + r1]
        p2 = vertices[first1 + r2]
        normal = vertex_normals[first1 + edge]
        # the incident edge looks most against the normal
        turned = rotate_back(c, s, normal)
        low = real(1e30)
        i1 = int(0)
        for j in range(n2):
            facing = wp.dot(turned, vertex_normals[first2 + j])
            if facing < low:
                low = facing
                i1 = j
        i2 = i1 + 1
        if i2 == n2:
            i2 = 0
        q1 = rotate(c, s, vertices[first2 + i1]) + x
        q2 = rotate(c, s, vertices[first2 + i2]) + x
        along = p2 - p1
        length = wp.length(along)
        along = along / length
        u1 = wp.dot(q1 - p1, along)
        u2 = wp.dot(q2 - p1, along)
        radii = radius1 + radius2
        m.normal = normal
        # clip both ends of the incident edge to the reference edge; a degenerate clip keeps the nearer end
        w1 = wp.clamp(u1, real(0.0), length)
        w2 = wp.clamp(u2, real(0.0), length)
        k1 = q1
        k2 = q2
        span = u2 - u1
        if wp.abs(span) > epsilon * length:
            k1 = q1 + (q2 - q1) * ((w1 - u1) / span)
            k2 = q1 + (q2 - q1) * ((w2 - u1) / span)
        g1 = wp.dot(normal, k1 - p1)
        g2 = wp.dot(normal, k2 - p1)
        outside = wp.max(u1, u2) < real(0.0) or wp.min(u1, u2) > length
        if forced and outside:
            return m  # what lies past the end of a chain's segment is its neighbour's
        if (outside and (separation > slack or (n1 == 2 and n2 == 2))) or (
            separation > slack and wp.min(g1, g2) > separation + slack
        ):
            # cores apart, and the nearest point of the incident hull does not face the edge: two corners are closest
            nearest = real(1e30)
            ref = int(0)
            inc = int(0)
            apart = x
            for j in range(n2):
                qj = rotate(c, s, vertices[first2 + j]) + x
                for i in range(n1):
                    between = qj - vertices[first1 + i]
                    squared = wp.length_sq(between)
                    if squared < nearest:
                        nearest = squared
                        ref = i
                        inc = j
                        apart = between
            distance = wp.sqrt(nearest)
            m.count = 1
            m.corner = True
            m.normal = apart / distance
            m.gap0 = distance - radii
            m.point0 = vertices[first1 + ref] + m.normal * (radius1 + real(0.5) * m.gap0)
            m.feature0 = feature_of(ref, inc, flip)
            return m
        half = real(0.5) * (radius1 - radius2)
        m.count = 2
        m.gap0 = g1 - radii
        m.gap1 = g2 - radii
        m.point0 = k1 + normal * (half - real(0.5) * g1)
        m.point1 = k2 + normal * (half - real(0.5) * g2)
        # the incident edge runs against the reference edge: its first end meets the reference's second
        m.feature0 = feature_of(r2, i1, flip)
        m.feature1 = feature_of(r1, i2, flip)
        if outside:
            # deep overlap past the edge's end: the support vertex itself, not a point of its edge's extension
            k1 = q1
            k2 = q2
            g1 = wp.dot(normal, q1 - p1)
            g2 = wp.dot(normal, q2 - p1)
            m.gap0 = g1 - radii
            m.gap1 = g2 - radii
            m.point0 = k1 + normal * (half - real(0.5) * g1)
            m.point1 = k2 + normal * (half - real(0.5) * g2)
        if w1 == w2 or wp.abs(span) <= epsilon * length:
            # one point only: the deeper end
            m.count = 1
            if g2 < g1:
                m.gap0 = m.gap1
                m.point0 = m.point1
                m.feature0 = m.feature1
        return m

    @wp.func(module=module)
    def hull_hull(
        a: Hull,
        b: Hull,
        frame: Frame,
        reach: real,
        slack: real,
        overlap: real,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """Two hulls, in the frame of A, to which ``frame`` takes that of B; normal from A to B."""
        first_a = a.first
        c = frame.c
        s = frame.s
        x = frame.x
        m = Manifold()
        back = inverse_of(frame)
        sep_a, edge_a, second_a = max_separation(a, b, frame, vertices, vertex_normals)
        sep_b, edge_b, second_b = max_separation(b, a, back, vertices, vertex_normals)
        radii = a.radius + b.radius
        if wp.max(sep_a, sep_b) > reach + radii:
            return m
        touching = radii - overlap
        beside = second_a >= touching or second_b >= touching
        if sep_a >= touching and sep_b >= touching:
            facing = wp.dot(vertex_normals[first_a + edge_a], rotate(c, s, vertex_normals[b.first + edge_b]))
            beside = beside or facing > real(PARALLEL)
        # prefer A's edge, so that round-off does not switch between the two
        if sep_b > sep_a + slack:
            m = clip(edge_b, True, False, sep_b, slack, b, a, back, vertices, vertex_normals)
            m.normal = -rotate(c, s, m.normal)
            m.point0 = rotate(c, s, m.point0) + x
            m.point1 = rotate(c, s, m.point1) + x
        else:
            m = clip(edge_a, False, False, sep_a, slack, a, b, frame, vertices, vertex_normals)
        if a.segment:
            # a chain's inner corners must not catch a shape that slides over them: the normal has to lie between
            # those of the two segments that meet there, else the segment's own edge is the reference
            v1 = vertices[first_a]
            v2 = vertices[first_a + 1]
            face = int(0)
            side = real(1.0)
            if wp.dot(vertex_normals[first_a], m.normal) < real(0.0):
                face = 1
                side = real(-1.0)
            own = vertex_normals[first_a + face]
            bad = False
            if wp.abs(cross(own, m.normal)) > real(1e-3):
                at_start = wp.dot(m.normal, v2 - v1) < real(0.0)
                neighbour = vertices[first_a + 3] - v2
                turn = cross(v2 - v1, neighbour) * side
                if at_start:
                    neighbour = v1 - vertices[first_a + 2]
                    turn = cross(neighbour, v2 - v1) * side
                if neighbour[0] != real(0.0) or neighbour[1] != real(0.0):
                    theirs = vec2(neighbour[1], -neighbour[0]) * side
                    if wp.abs(turn) <= real(1e-3) * wp.length(neighbour) * wp.length(v2 - v1):
                        # segments of a flat chain have to agree on a side: that with less of the hull beyond it
                        bad = True
                        face = edge_a
                    elif turn <= real(0.0):
                        bad = True
                    else:
                        # between: no farther from this segment's normal than the neighbour's is
                        bad = wp.dot(m.normal, own) * wp.length(theirs) < wp.dot(theirs, own)
            if bad:
                m = clip(face, False, True, real(0.0), real(1e30), a, b, frame, vertices, vertex_normals)
        m.beside = beside or m.corner
        return m

    return SimpleNamespace(
        Manifold=Manifold,
        Hull=Hull,
        Frame=Frame,
        disc_disc=disc_disc,
        hull_of=hull_of,
        frame_of=frame_of,
        hull_disc=hull_disc,
        hull_hull=hull_hull,
    )
