"""Contact manifolds of two shapes, each the hull of its vertices plus a radius.

Discs meet discs and hulls in closed form; hulls meet hulls by separating axes and clipping of the incident edge
(as in Box2D v3), in the frame of the first one. Functions are inlined where they are called: what another backend
calls twice in a row, as for either hull or once more for a chain, is here a loop with one call.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.common import cross, dot, length, rotate, rotate_back
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.enums import ShapeType

SEGMENT = int(ShapeType.SEGMENT)
EPSILON = {"float32": 1e-9, "float64": 1e-15}  # distance over size below which there is no direction
PARALLEL = -0.999  # cosine of two outward normals below which they are of one axis


@ti.func
def feature_of(v_ref, v_inc, flip):
    feature = (v_ref << 8) | v_inc
    if flip:
        feature = (v_inc << 8) | v_ref
    return feature


@cache
def manifold_functions(dtype: str) -> SimpleNamespace:
    """The structs ``Manifold``, ``Hull`` and ``Frame``, and the functions of two shapes.

    ``disc_disc``, ``hull_disc`` and ``hull_hull`` make a manifold; ``hull_of`` and ``frame_of`` what they take.
    """
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    epsilon = EPSILON[dtype]

    # Up to two points: normal from the first shape to the second, midpoint between the surfaces, gap, feature.
    # ``corner``: the normal joins two corners. ``beside``: another axis than the normal's parts the shapes too, or they
    # touch along it, so that their motion decides where they will meet.
    Manifold = ti.types.struct(
        count=ti.i32,
        corner=ti.i32,
        beside=ti.i32,
        normal=vec2,
        point0=vec2,
        point1=vec2,
        gap0=real,
        gap1=real,
        feature0=ti.i32,
        feature1=ti.i32,
    )
    # A shape's core: its vertices from ``first`` on, two of them for a segment of a chain, and its radius.
    Hull = ti.types.struct(first=ti.i32, count=ti.i32, segment=ti.i32, radius=real)
    # Takes points of one frame to another: rotation by (cosine, sine), then translation.
    Frame = ti.types.struct(c=real, s=real, x=vec2)

    @ti.func
    def frame_of(c, s, x):
        frame = Frame()
        frame.c = c
        frame.s = s
        frame.x = x
        return frame

    @ti.func
    def inverse_of(frame):
        return frame_of(frame.c, -frame.s, rotate_back(frame.c, frame.s, frame.x) * -1.0)

    @ti.func
    def disc_disc(pa, ra, pb, rb):
        m = Manifold()
        d = pb - pa
        size = length(d)
        # coincident centres have no direction: take the world's x axis
        n = vec2(1.0, 0.0)
        if size > epsilon * (ra + rb):
            n = d / size
        m.count = 1
        m.normal = n
        m.gap0 = size - ra - rb
        m.point0 = pa + n * (ra + 0.5 * m.gap0)
        return m

    @ti.func
    def hull_of(shape, kind, radius, model: t.Model):
        hull = Hull()
        hull.first = model.vertex_start[shape]
        hull.count = model.vertex_start[shape + 1] - hull.first
        hull.segment = kind == SEGMENT
        if kind == SEGMENT:
            hull.count = 2
        hull.radius = radius
        return hull

    @ti.func
    def hull_disc(hull, p, r, model: t.Model):
        """Hull against a disc at p, both in the hull's frame; normal from the hull to the disc."""
        first = hull.first
        n = hull.count
        radius = hull.radius
        m = Manifold()
        best = real(-1e30)
        edge = 0
        for i in range(n):
            s = dot(model.vertex_normals[first + i], p - model.vertices[first + i])
            if s > best:
                best = s
                edge = i
        v1 = model.vertices[first + edge]
        after = edge + 1
        if after == n:
            after = 0
        v2 = model.vertices[first + after]
        along = v2 - v1
        u = dot(p - v1, along)
        length2 = dot(along, along)
        normal = model.vertex_normals[first + edge]
        distance = best
        corner = -1
        if best > 0.0:
            if u <= 0.0:
                corner = edge
            elif u >= length2:
                corner = after
        elif n == 2:
            # the centre lies on the line of the two vertices (best = 0): beyond an end it sees the corner
            if u < 0.0:
                corner = edge
            elif u > length2:
                corner = after
        m.count = 1
        m.corner = corner >= 0
        if corner >= 0:
            q = model.vertices[first + corner]
            d = p - q
            distance = length(d)
            if distance > epsilon * (radius + r):
                normal = d / distance
            if hull.segment != 0:
                # a neighbour of the chain owns this corner's side, or the corner itself if it comes earlier
                before = model.vertices[first + 2]
                beyond = model.vertices[first + 3]
                if corner == 0 and (before[0] != q[0] or before[1] != q[1]):
                    if dot(d, q - before) < -1e-4 * distance * length(q - before):
                        m.count = 0
                if corner == 1 and (beyond[0] != q[0] or beyond[1] != q[1]):
                    m.count = 0
        m.normal = normal
        m.gap0 = distance - radius - r
        m.point0 = p - normal * (r + 0.5 * m.gap0)
        return m

    @ti.func
    def max_separation(one, two, frame, model: t.Model):
        """Largest over hull 1's edges of the smallest distance of hull 2's vertices; (distance, edge, second largest).

        ``frame`` takes hull 2's frame to hull 1's.
        """
        c = frame.c
        s = frame.s
        x = frame.x
        best = real(-1e30)
        second = real(-1e30)
        edge = 0
        for i in range(one.count):
            normal = model.vertex_normals[one.first + i]
            offset = dot(normal, model.vertices[one.first + i] - x)
            turned = rotate_back(c, s, normal)
            low = real(1e30)
            for j in range(two.count):
                low = ti.min(low, dot(turned, model.vertices[two.first + j]))
            distance = low - offset
            if distance > best:
                second = best
                best = distance
                edge = i
            elif distance > second:
                second = distance
        return best, edge, second

    @ti.func
    def clip(edge, flip, forced, separation, slack, reference, incident, frame, model: t.Model):
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
        p1 = model.vertices[first1 + r1]
        p2 = model.vertices[first1 + r2]
        normal = model.vertex_normals[first1 + edge]
        # the incident edge looks most against the normal
        turned = rotate_back(c, s, normal)
        low = real(1e30)
        i1 = 0
        for j in range(n2):
            facing = dot(turned, model.vertex_normals[first2 + j])
            if facing < low:
                low = facing
                i1 = j
        i2 = i1 + 1
        if i2 == n2:
            i2 = 0
        q1 = rotate(c, s, model.vertices[first2 + i1]) + x
        q2 = rotate(c, s, model.vertices[first2 + i2]) + x
        along = p2 - p1
        size = length(along)
        along = along / size
        u1 = dot(q1 - p1, along)
        u2 = dot(q2 - p1, along)
        radii = radius1 + radius2
        m.normal = normal
        # clip both ends of the incident edge to the reference edge; a degenerate clip keeps the nearer end
        w1 = ti.min(ti.max(u1, 0.0), size)
        w2 = ti.min(ti.max(u2, 0.0), size)
        k1 = q1
        k2 = q2
        span = u2 - u1
        if ti.abs(span) > epsilon * size:
            k1 = q1 + (q2 - q1) * ((w1 - u1) / span)
            k2 = q1 + (q2 - q1) * ((w2 - u1) / span)
        g1 = dot(normal, k1 - p1)
        g2 = dot(normal, k2 - p1)
        outside = ti.max(u1, u2) < 0.0 or ti.min(u1, u2) > size
        if forced and outside:
            m.count = 0  # what lies past the end of a chain's segment is its neighbour's
        elif (outside and (separation > slack or (n1 == 2 and n2 == 2))) or (
            separation > slack and ti.min(g1, g2) > separation + slack
        ):
            # cores apart, and the nearest point of the incident hull does not face the edge: two corners are closest
            nearest = real(1e30)
            ref = 0
            inc = 0
            apart = x
            for j in range(n2):
                qj = rotate(c, s, model.vertices[first2 + j]) + x
                for i in range(n1):
                    between = qj - model.vertices[first1 + i]
                    squared = dot(between, between)
                    if squared < nearest:
                        nearest = squared
                        ref = i
                        inc = j
                        apart = between
            distance = ti.sqrt(nearest)
            m.count = 1
            m.corner = 1
            m.normal = apart / distance
            m.gap0 = distance - radii
            m.point0 = model.vertices[first1 + ref] + m.normal * (radius1 + 0.5 * m.gap0)
            m.feature0 = feature_of(ref, inc, flip)
        else:
            if outside:
                # deep overlap past the edge's end: the support vertex itself, not a point of its edge's extension
                k1 = q1
                k2 = q2
                g1 = dot(normal, q1 - p1)
                g2 = dot(normal, q2 - p1)
            half = 0.5 * (radius1 - radius2)
            m.count = 2
            m.gap0 = g1 - radii
            m.gap1 = g2 - radii
            m.point0 = k1 + normal * (half - 0.5 * g1)
            m.point1 = k2 + normal * (half - 0.5 * g2)
            # the incident edge runs against the reference edge: its first end meets the reference's second
            m.feature0 = feature_of(r2, i1, flip)
            m.feature1 = feature_of(r1, i2, flip)
            if w1 == w2 or ti.abs(span) <= epsilon * size:
                # one point only: the deeper end
                m.count = 1
                if g2 < g1:
                    m.gap0 = m.gap1
                    m.point0 = m.point1
                    m.feature0 = m.feature1
        return m

    @ti.func
    def chain_face(a, edge, normal, model: t.Model):
        """The edge of a chain's segment that has to be the reference, or -1 where a manifold's normal is right.

        A chain's inner corners must not catch a shape that slides over them: the normal has to lie between those of the
        two segments that meet there, else the segment's own edge is the reference. ``edge``: of the largest separation.
        """
        v1 = model.vertices[a.first]
        v2 = model.vertices[a.first + 1]
        face = 0
        side = real(1.0)
        if dot(model.vertex_normals[a.first], normal) < 0.0:
            face = 1
            side = -1.0
        own = model.vertex_normals[a.first + face]
        wanted = -1
        if not (ti.abs(cross(own, normal)) <= 1e-3):  # nor where corners touch, whose normal is NaN
            neighbour = model.vertices[a.first + 3] - v2
            turn = cross(v2 - v1, neighbour) * side
            if dot(normal, v2 - v1) < 0.0:  # at the start
                neighbour = v1 - model.vertices[a.first + 2]
                turn = cross(neighbour, v2 - v1) * side
            if neighbour[0] != 0.0 or neighbour[1] != 0.0:
                theirs = vec2(neighbour[1], -neighbour[0]) * side
                if ti.abs(turn) <= 1e-3 * length(neighbour) * length(v2 - v1):
                    # segments of a flat chain have to agree on a side: that with less of the hull beyond it
                    wanted = edge
                elif turn <= 0.0:
                    wanted = face
                elif dot(normal, own) * length(theirs) < dot(theirs, own):
                    # not between: farther from this segment's normal than the neighbour's is
                    wanted = face
        return wanted

    @ti.func
    def meet(a, b, frame, reach, slack, overlap, model: t.Model):
        """Two hulls, of which the first alone may be a segment, in its frame, to which ``frame`` takes the other."""
        c = frame.c
        s = frame.s
        x = frame.x
        m = Manifold()
        back = inverse_of(frame)
        separation = vec2(0.0, 0.0)  # along A's edges, and B's
        second = vec2(0.0, 0.0)
        edge_a = 0
        edge_b = 0
        for turn in range(2):
            one = a
            two = b
            there = frame
            if turn == 1:
                one = b
                two = a
                there = back
            best, edge, after = max_separation(one, two, there, model)
            if turn == 0:
                separation[0] = best
                second[0] = after
                edge_a = edge
            else:
                separation[1] = best
                second[1] = after
                edge_b = edge
        radii = a.radius + b.radius
        if ti.max(separation[0], separation[1]) <= reach + radii:
            touching = radii - overlap
            beside = second[0] >= touching or second[1] >= touching
            if separation[0] >= touching and separation[1] >= touching:
                theirs = rotate(c, s, model.vertex_normals[b.first + edge_b])
                beside = beside or dot(model.vertex_normals[a.first + edge_a], theirs) > PARALLEL
            # prefer A's edge, so that round-off does not switch between the two
            flip = separation[1] > separation[0] + slack
            edge = edge_a
            apart = separation[0]
            one = a
            two = b
            there = frame
            if flip:
                edge = edge_b
                apart = separation[1]
                one = b
                two = a
                there = back
            limit = slack
            forced = False
            face = 0
            while face >= 0:
                m = clip(edge, flip, forced, apart, limit, one, two, there, model)
                if flip:
                    m.normal = rotate(c, s, m.normal) * -1.0
                    m.point0 = rotate(c, s, m.point0) + x
                    m.point1 = rotate(c, s, m.point1) + x
                face = -1
                if a.segment != 0 and not forced:
                    face = chain_face(a, edge_a, m.normal, model)
                edge = face
                flip = False
                forced = True
                apart = 0.0
                limit = 1e30
                one = a
                two = b
                there = frame
            m.beside = beside or m.corner != 0
        return m

    @ti.func
    def hull_hull(a, b, frame, reach, slack, overlap, model: t.Model):
        """Two hulls, in the frame of A, to which ``frame`` takes that of B; normal from A to B.

        A segment of a chain is met in its own frame, as it knows its neighbours; two segments never meet.
        """
        m = Manifold()
        turned = b.segment != 0
        one = a
        two = b
        pose = frame
        if turned:
            one = b
            two = a
            pose = inverse_of(frame)
        if a.segment == 0 or b.segment == 0:
            m = meet(one, two, pose, reach, slack, overlap, model)
        if turned:
            m.normal = rotate(frame.c, frame.s, m.normal) * -1.0
            m.point0 = rotate(frame.c, frame.s, m.point0) + frame.x
            m.point1 = rotate(frame.c, frame.s, m.point1) + frame.x
            m.feature0 = ((m.feature0 & 255) << 8) | (m.feature0 >> 8)
            m.feature1 = ((m.feature1 & 255) << 8) | (m.feature1 >> 8)
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
