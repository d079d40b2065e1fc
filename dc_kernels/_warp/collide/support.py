"""What the static shapes that a shape comes to first leave of its motion, before it is asked where it meets others.

What falls onto a row of flush tiles while it slides along them would, by its velocity, dive below the top of the tile
under it and meet the next one from the side. Where the tile under it stops it, it never comes to that side (Jolt's
internal edge removal goes by contacts of one body alike; Catto, Ghost collisions, 2020).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.common import kernel_module, rotate, rotate_back
from dc_kernels._warp.groups import group_types
from dc_kernels.model.enums import BodyType, ShapeType

DISC = wp.constant(int(ShapeType.DISC))
STATIC = wp.constant(int(BodyType.STATIC))


@cache
def support_functions(dtype: str, only_discs: bool) -> SimpleNamespace:
    """``closes``, ``list_static``, ``supported``: whether to ask, what is under a shape, what motion it leaves."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    shapes = manifold_functions(dtype, only_discs)
    Manifold, hull_of, frame_of = shapes.Manifold, shapes.hull_of, shapes.frame_of
    hull_disc, hull_hull = shapes.hull_disc, shapes.hull_hull

    @wp.func(module=module)
    def least_gap(m: Manifold):
        gap = m.gap0
        if m.count == 2:
            gap = wp.min(gap, m.gap1)
        return gap

    @wp.func(module=module)
    def closes(m: Manifold, velocity: vec2, dt: real, slack: real):
        """Whether a manifold that another axis could replace is in the way of the motion, and within its reach."""
        closing = -wp.dot(m.normal, velocity) * dt
        return m.count > 0 and m.beside and closing > slack and wp.length(velocity) * dt > least_gap(m)

    @wp.func(module=module)
    def list_static(w: int, model: t.Model, pairs: t.Pairs):
        """Chain the pairs of each shape of a world with static hulls, from ``sorted_shape`` on by ``temp_a``.

        Both are scratch of the search for pairs, which is over; -1 is the end.
        """
        for shape in range(model.shape_start[w], model.shape_start[w + 1]):
            pairs.sorted_shape[shape] = -1
        last = int(-1)  # pairs are sorted by their first shape
        still = bool(False)
        for pair in range(pairs.start[w], pairs.start[w] + pairs.count[w]):
            a = pairs.shape_a[pair]
            if a != last:
                last = a
                still = model.shape_type[a] != DISC and model.body_type[model.shape_body[a]] == STATIC
            if still:
                b = pairs.shape_b[pair]
                pairs.temp_a[pair] = pairs.sorted_shape[b]
                pairs.sorted_shape[b] = pair

    @wp.func(module=module)
    def supported(
        pair: int,
        velocity: vec2,
        dt: real,
        slack: real,
        overlap: real,
        model: t.Model,
        state: t.State,
        pairs: t.Pairs,
    ):
        """What is left of the velocity of a pair's second shape where static shapes of its other pairs stop it.

        Those do that one axis alone parts from it, so that they can be met along this axis only.
        """
        b = pairs.shape_b[pair]
        body = model.shape_body[b]
        kind = model.shape_type[b]
        radius = model.shape_radius[b]
        xb = state.position[body]
        cb = wp.cos(state.angle[body])
        sb = wp.sin(state.angle[body])
        left = velocity
        other = pairs.sorted_shape[b]
        while other >= 0:
            if other != pair:
                a = pairs.shape_a[other]
                ba = model.shape_body[a]
                ca = wp.cos(state.angle[ba])
                sa = wp.sin(state.angle[ba])
                hull = hull_of(a, model.shape_type[a], model.shape_radius[a], model.vertex_start)
                offset = rotate_back(ca, sa, xb - state.position[ba])
                m = Manifold()
                if kind == DISC:
                    center = rotate_back(ca, sa, rotate(cb, sb, model.shape_center[b]))
                    m = hull_disc(hull, offset + center, radius, model.vertices, model.vertex_normals)
                    m.beside = m.corner
                else:
                    if wp.static(not only_discs):
                        mine = hull_of(b, kind, radius, model.vertex_start)
                        frame = frame_of(ca * cb + sa * sb, ca * sb - sa * cb, offset)
                        far = wp.length(velocity) * dt
                        m = hull_hull(hull, mine, frame, far, slack, overlap, model.vertices, model.vertex_normals)
                gap = wp.max(least_gap(m), real(0.0))
                normal = rotate(ca, sa, m.normal)
                closing = -wp.dot(normal, left) * dt
                if m.count > 0 and not m.beside and closing > gap + slack:
                    left = left + normal * ((closing - gap) / dt)
            other = pairs.temp_a[other]
        return left

    return SimpleNamespace(closes=closes, list_static=list_static, supported=supported)
