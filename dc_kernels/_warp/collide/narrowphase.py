"""Candidate pairs -> contact points with normals from A to B and stable keys, sorted by key."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.closing import HORIZON, closing_functions
from dc_kernels._warp.collide.discs import disc_contacts
from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.collide.recycle import recycling
from dc_kernels._warp.collide.support import support_functions
from dc_kernels._warp.common import cross, from_start, kernel_module, rotate, rotate_back
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.lanes import has_lanes
from dc_kernels._warp.solve.laws import inverse_or_zero, linear_speed, relative_speed
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

DISC = wp.constant(int(ShapeType.DISC))
POLYGON = wp.constant(int(ShapeType.POLYGON))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
STATIC = wp.constant(int(BodyType.STATIC))
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))
INVALID = wp.constant(int(Flag.INVALID))
SHIFT_A = wp.constant(wp.int64(KEY_SHAPE_BITS + KEY_FEATURE_BITS))
SLOPS = wp.constant(2.0)  # overlap up to which shapes touch: what rests a slop deep meets a tile a slop higher
SHIFT_B = wp.constant(wp.int64(KEY_FEATURE_BITS))
AHEAD = 8  # pairs


@cache
def kernels(dtype: str, only_discs: bool) -> dict[str, Any]:
    """``narrowphase``; one thread a world.

    Args:
        dtype: "float32" or "float64".
        only_discs: whether all that moves are discs about their centre of mass; what they don't need is not compiled.
    """
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    Contact = t.Contact
    module = kernel_module("narrowphase", dtype, "discs" if only_discs else "all")
    contiguous = contiguous_groups(dtype)
    shapes = manifold_functions(dtype, only_discs)
    Manifold, hull_of, frame_of = shapes.Manifold, shapes.hull_of, shapes.frame_of
    hull_hull = shapes.hull_hull
    moving = closing_functions(dtype, only_discs)
    disc_disc_moving, hull_disc_moving = moving.disc_disc_moving, moving.hull_disc_moving
    hull_hull_moving, Approach = moving.hull_hull_moving, moving.Approach
    support = support_functions(dtype, only_discs)
    closes, list_static, supported = support.closes, support.list_static, support.supported

    find_disc_contacts, share_disc_contacts = disc_contacts(dtype)
    again = recycling(dtype)
    carry, meet_again, take_met = again.carry, again.meet_again, again.take_met
    keeps, keep = again.keeps, again.keep
    meet_discs, Lengths = again.meet_discs, again.Lengths
    endless = real(1e30)

    @wp.func_native(native_code("collide/store_contact.h", dtype=dtype))
    def store_contact(contacts: t.Contacts, i: wp.int32, contact: Contact): ...

    @wp.func_native(native_code("collide/look_ahead.h", dtype=dtype, AHEAD=AHEAD))
    def look_ahead(i: wp.int32, end: wp.int32, model: t.Model, state: t.State, motion: t.Motion, pairs: t.Pairs): ...

    @wp.func(module=module)
    def magnitude(v: vec2):
        """Bound on the length of a vector."""
        return wp.abs(v[0]) + wp.abs(v[1])

    @wp.func(module=module)
    def center_at(x: vec2, angle: real, center: vec2):
        """Where a point of a body is."""
        if center[0] == real(0.0) and center[1] == real(0.0):
            return x
        return x + rotate(wp.cos(angle), wp.sin(angle), center)

    @wp.func(module=module)
    def velocity_at(ba: int, bb: int, arm_a: vec2, arm_b: vec2, state: t.State):
        """Velocity of a point of B against one of A, before the step's forces: what rests does not fall."""
        turning = vec2(-arm_b[1], arm_b[0]) * state.angular_velocity[bb]
        turning -= vec2(-arm_a[1], arm_a[0]) * state.angular_velocity[ba]
        return state.velocity[bb] - state.velocity[ba] + turning

    @wp.kernel(module=module, enable_backward=False)
    def narrowphase(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Contacts of a world: gap below the speculative distance, or closing within the step."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(pairs)
        contiguous(contacts)
        contiguous(rows)
        if state.flags[w] != 0:
            return
        dt = motion.step_dt[w]
        speculative = motion.reach[w]
        slop = config.slop * model.length_scale[w]
        slack = config.slack * model.length_scale[w]
        toward = Approach()
        toward.dt = dt
        toward.slack = slack
        toward.overlap = real(SLOPS) * slop
        shape0 = model.shape_start[w]
        start = contacts.contact_start[w]
        capacity = contacts.contact_start[w + 1] - start
        n = int(0)
        listed = int(0)
        turned = int(-1)  # the body of cosine ca and sine sa: pairs of one first shape follow each other
        ca = real(1.0)
        sa = real(0.0)
        first_pair = pairs.start[w]
        last_pair = first_pair + pairs.count[w]
        pair = first_pair - 1
        recycles = int(0)
        first_met = first_pair
        scratch = launch.scratch
        looked = first_pair
        if wp.static(not only_discs):
            if has_lanes() == 1 and pairs.kept_frame.shape[0] > 0 and scratch != wp.uint64(0):
                recycles = 1
                if pairs.kept_rebuilds[w] != pairs.rebuilds[w]:
                    carry(w, pairs)
        while pair + 1 < last_pair:
            pair += 1
            if wp.static(not only_discs):
                if recycles == 1:
                    if pair == looked:
                        first_met = pair
                        ends = wp.vec2i(pair, last_pair)
                        lengths = Lengths(slack, toward.overlap, speculative)
                        looked = meet_again(w, ends, lengths, model, state, motion, pairs, scratch)
                        ends = wp.vec2i(pair, looked)
                        meet_discs(w, ends, lengths, model, state, motion, pairs, scratch)
                    span = wp.vec3i(first_met, pair, looked)
                    ahead = take_met(w, span, n, config, model, pairs, contacts, scratch)
                    pair = ahead[0]
                    n = ahead[1]
                    if pair == looked:
                        pair -= 1
                        continue
            if wp.static(only_discs):
                # asked here, as a shared run copies all that it captures, even where it ends at once
                of_discs = (
                    model.shape_type[pairs.shape_a[pair]] == DISC and model.shape_type[pairs.shape_b[pair]] == DISC
                )
                if has_lanes() == 1 and of_discs:
                    ahead = wp.vec2i(0, 0)
                    if launch.team == wp.uint64(0):
                        ahead = find_disc_contacts(w, pair, last_pair, n, config, model, state, motion, pairs, contacts)
                    else:
                        ends = wp.vec2i(pair, last_pair)
                        ahead = share_disc_contacts(
                            w, ends, n, config, model, state, motion, pairs, contacts, launch.team
                        )
                    pair = ahead[0]
                    n = ahead[1]
                    if pair == last_pair:
                        break
                if launch.team != wp.uint64(0):
                    look_ahead(pair, last_pair, model, state, motion, pairs)
            a = from_start(pairs.shape_a[from_start(pair)])
            b = from_start(pairs.shape_b[from_start(pair)])
            ba = from_start(model.shape_body[a])
            bb = from_start(model.shape_body[b])
            xa = state.position[ba]
            xb = state.position[bb]
            va = motion.predicted[ba]
            vb = motion.predicted[bb]
            if wp.min(va[3], vb[3]) < real(0.0) and wp.max(va[3], vb[3]) <= real(0.0):
                continue  # asleep, both or beside what does not move (sleep/wake.py)
            kind_a = model.shape_type[a]
            kind_b = model.shape_type[b]
            ra = model.shape_radius[a]
            rb = model.shape_radius[b]
            center_a = model.shape_center[a]
            center_b = model.shape_center[b]
            if wp.static(not only_discs):
                # nearly all candidates end here: too far apart even if they close at their full relative speed
                d = xb - xa
                bound_a = magnitude(center_a) + model.shape_extent[a]
                bound_b = magnitude(center_b) + model.shape_extent[b]
                way = wp.abs(vb[0] - va[0]) + wp.abs(vb[1] - va[1]) + wp.abs(va[2]) * bound_a + wp.abs(vb[2]) * bound_b
                if (kind_a == DISC) != (kind_b == DISC):
                    # a disc and a hull look ahead by the velocities before the forces, there and back; the disc's
                    # centre is a point of both bodies
                    spin = wp.abs(state.angular_velocity[ba]) + wp.abs(state.angular_velocity[bb])
                    passing = magnitude(state.velocity[bb] - state.velocity[ba])
                    way += real(2.0 * HORIZON) * (passing + spin * (magnitude(d) + bound_a + bound_b))
                far = bound_a + bound_b + speculative + dt * way
                if wp.dot(d, d) > far * far:
                    continue
            m = Manifold()
            if kind_a == DISC and kind_b == DISC:
                pa = xa
                pb = xb
                # nearly all candidates end here: too far apart even if they close at their full relative speed
                far = ra + rb + speculative + dt * (wp.abs(vb[0] - va[0]) + wp.abs(vb[1] - va[1]))
                if wp.static(not only_discs):
                    pa = center_at(xa, state.angle[ba], center_a)
                    pb = center_at(xb, state.angle[bb], center_b)
                    far += dt * (wp.abs(va[2]) * wp.length(center_a) + wp.abs(vb[2]) * wp.length(center_b))
                d = pb - pa
                if wp.dot(d, d) > far * far:
                    continue
                dv = vec2(vb[0] - va[0], vb[1] - va[1])
                if wp.static(not only_discs):
                    to_a = pa - xa
                    to_b = pb - xb
                    dv += vec2(-to_b[1], to_b[0]) * vb[2] - vec2(-to_a[1], to_a[0]) * va[2]
                m = disc_disc_moving(pa, ra, pb, rb, dv, dt, slop)
            elif kind_a == DISC:
                c = wp.cos(state.angle[bb])
                s = wp.sin(state.angle[bb])
                pa = center_at(xa, state.angle[ba], center_a)
                hull = hull_of(b, kind_b, rb, model.vertex_start)
                toward.velocity = rotate_back(c, s, velocity_at(bb, ba, pa - xb, pa - xa, state))
                local = rotate_back(c, s, pa - xb)
                m = hull_disc_moving(hull, local, ra, toward, model.vertices, model.vertex_normals)
                m.normal = -rotate(c, s, m.normal)
                m.point0 = rotate(c, s, m.point0) + xb
            elif kind_b == DISC:
                if ba != turned:
                    turned = ba
                    ca = wp.cos(state.angle[ba])
                    sa = wp.sin(state.angle[ba])
                c = ca
                s = sa
                pb = center_at(xb, state.angle[bb], center_b)
                hull = hull_of(a, kind_a, ra, model.vertex_start)
                drift = velocity_at(ba, bb, pb - xa, pb - xb, state)
                local = rotate_back(c, s, pb - xa)
                asked = model.body_type[ba] != STATIC
                again = bool(True)
                while again:
                    again = False
                    toward.velocity = rotate_back(c, s, drift)
                    m = hull_disc_moving(hull, local, rb, toward, model.vertices, model.vertex_normals)
                    if not asked and closes(m, toward.velocity, dt, slack):
                        asked = True
                        if listed == 0:
                            list_static(w, model, pairs)
                            listed = 1
                        left = supported(pair, drift, dt, slack, toward.overlap, model, state, pairs)
                        again = left[0] != drift[0] or left[1] != drift[1]
                        drift = left
                m.normal = rotate(c, s, m.normal)
                m.point0 = rotate(c, s, m.point0) + xa
            else:
                if wp.static(not only_discs):
                    drift = vec2(vb[0] - va[0], vb[1] - va[1])
                    size_a = wp.length(center_a) + model.shape_extent[a]
                    size_b = wp.length(center_b) + model.shape_extent[b]
                    within = speculative + dt * (wp.length(drift) + wp.abs(va[2]) * size_a + wp.abs(vb[2]) * size_b)
                    if wp.length(xb - xa) > size_a + size_b + within:
                        continue
                    if ba != turned:
                        turned = ba
                        ca = wp.cos(state.angle[ba])
                        sa = wp.sin(state.angle[ba])
                    cb = wp.cos(state.angle[bb])
                    sb = wp.sin(state.angle[bb])
                    c = ca * cb + sa * sb
                    s = ca * sb - sa * cb
                    hull_a = hull_of(a, kind_a, ra, model.vertex_start)
                    hull_b = hull_of(b, kind_b, rb, model.vertex_start)
                    frame = frame_of(c, s, rotate_back(ca, sa, xb - xa))
                    m = hull_hull(
                        hull_a, hull_b, frame, within, slack, toward.overlap, model.vertices, model.vertex_normals
                    )
                    way = wp.length(drift) + wp.abs(va[2]) * wp.length(frame.x)
                    moves = vec2(way * dt, wp.abs(vb[2] - va[2]) * dt)
                    if m.count > 0 and m.beside:
                        arm_b = rotate(cb, sb, center_b)
                        drift = velocity_at(ba, bb, rotate(ca, sa, center_a), arm_b, state)
                        toward.share = vb[3] * inverse_or_zero(va[3] + vb[3])
                        now = m
                        asked = model.body_type[ba] != STATIC
                        again = bool(wp.length_sq(drift) * dt * dt > slack * slack)
                        if again:
                            moves = vec2(endless, endless)  # keep nothing: it will most likely be tested in full again
                        while again:
                            again = False
                            toward.velocity = rotate_back(ca, sa, drift)
                            m = hull_hull_moving(
                                hull_a, hull_b, frame, now, toward, model.vertices, model.vertex_normals
                            )
                            if not asked and closes(m, toward.velocity, dt, slack):
                                asked = True
                                if listed == 0:
                                    list_static(w, model, pairs)
                                    listed = 1
                                left = supported(pair, drift, dt, slack, toward.overlap, model, state, pairs)
                                again = left[0] != drift[0] or left[1] != drift[1]
                                drift = left
                    recycled = recycles == 1 and kind_a == POLYGON and kind_b == POLYGON
                    if recycled and keeps(pair - first_met, scratch) == 1:
                        sizes = vec2(bound_a, bound_b)
                        keep(w, pair, hull_a, hull_b, frame, sizes, moves, model.vertices, model.vertex_normals, pairs)
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
                speed = linear_speed(m.normal, va, vb)
                if wp.static(not only_discs):
                    speed = relative_speed(m.normal, va, vb, cross(to_a, m.normal), cross(to_b, m.normal))
                # a gap that the step's motion closes is a contact too
                if g <= speculative + wp.max(-speed * dt, real(0.0)):
                    if n < capacity:
                        # a scene of one material need not look it up
                        mu = config.uniform_friction
                        e = config.uniform_restitution
                        if mu < real(0.0):
                            mu = model.shape_friction[a]
                            if model.shape_friction[b] != mu:
                                mu = wp.sqrt(mu * model.shape_friction[b])
                        if e < real(0.0):
                            e = wp.max(model.shape_restitution[a], model.shape_restitution[b])
                        contact = Contact()
                        shape_key = (wp.int64(a - shape0) << SHIFT_A) | (wp.int64(b - shape0) << SHIFT_B)
                        contact.key = shape_key | wp.int64(feature)
                        contact.body_a = ba
                        contact.body_b = bb
                        contact.normal = m.normal
                        contact.arm_a = to_a
                        contact.arm_b = to_b
                        contact.gap = g
                        contact.friction = mu
                        contact.restitution = e
                        store_contact(contacts, start + n, contact)
                    n += 1
        rows.contact_needed[w] = n
        if n > capacity:
            state.flags[w] = state.flags[w] | CONTACT_OVERFLOW
            contacts.contact_count[w] = 0
            return
        contacts.contact_count[w] = n

    return {"narrowphase": narrowphase}


@cache
def stage_kernels(dtype: str) -> dict[str, Any]:
    """What a stage for anybody's arrays runs before and after ``narrowphase``; one thread a world."""
    t = group_types(dtype)
    module = kernel_module("contact_stage", dtype)

    @wp.kernel(module=module, enable_backward=False)
    def take_pairs(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        pair: wp.array2d(dtype=wp.int32),
        pair_count: wp.array(dtype=wp.int32),
        # Out:
        pairs: t.Pairs,
        contacts: t.Contacts,
    ):
        """Take a world's pairs of shapes in the order given, A static or the lower index, and look at its bodies.

        ``pair`` has no rows where ``pairs`` are made by others. A world with a body that is not finite, or a pair that
        is not of two shapes of it, is flagged and has no contacts.
        """
        w = wp.tid() + launch.world_offset
        state.flags[w] = 0
        contacts.contact_count[w] = 0
        for body in range(model.body_start[w], model.body_start[w + 1]):
            x = state.position[body]
            if not (wp.isfinite(x[0]) and wp.isfinite(x[1]) and wp.isfinite(state.angle[body])):
                state.flags[w] = INVALID
        if pair.shape[0] == 0:
            return
        first = pairs.start[w]
        count = pair_count[w]
        if count < 0 or count > pairs.start[w + 1] - first:
            state.flags[w] = INVALID
            return
        low = model.shape_start[w]
        high = model.shape_start[w + 1]
        for i in range(first, first + count):
            a = wp.min(pair[i, 0], pair[i, 1])
            b = wp.max(pair[i, 0], pair[i, 1])
            if a < low or b >= high or a == b:
                state.flags[w] = INVALID
                return
            if model.body_type[model.shape_body[b]] == STATIC:
                pairs.shape_a[i] = b
                pairs.shape_b[i] = a
            else:
                pairs.shape_a[i] = a
                pairs.shape_b[i] = b
        pairs.count[w] = count

    @wp.kernel(module=module, enable_backward=False)
    def place_contacts(
        launch: t.Launch,
        state: t.State,
        contacts: t.Contacts,
        # Out:
        point: wp.array(dtype=t.vec2),
    ):
        """Where the contacts of a world are, midway between the surfaces."""
        w = wp.tid() + launch.world_offset
        first = contacts.contact_start[w]
        for i in range(first, first + contacts.contact_count[w]):
            point[i] = state.position[contacts.body_a[i]] + contacts.arm_a[i]

    return {"take_pairs": take_pairs, "place_contacts": place_contacts}
