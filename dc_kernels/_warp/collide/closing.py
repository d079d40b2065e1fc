"""Where two shapes will meet: their manifold at the time at which the motion of the step closes the gap.

A separating axis at the beginning of a step may not be the one along which the shapes come to touch: what slides over
a row of flush tiles is apart from the next tile along the way, and touches it from above. Of the axes that part two
shapes the motion closes one after the other, and they meet along the one that it closes last (conservative
advancement in the space of configurations, Mirtich 1996); two corners, of which none is closed, are nearest where the
line of motion passes. An overlap up to ``overlap`` counts as open: what touches a face within it slides on.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.shapes import MAX_VERTICES

FAST = wp.constant(0.1)  # way in a step over the distance of two discs, below which an arc is its tangent to 0.5 %
HORIZON = 1.25  # steps to look ahead: what forces accelerate closes before its velocity says


@cache
def closing_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """``hull_disc_moving`` and ``hull_hull_moving``: manifolds of shapes that move against each other.

    Both take an ``Approach`` in the frame of the first shape, and return the manifold of now, unless the shapes will
    meet elsewhere: then normal, feature and point are those at that time, and the gap is that of now along this normal.
    """
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    shapes = manifold_functions(dtype, only_discs)
    Hull, Frame, Manifold = shapes.Hull, shapes.Frame, shapes.Manifold
    disc_disc, hull_disc, hull_hull, frame_of = shapes.disc_disc, shapes.hull_disc, shapes.hull_hull, shapes.frame_of

    class ApproachFields:
        """How the second shape moves against the first: velocity, before the step's forces, of its centre.

        ``share``: the part of the motion that is the second body's [1]; ``slack`` and ``overlap`` [m]: a motion in the
        step that is none, and an overlap that is open.
        """

        velocity: vec2
        share: real
        dt: real
        slack: real
        overlap: real

    Approach = wp.struct(ApproachFields, module=module)

    @wp.func(module=module)
    def disc_disc_moving(pa: vec2, ra: real, pb: vec2, rb: real, w: vec2, dt: real, slop: real):
        """Two discs, of which B moves by w; where they pass each other the gap is what w may close of it.

        Normal and point stay those of now, as the impulse of a pair has to pass both centres; what passes by is
        farther from the other disc at the end of the step than the normal says, by the sagitta of the arc.
        """
        m = disc_disc(pa, ra, pb, rb)
        d = pb - pa
        closing = -wp.dot(m.normal, w) * dt
        radii = ra + rb
        if m.gap0 > slop and m.gap0 < closing and wp.length(w) * dt > real(FAST) * radii:
            nearest = d - w * (wp.dot(d, w) / wp.dot(w, w))
            if wp.dot(nearest, nearest) >= radii * radii:
                m.gap0 = wp.max(wp.length(d + w * dt) - radii + closing, m.gap0)
        return m

    @wp.func(module=module)
    def later_of(time: real, gap: real, speed: real, overlap: real, horizon: real):
        """The time at which the motion closes an axis, if it does within the horizon and after ``time``, else that."""
        if gap >= -overlap and speed < real(0.0) and gap + overlap <= -speed * horizon:
            return wp.max(time, (gap + overlap) / -speed)
        return time

    @wp.func(module=module)
    def corner_time(time: real, d: vec2, w: vec2, radius: real, within: real, touching: wp.bool, horizon: real):
        """When two corners, ``d`` apart at ``time``, are at ``radius`` from each other, or nearest if never.

        What touches already, or is ``within`` of the corner at the horizon, looks beyond it: it rolls or slides over
        the corner, however slowly, and a normal from just before would be a slope that it climbs.
        """
        squared = wp.dot(w, w)
        nearest = -wp.dot(d, w) / squared
        at = d + w * nearest
        miss = wp.dot(at, at)
        if radius > real(0.0) and miss < radius * radius:
            nearest = nearest - wp.sqrt((radius * radius - miss) / squared)
        when = wp.max(time + nearest, real(0.0))
        if when > horizon and not touching:
            at = d + w * (horizon - time)
            if wp.dot(at, at) > within * within:
                when = horizon
        return when

    @wp.func(module=module)
    def hull_disc_moving(
        hull: Hull,
        p: vec2,
        r: real,
        approach: Approach,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """Hull against a disc at p that moves; the point is the disc's, so that the normal passes its centre."""
        w = approach.velocity
        dt = approach.dt
        slack = approach.slack
        overlap = approach.overlap
        m = hull_disc(hull, p, r, vertices, vertex_normals)
        if m.count == 0 or wp.dot(w, w) * dt * dt <= slack * slack:
            return m
        radii = hull.radius + r
        horizon = real(HORIZON) * dt
        time = real(0.0)
        open = int(0)
        for i in range(hull.first, hull.first + hull.count):
            gap = wp.dot(vertex_normals[i], p - vertices[i]) - radii
            if gap >= -overlap:
                open += 1
            time = later_of(time, gap, wp.dot(vertex_normals[i], w), overlap, horizon)
        m.beside = m.corner or open > 1
        if time == real(0.0) and not m.corner:
            return m
        later = hull_disc(hull, p + w * time, r, vertices, vertex_normals)
        if later.count > 0 and later.corner:
            apart = later.normal * (later.gap0 + radii)
            time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.gap0 <= overlap, horizon)
            later = hull_disc(hull, p + w * time, r, vertices, vertex_normals)
        if later.count == 0 or (later.normal[0] == m.normal[0] and later.normal[1] == m.normal[1]):
            return m
        gap = later.gap0 - wp.dot(later.normal, w) * time
        if gap < -overlap - slack:
            return m
        later.point0 = p - later.normal * (r + real(0.5) * gap)
        later.gap0 = gap
        later.beside = True
        return later

    @wp.func_native(native_code("prelude.h", "collide/hull.h", "collide/closing.h", dtype=dtype, LANES=MAX_VERTICES))
    def closing_time(
        a: Hull,
        b: Hull,
        frame: Frame,
        velocity: vec2,
        overlap: real,
        horizon: real,
        vertices: wp.array(dtype=vec2),
        normals: wp.array(dtype=vec2),
    ) -> real: ...

    @wp.func(module=module)
    def hull_hull_moving(
        a: Hull,
        b: Hull,
        frame: Frame,
        m: Manifold,
        approach: Approach,
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
    ):
        """Two hulls in the frame of A, of which B moves; ``m`` is their manifold of now, beside another axis."""
        w = approach.velocity
        dt = approach.dt
        slack = approach.slack
        overlap = approach.overlap
        if wp.dot(w, w) * dt * dt <= slack * slack:
            return m
        c = frame.c
        s = frame.s
        radii = a.radius + b.radius
        horizon = real(HORIZON) * dt
        time = closing_time(a, b, frame, w, overlap, horizon, vertices, vertex_normals)
        if time == real(0.0) and not m.corner:
            return m
        far = real(1e30)
        moved = frame_of(c, s, frame.x + w * time)
        later = hull_hull(a, b, moved, far, slack, overlap, vertices, vertex_normals)
        if later.count > 0 and later.corner:
            apart = later.normal * (later.gap0 + radii)
            time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.gap0 <= overlap, horizon)
            moved = frame_of(c, s, frame.x + w * time)
            later = hull_hull(a, b, moved, far, slack, overlap, vertices, vertex_normals)
        shift = wp.dot(later.normal, w) * time
        later.gap0 = later.gap0 - shift
        later.gap1 = later.gap1 - shift
        if later.count == 0 or later.gap0 < -overlap - slack or (later.count == 2 and later.gap1 < -overlap - slack):
            return m
        later.beside = True
        back = (w * time - later.normal * shift) * approach.share + later.normal * (real(0.5) * shift)
        later.point0 = later.point0 - back
        later.point1 = later.point1 - back
        return later

    return SimpleNamespace(
        Approach=Approach,
        disc_disc_moving=disc_disc_moving,
        hull_disc_moving=hull_disc_moving,
        hull_hull_moving=hull_hull_moving,
    )
