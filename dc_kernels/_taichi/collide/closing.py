"""Where two shapes will meet: their manifold at the time at which the motion of the step closes the gap.

A separating axis at the beginning of a step may not be the one along which the shapes come to touch: what slides over
a row of flush tiles is apart from the next tile along the way, and touches it from above. Of the axes that part two
shapes the motion closes one after the other, and they meet along the one that it closes last (conservative
advancement in the space of configurations, Mirtich 1996); two corners, of which none is closed, are nearest where the
line of motion passes. An overlap up to ``overlap`` counts as open: what touches a face within it slides on.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.collide.manifold import manifold_functions
from dc_kernels._taichi.common import dot, length, rotate
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti

FAST = 0.1  # way in a step over the distance of two discs, below which an arc is its tangent to 0.5 %
HORIZON = 1.25  # steps to look ahead: what forces accelerate closes before its velocity says
# the manifolds of a pair that moves: of now, at the time at which the last axis closes, and once more for corners
NOW = 0
CLOSED = 1
PASSED = 2
DONE = 3


@ti.func
def later_of(time, gap, speed, overlap, horizon):
    """The time at which the motion closes an axis, if it does within the horizon and after ``time``, else that."""
    found = time
    if gap >= -overlap and speed < 0.0 and gap + overlap <= -speed * horizon:
        found = ti.max(time, (gap + overlap) / -speed)
    return found


@ti.func
def corner_time(time, d, w, radius, within, touching, horizon):
    """When two corners, ``d`` apart at ``time``, are at ``radius`` from each other, or nearest if never.

    What touches already, or is ``within`` of the corner at the horizon, looks beyond it: it rolls or slides over the
    corner, however slowly, and a normal from just before would be a slope that it climbs.
    """
    squared = dot(w, w)
    nearest = -dot(d, w) / squared
    at = d + w * nearest
    miss = dot(at, at)
    if radius > 0.0 and miss < radius * radius:
        nearest = nearest - ti.sqrt((radius * radius - miss) / squared)
    when = ti.max(time + nearest, 0.0)
    if when > horizon and not touching:
        at = d + w * (horizon - time)
        if dot(at, at) > within * within:
            when = horizon
    return when


@cache
def closing_functions(dtype: str) -> SimpleNamespace:
    """``disc_disc_moving``, ``hull_disc_moving`` and ``hull_hull_moving``: manifolds of shapes that move.

    The latter take an ``Approach`` in the frame of the first shape, and return the manifold of now, unless the shapes
    will meet elsewhere: then normal, feature and point are those at that time, and the gap is that of now along this
    normal.
    """
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    shapes = manifold_functions(dtype)
    disc_disc, hull_disc, hull_hull, frame_of = shapes.disc_disc, shapes.hull_disc, shapes.hull_hull, shapes.frame_of

    # How the second shape moves against the first: velocity, before the step's forces, of its centre.
    # ``share``: the part of the motion that is the second body's [1]; ``slack`` and ``overlap`` [m]: a motion in the
    # step that is none, and an overlap that is open.
    Approach = ti.types.struct(velocity=vec2, share=real, dt=real, slack=real, overlap=real)

    @ti.func
    def disc_disc_moving(pa, ra, pb, rb, w, dt, slop):
        """Two discs, of which B moves by w; where they pass each other the gap is what w may close of it.

        Normal and point stay those of now, as the impulse of a pair has to pass both centres; what passes by is
        farther from the other disc at the end of the step than the normal says, by the sagitta of the arc.
        """
        m = disc_disc(pa, ra, pb, rb)
        d = pb - pa
        closing = -dot(m.normal, w) * dt
        radii = ra + rb
        if m.gap0 > slop and m.gap0 < closing and length(w) * dt > FAST * radii:
            nearest = d - w * (dot(d, w) / dot(w, w))
            if dot(nearest, nearest) >= radii * radii:
                m.gap0 = ti.max(length(d + w * dt) - radii + closing, m.gap0)
        return m

    @ti.func
    def moves(approach):
        """Whether the shapes move against each other in the step."""
        w = approach.velocity
        return dot(w, w) * approach.dt * approach.dt > approach.slack * approach.slack

    @ti.func
    def hull_disc_moving(hull, p, r, approach, model: t.Model):
        """Hull against a disc at p that moves; the point is the disc's, so that the normal passes its centre."""
        w = approach.velocity
        slack = approach.slack
        overlap = approach.overlap
        radii = hull.radius + r
        horizon = HORIZON * approach.dt
        m = shapes.Manifold()
        time = real(0.0)
        step = NOW
        while step < DONE:
            at = p
            if step != NOW:
                at = p + w * time
            later = hull_disc(hull, at, r, model)
            if step == NOW:
                m = later
                step = DONE
                if m.count > 0 and moves(approach):
                    parting = 0
                    for i in range(hull.first, hull.first + hull.count):
                        gap = dot(model.vertex_normals[i], p - model.vertices[i]) - radii
                        if gap >= -overlap:
                            parting += 1
                        time = later_of(time, gap, dot(model.vertex_normals[i], w), overlap, horizon)
                    m.beside = m.corner != 0 or parting > 1
                    if time != 0.0 or m.corner != 0:
                        step = CLOSED
            elif step == CLOSED and later.count > 0 and later.corner != 0:
                apart = later.normal * (later.gap0 + radii)
                time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.gap0 <= overlap, horizon)
                step = PASSED
            else:
                step = DONE
                if later.count > 0 and (later.normal[0] != m.normal[0] or later.normal[1] != m.normal[1]):
                    gap = later.gap0 - dot(later.normal, w) * time
                    if gap >= -overlap - slack:
                        m = later
                        m.point0 = p - later.normal * (r + 0.5 * gap)
                        m.gap0 = gap
                        m.beside = 1
        return m

    @ti.func
    def hull_hull_moving(a, b, frame, reach, approach, model: t.Model):
        """Two hulls in the frame of A, of which B moves, where they are within ``reach``."""
        w = approach.velocity
        slack = approach.slack
        overlap = approach.overlap
        c = frame.c
        s = frame.s
        radii = a.radius + b.radius
        horizon = HORIZON * approach.dt
        m = shapes.Manifold()
        time = real(0.0)
        within = reach
        moved = frame
        step = NOW
        while step < DONE:
            later = hull_hull(a, b, moved, within, slack, overlap, model)
            if step == NOW:
                m = later
                step = DONE
                if m.count > 0 and m.beside != 0 and moves(approach):
                    for i in range(a.first, a.first + a.count):
                        normal = model.vertex_normals[i]
                        gap = real(1e30)
                        for j in range(b.first, b.first + b.count):
                            at = rotate(c, s, model.vertices[j]) + frame.x
                            gap = ti.min(gap, dot(normal, at - model.vertices[i]))
                        time = later_of(time, gap - radii, dot(normal, w), overlap, horizon)
                    for j in range(b.first, b.first + b.count):
                        normal = rotate(c, s, model.vertex_normals[j])
                        at = rotate(c, s, model.vertices[j]) + frame.x
                        gap = real(1e30)
                        for i in range(a.first, a.first + a.count):
                            gap = ti.min(gap, dot(normal, model.vertices[i] - at))
                        time = later_of(time, gap - radii, -dot(normal, w), overlap, horizon)
                    if time != 0.0 or m.corner != 0:
                        step = CLOSED
            elif step == CLOSED and later.count > 0 and later.corner != 0:
                apart = later.normal * (later.gap0 + radii)
                time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.gap0 <= overlap, horizon)
                step = PASSED
            else:
                step = DONE
                shift = dot(later.normal, w) * time
                gap0 = later.gap0 - shift
                gap1 = later.gap1 - shift
                if later.count > 0 and gap0 >= -overlap - slack and (later.count == 1 or gap1 >= -overlap - slack):
                    back = (w * time - later.normal * shift) * approach.share + later.normal * (0.5 * shift)
                    m = later
                    m.beside = 1
                    m.gap0 = gap0
                    m.gap1 = gap1
                    m.point0 = later.point0 - back
                    m.point1 = later.point1 - back
            within = 1e30
            moved = frame_of(c, s, frame.x + w * time)
        return m

    return SimpleNamespace(
        Approach=Approach,
        disc_disc_moving=disc_disc_moving,
        hull_disc_moving=hull_disc_moving,
        hull_hull_moving=hull_hull_moving,
    )
