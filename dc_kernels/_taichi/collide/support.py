"""What the static shapes that a shape comes to first leave of its motion, before it is asked where it meets others.

What falls onto a row of flush tiles while it slides along them would, by its velocity, dive below the top of the tile
under it and meet the next one from the side. Where the tile under it stops it, it never comes to that side (Jolt's
internal edge removal goes by contacts of one body alike; Catto, Ghost collisions, 2020).
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.collide.manifold import manifold_functions
from dc_kernels._taichi.common import dot, length, rotate, rotate_back
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.enums import BodyType, ShapeType

DISC = int(ShapeType.DISC)
STATIC = int(BodyType.STATIC)


@cache
def support_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """``closes``, ``list_static``, ``supported``: whether to ask, what is under a shape, what motion it leaves."""
    t = group_types(dtype)
    real = t.real
    shapes = manifold_functions(dtype)
    Manifold, hull_of, frame_of = shapes.Manifold, shapes.hull_of, shapes.frame_of
    hull_disc, hull_hull = shapes.hull_disc, shapes.hull_hull

    @ti.func
    def least_gap(m):
        gap = m.gap0
        if m.count == 2:
            gap = ti.min(gap, m.gap1)
        return gap

    @ti.func
    def closes(m, velocity, dt, slack):
        """Whether a manifold that another axis could replace is in the way of the motion, and within its reach."""
        closing = -dot(m.normal, velocity) * dt
        return m.count > 0 and m.beside != 0 and closing > slack and length(velocity) * dt > least_gap(m)

    @ti.func
    def list_static(w, model: t.Model, pairs: t.Pairs):
        """Chain the pairs of each shape of a world with static hulls, from ``sorted_shape`` on by ``temp_a``.

        Both are scratch of the search for pairs, which is over; -1 is the end.
        """
        for shape in range(model.shape_start[w], model.shape_start[w + 1]):
            pairs.sorted_shape[shape] = -1
        for pair in range(pairs.start[w], pairs.start[w] + pairs.count[w]):
            a = pairs.shape_a[pair]
            if model.shape_type[a] != DISC and model.body_type[model.shape_body[a]] == STATIC:
                b = pairs.shape_b[pair]
                pairs.temp_a[pair] = pairs.sorted_shape[b]
                pairs.sorted_shape[b] = pair

    @ti.func
    def supported(pair, velocity, toward, model: t.Model, state: t.State, pairs: t.Pairs):
        """What is left of the velocity of a pair's second shape where static shapes of its other pairs stop it.

        Those do that one axis alone parts from it, so that they can be met along this axis only.
        """
        dt = toward.dt
        b = pairs.shape_b[pair]
        body = model.shape_body[b]
        kind = model.shape_type[b]
        radius = model.shape_radius[b]
        cb = ti.cos(state.angle[body])
        sb = ti.sin(state.angle[body])
        left = velocity
        other = pairs.sorted_shape[b]
        while other >= 0:
            if other != pair:
                a = pairs.shape_a[other]
                ba = model.shape_body[a]
                ca = ti.cos(state.angle[ba])
                sa = ti.sin(state.angle[ba])
                hull = hull_of(a, model.shape_type[a], model.shape_radius[a], model)
                offset = rotate_back(ca, sa, state.position[body] - state.position[ba])
                m = Manifold()
                if kind == DISC:
                    center = rotate_back(ca, sa, rotate(cb, sb, model.shape_center[b]))
                    m = hull_disc(hull, offset + center, radius, model)
                    m.beside = m.corner
                else:
                    if ti.static(not only_discs):
                        mine = hull_of(b, kind, radius, model)
                        frame = frame_of(ca * cb + sa * sb, ca * sb - sa * cb, offset)
                        m = hull_hull(hull, mine, frame, length(velocity) * dt, toward.slack, toward.overlap, model)
                gap = ti.max(least_gap(m), real(0.0))
                normal = rotate(ca, sa, m.normal)
                closing = -dot(normal, left) * dt
                if m.count > 0 and m.beside == 0 and closing > gap + toward.slack:
                    left = left + normal * ((closing - gap) / dt)
            other = pairs.temp_a[other]
        return left

    return SimpleNamespace(closes=closes, list_static=list_static, supported=supported)
