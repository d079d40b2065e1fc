"""Contact manifolds of two shapes, each the hull of its vertices plus a radius.

Discs meet discs and hulls in closed form; hulls meet hulls by separating axes and clipping of the incident edge
(as in Box2D v3), in the frame of the first one.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate, rotate_back, scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.shapes import MAX_VERTICES

EPSILON = {"float32": 1e-9, "float64": 1e-15}  # distance over size below which there is no direction
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
PARALLEL = -0.999  # cosine of two outward normals below which they are of one axis


@wp.func
def turned_feature(feature: int):
    """A feature with the vertex of the second shape before that of the first."""
    return ((feature & 255) << 8) | (feature >> 8)


@cache
def manifold_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """The structs ``Manifold``, ``Hull`` and ``Frame``, and the functions of two shapes.

    ``disc_disc``, ``hull_disc`` and ``hull_hull`` make a manifold; ``hull_of`` and ``frame_of`` what they take.
    """
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    epsilon = real(EPSILON[dtype])
    Met = wp.types.vector(11, real)

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

    @wp.func_native(
        native_code(
            "prelude.h",
            "collide/hull.h",
            "collide/hull_hull.h",
            dtype=dtype,
            LANES=MAX_VERTICES,
            EPSILON=EPSILON[dtype],
            PARALLEL=PARALLEL,
        )
    )
    def meet(
        a: Hull,
        b: Hull,
        frame: Frame,
        reach: real,
        slack: real,
        overlap: real,
        vertices: wp.array(dtype=vec2),
        normals: wp.array(dtype=vec2),
    ) -> Met: ...

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
        """Two hulls, in the frame of A, to which ``frame`` takes that of B; normal from A to B.

        A segment of a chain is met in its own frame, as it knows its neighbours; two segments never meet.
        """
        m = Manifold()
        if a.segment and b.segment:
            return m
        one = a
        two = b
        pose = frame
        if b.segment:
            one = b
            two = a
            pose = frame_of(frame.c, -frame.s, -rotate_back(frame.c, frame.s, frame.x))
        met = meet(one, two, pose, reach, slack, overlap, vertices, vertex_normals)
        bits = int(met[0])
        m.count = bits & 3
        m.corner = (bits & 4) != 0
        m.beside = (bits & 8) != 0
        m.feature0 = int(met[1])
        m.feature1 = int(met[2])
        m.gap0 = met[3]
        m.gap1 = met[4]
        m.normal = vec2(met[5], met[6])
        m.point0 = vec2(met[7], met[8])
        m.point1 = vec2(met[9], met[10])
        if b.segment:
            m.normal = -rotate(frame.c, frame.s, m.normal)
            m.point0 = rotate(frame.c, frame.s, m.point0) + frame.x
            m.point1 = rotate(frame.c, frame.s, m.point1) + frame.x
            m.feature0 = turned_feature(m.feature0)
            m.feature1 = turned_feature(m.feature1)
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
