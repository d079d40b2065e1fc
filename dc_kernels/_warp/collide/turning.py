"""When two shapes meet that turn against each other, and how: their manifold at the time of impact.

What turns by much in a step sweeps arcs, which its velocity now does not tell. Its motion is followed by conservative
advancement (Mirtich 1996; Coumans, Continuous collision detection, 2005): along the normal of the least distance no
point comes nearer than by its body's velocity and the body's spin times its farthest distance from the centre, so that
time may advance by the distance over the sum of these.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.common import cross, kernel_module, rotate, rotate_back
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.laws import relative_speed

ADVANCES = wp.constant(128)  # of the time in a step; what has not met by then is left to the next step
NEAR = wp.constant(0.5)  # of the overlap that is open: distance that counts as none


@cache
def turning_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """``Path``, ``distance_at`` and ``hulls_turning``: how two shapes move, how far apart they are, where they meet."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    shapes = manifold_functions(dtype, only_discs)
    Hull, Manifold, frame_of = shapes.Hull, shapes.Manifold, shapes.frame_of
    hull_disc, hull_hull = shapes.hull_disc, shapes.hull_hull

    class PathFields:
        """How a hull A and a shape B move: place and angle of their bodies, velocity and spin.

        ``round``: B is a disc about ``center`` of its body; ``size``: the farthest point of either from the centre of
        its body [m]; ``slack`` and ``overlap`` [m]: see ``closing.Approach``.
        """

        xa: vec2
        xb: vec2
        angle_a: real
        angle_b: real
        va: vec4
        vb: vec4
        round: wp.bool
        center: vec2
        size_a: real
        size_b: real
        dt: real
        slack: real
        overlap: real

    Path = wp.struct(PathFields, module=module)

    @wp.func(module=module)
    def manifold_at(
        a: Hull,
        b: Hull,
        path: Path,
        time: real,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """The manifold at a time, in world axes; its points are measured from the centre of A's body then."""
        turn_a = path.angle_a + path.va[2] * time
        turn_b = path.angle_b + path.vb[2] * time
        ca = wp.cos(turn_a)
        sa = wp.sin(turn_a)
        cb = wp.cos(turn_b)
        sb = wp.sin(turn_b)
        offset = path.xb - path.xa + vec2(path.vb[0] - path.va[0], path.vb[1] - path.va[1]) * time
        m = Manifold()
        if path.round:
            local = rotate_back(ca, sa, offset + rotate(cb, sb, path.center))
            m = hull_disc(a, local, b.radius, vertices, vertex_normals)
        else:
            if wp.static(not only_discs):
                frame = frame_of(ca * cb + sa * sb, ca * sb - sa * cb, rotate_back(ca, sa, offset))
                m = hull_hull(a, b, frame, real(1e30), path.slack, path.overlap, vertices, vertex_normals)
        m.normal = rotate(ca, sa, m.normal)
        m.point0 = rotate(ca, sa, m.point0)
        m.point1 = rotate(ca, sa, m.point1)
        m.moved = offset - (path.xb - path.xa)
        return m

    @wp.func(module=module)
    def least_gap(m: Manifold):
        gap = m.gap0
        if m.count == 2:
            gap = wp.min(gap, m.gap1)
        return gap

    @wp.func(module=module)
    def speed_at(m: Manifold, point: vec2, path: Path):
        """Relative speed along the normal where the shapes meet; negative where they close."""
        to_b = point - (path.xb - path.xa) - m.moved
        return relative_speed(m.normal, path.va, path.vb, cross(point, m.normal), cross(to_b, m.normal))

    @wp.func(module=module)
    def hulls_turning(
        a: Hull,
        b: Hull,
        path: Path,
        now: Manifold,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """A hull and another shape that are apart, at the time at which they meet; ``now`` is their manifold, as is.

        Normal, features and arms are those of that time, and a gap is what the step's velocities close until then at
        the speed of its point. Where they do not meet in the step, the gaps of now are such that none closes.
        """
        near = real(NEAR) * path.overlap
        m = Manifold()
        time = real(0.0)
        rounds = int(0)
        meets = bool(False)
        while rounds < ADVANCES and time < path.dt and not meets:
            m = manifold_at(a, b, path, time, vertices, vertex_normals)
            if m.count == 0:
                rounds = ADVANCES
            else:
                gap = least_gap(m)
                if gap <= near:
                    meets = speed_at(m, m.point0, path) < real(0.0)
                    if m.count == 2 and (m.gap0 > near or not meets):
                        meets = m.gap1 <= near and speed_at(m, m.point1, path) < real(0.0)
                if not meets:
                    speed = -(m.normal[0] * (path.vb[0] - path.va[0]) + m.normal[1] * (path.vb[1] - path.va[1]))
                    speed += wp.abs(path.va[2]) * path.size_a + wp.abs(path.vb[2]) * path.size_b
                    rounds += 1
                    if speed <= real(0.0):
                        rounds = ADVANCES
                    else:
                        time += wp.max(gap - real(0.5) * near, real(0.5) * near) / speed
        if meets:
            m.gap0 = m.gap0 + wp.max(-speed_at(m, m.point0, path), real(0.0)) * time
            m.gap1 = m.gap1 + wp.max(-speed_at(m, m.point1, path), real(0.0)) * time
            m.point0 = m.point0 + path.xa
            m.point1 = m.point1 + path.xa
            return m
        m = now
        m.gap0 = wp.max(m.gap0, path.slack - speed_at(m, m.point0 - path.xa, path) * path.dt)
        m.gap1 = wp.max(m.gap1, path.slack - speed_at(m, m.point1 - path.xa, path) * path.dt)
        return m

    return SimpleNamespace(Path=Path, manifold_at=manifold_at, hulls_turning=hulls_turning)
