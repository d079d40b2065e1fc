"""Candidate pairs -> contact points with normals from A to B and stable keys, sorted by key."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.common import cross, kernel_module, rotate, rotate_back, scalar_types
from dc_kernels.model.enums import Flag, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

DISC = wp.constant(int(ShapeType.DISC))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))
SHIFT_A = wp.constant(wp.int64(KEY_SHAPE_BITS + KEY_FEATURE_BITS))
SHIFT_B = wp.constant(wp.int64(KEY_FEATURE_BITS))


@cache
def kernels(dtype: str, only_discs: bool) -> dict[str, Any]:
    """``narrowphase``; one thread a world.

    Args:
        dtype: "float32" or "float64".
        only_discs: whether all that moves are discs about their centre of mass; what they don't need is not compiled.
    """
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    shapes = manifold_functions(dtype, only_discs)
    Manifold, hull_size = shapes.Manifold, shapes.hull_size
    disc_disc, hull_disc, hull_hull = shapes.disc_disc, shapes.hull_disc, shapes.hull_hull

    # one native call instead of nine array stores, each of which would load pointer and stride anew
    # fmt: off
    @wp.func_native(
        "key.data[i] = key_; body_a.data[i] = body_a_; body_b.data[i] = body_b_; normal.data[i] = normal_;"
        "arm_a.data[i] = arm_a_; arm_b.data[i] = arm_b_; gap.data[i] = gap_; friction.data[i] = friction_;"
        "restitution.data[i] = restitution_;"
    )
    def store_contact(
        i: wp.int32,
        key: wp.array(dtype=wp.int64), body_a: wp.array(dtype=wp.int32), body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2), arm_a: wp.array(dtype=vec2), arm_b: wp.array(dtype=vec2),
        gap: wp.array(dtype=real), friction: wp.array(dtype=real), restitution: wp.array(dtype=real),
        key_: wp.int64, body_a_: wp.int32, body_b_: wp.int32, normal_: vec2, arm_a_: vec2, arm_b_: vec2,
        gap_: real, friction_: real, restitution_: real,
    ): ...
    # fmt: on

    @wp.kernel(module=module, enable_backward=False)
    def narrowphase(
        world_offset: int,
        slack_factor: real,
        uniform_friction: real,
        uniform_restitution: real,
        # Model:
        shape_start: wp.array(dtype=wp.int32),
        length_scale: wp.array(dtype=real),
        shape_body: wp.array(dtype=wp.int32),
        shape_type: wp.array(dtype=wp.int32),
        shape_radius: wp.array(dtype=real),
        shape_center: wp.array(dtype=vec2),
        shape_extent: wp.array(dtype=real),
        shape_friction: wp.array(dtype=real),
        shape_restitution: wp.array(dtype=real),
        vertex_start: wp.array(dtype=wp.int32),
        vertices: wp.array(dtype=vec2),
        vertex_normals: wp.array(dtype=vec2),
        # State in:
        position: wp.array(dtype=vec2),
        angle: wp.array(dtype=real),
        step_dt: wp.array(dtype=real),
        reach: wp.array(dtype=real),
        predicted: wp.array(dtype=vec4),
        # Pairs in:
        pair_start: wp.array(dtype=wp.int32),
        pair_count: wp.array(dtype=wp.int32),
        pair_a: wp.array(dtype=wp.int32),
        pair_b: wp.array(dtype=wp.int32),
        # State in, out:
        flags: wp.array(dtype=wp.int32),
        # Contacts out:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        contact_needed: wp.array(dtype=wp.int32),
        key: wp.array(dtype=wp.int64),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        gap: wp.array(dtype=real),
        friction: wp.array(dtype=real),
        restitution: wp.array(dtype=real),
    ):
        """Contacts of a world: gap below the speculative distance, or closing within the step."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        dt = step_dt[w]
        speculative = reach[w]
        slack = slack_factor * length_scale[w]
        shape0 = shape_start[w]
        start = contact_start[w]
        capacity = contact_start[w + 1] - start
        n = int(0)
        pairs = pair_start[w]
        for pair in range(pairs, pairs + pair_count[w]):
            a = pair_a[pair]
            b = pair_b[pair]
            ba = shape_body[a]
            bb = shape_body[b]
            xa = position[ba]
            xb = position[bb]
            va = predicted[ba]
            vb = predicted[bb]
            kind_a = shape_type[a]
            kind_b = shape_type[b]
            ra = shape_radius[a]
            rb = shape_radius[b]
            center_a = shape_center[a]
            center_b = shape_center[b]
            m = Manifold()
            if kind_a == DISC and kind_b == DISC:
                pa = xa
                pb = xb
                # nearly all candidates end here: too far apart even if they close at their full relative speed
                far = ra + rb + speculative + dt * (wp.abs(vb[0] - va[0]) + wp.abs(vb[1] - va[1]))
                if wp.static(not only_discs):
                    pa = xa + rotate(wp.cos(angle[ba]), wp.sin(angle[ba]), center_a)
                    pb = xb + rotate(wp.cos(angle[bb]), wp.sin(angle[bb]), center_b)
                    far += dt * (wp.abs(va[2]) * wp.length(center_a) + wp.abs(vb[2]) * wp.length(center_b))
                d = pb - pa
                if wp.dot(d, d) <= far * far:
                    m = disc_disc(pa, ra, pb, rb)
            elif kind_a == DISC:
                c = wp.cos(angle[bb])
                s = wp.sin(angle[bb])
                pa = xa + rotate(wp.cos(angle[ba]), wp.sin(angle[ba]), center_a)
                m = hull_disc(
                    vertex_start[b], hull_size(b, kind_b, vertex_start), kind_b == SEGMENT, rb, vertices,
                    vertex_normals, rotate_back(c, s, pa - xb), ra,
                )  # fmt: skip
                m.normal = -rotate(c, s, m.normal)
                m.point0 = rotate(c, s, m.point0) + xb
            elif kind_b == DISC:
                c = wp.cos(angle[ba])
                s = wp.sin(angle[ba])
                pb = xb + rotate(wp.cos(angle[bb]), wp.sin(angle[bb]), center_b)
                m = hull_disc(
                    vertex_start[a], hull_size(a, kind_a, vertex_start), kind_a == SEGMENT, ra, vertices,
                    vertex_normals, rotate_back(c, s, pb - xa), rb,
                )  # fmt: skip
                m.normal = rotate(c, s, m.normal)
                m.point0 = rotate(c, s, m.point0) + xa
            else:
                if wp.static(not only_discs):
                    ca = wp.cos(angle[ba])
                    sa = wp.sin(angle[ba])
                    cb = wp.cos(angle[bb])
                    sb = wp.sin(angle[bb])
                    c = ca * cb + sa * sb
                    s = ca * sb - sa * cb
                    dv = vec2(vb[0] - va[0], vb[1] - va[1])
                    arms_a = wp.abs(va[2]) * (wp.length(center_a) + shape_extent[a])
                    arms_b = wp.abs(vb[2]) * (wp.length(center_b) + shape_extent[b])
                    within = speculative + dt * (wp.length(dv) + arms_a + arms_b)
                    m = hull_hull(
                        vertex_start[a], hull_size(a, kind_a, vertex_start), kind_a == SEGMENT, ra,
                        vertex_start[b], hull_size(b, kind_b, vertex_start), rb,
                        c, s, rotate_back(ca, sa, xb - xa), within, slack, vertices, vertex_normals,
                    )  # fmt: skip
                    m.normal = rotate(ca, sa, m.normal)
                    m.point0 = rotate(ca, sa, m.point0) + xa
                    m.point1 = rotate(ca, sa, m.point1) + xa
            # the lower feature first, so that contacts are sorted by key
            swap = int(0)
            if m.count == 2 and m.feature1 < m.feature0:
                swap = 1
            for i in range(m.count):
                p = m.point0
                g = m.gap0
                feature = m.feature0
                if (i ^ swap) == 1:
                    p = m.point1
                    g = m.gap1
                    feature = m.feature1
                to_a = p - xa
                to_b = p - xb
                speed = m.normal[0] * (vb[0] - va[0]) + m.normal[1] * (vb[1] - va[1])
                if wp.static(not only_discs):
                    speed += cross(to_b, m.normal) * vb[2] - cross(to_a, m.normal) * va[2]
                # a gap that the step's motion closes is a contact too
                if g <= speculative + wp.max(-speed * dt, real(0.0)):
                    if n < capacity:
                        # a scene of one material need not look it up
                        mu = uniform_friction
                        e = uniform_restitution
                        if mu < real(0.0):
                            mu = shape_friction[a]
                            if shape_friction[b] != mu:
                                mu = wp.sqrt(mu * shape_friction[b])
                        if e < real(0.0):
                            e = wp.max(shape_restitution[a], shape_restitution[b])
                        store_contact(
                            start + n, key, body_a, body_b, normal, arm_a, arm_b, gap, friction, restitution,
                            (wp.int64(a - shape0) << SHIFT_A) | (wp.int64(b - shape0) << SHIFT_B) | wp.int64(feature),
                            ba, bb, m.normal, to_a, to_b, g, mu, e,
                        )  # fmt: skip
                    n += 1
        contact_needed[w] = n
        if n > capacity:
            flags[w] = flags[w] | CONTACT_OVERFLOW
            contact_count[w] = 0
            return
        contact_count[w] = n

    return {"narrowphase": narrowphase}
