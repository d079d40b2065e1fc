"""Candidate pairs -> contact points with normals from A to B and stable keys, sorted by key."""

from functools import cache
from typing import Any

from dc_kernels._taichi.collide.closing import closing_functions
from dc_kernels._taichi.collide.discs import disc_contacts
from dc_kernels._taichi.collide.manifold import manifold_functions
from dc_kernels._taichi.collide.support import support_functions
from dc_kernels._taichi.common import cross, dot, length, rotate, rotate_back
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.solve.laws import inverse_or_zero, linear_speed, relative_speed
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

DISC = int(ShapeType.DISC)
STATIC = int(BodyType.STATIC)
CONTACT_OVERFLOW = int(Flag.CONTACT_OVERFLOW)
INVALID = int(Flag.INVALID)
SHIFT_A = KEY_SHAPE_BITS + KEY_FEATURE_BITS
SHIFT_B = KEY_FEATURE_BITS
SLOPS = 2.0  # overlap up to which shapes touch: what rests a slop deep meets a tile a slop higher


@cache
def kernels(dtype: str, only_discs: bool) -> dict[str, Any]:
    """``narrowphase``; one thread a world.

    Args:
        dtype: "float32" or "float64".
        only_discs: whether all that moves are discs about their centre of mass; what they don't need is not compiled.
    """
    t = group_types(dtype)
    vec2 = t.vec2
    shapes = manifold_functions(dtype)
    Manifold, hull_of, frame_of = shapes.Manifold, shapes.hull_of, shapes.frame_of
    moving = closing_functions(dtype)
    Approach, disc_disc_moving, hull_disc_moving = moving.Approach, moving.disc_disc_moving, moving.hull_disc_moving
    hull_hull_moving = moving.hull_hull_moving
    support = support_functions(dtype, only_discs)
    find_disc_contacts = disc_contacts(dtype)
    closes, list_static, supported = support.closes, support.list_static, support.supported

    @ti.func
    def velocity_at(ba, bb, arm_a, arm_b, state: t.State):
        """Velocity of a point of B against one of A, before the step's forces: what rests does not fall."""
        turning = vec2(-arm_b[1], arm_b[0]) * state.angular_velocity[bb]
        turning = turning - vec2(-arm_a[1], arm_a[0]) * state.angular_velocity[ba]
        return state.velocity[bb] - state.velocity[ba] + turning

    @ti.func
    def discs_manifold(a, b, speculative, dt, slop, model: t.Model, state: t.State, motion: t.Motion):
        """Two discs; ``find_disc_contacts`` takes those of a scene that has hardly anything else."""
        ba = model.shape_body[a]
        bb = model.shape_body[b]
        va = motion.predicted[ba]
        vb = motion.predicted[bb]
        ra = model.shape_radius[a]
        rb = model.shape_radius[b]
        pa = center_at(a, ba, model, state)
        pb = center_at(b, bb, model, state)
        m = Manifold()
        # nearly all candidates end here: too far apart even if they close at their full relative speed
        far = ra + rb + speculative + dt * (ti.abs(vb[0] - va[0]) + ti.abs(vb[1] - va[1]))
        far += dt * (ti.abs(va[2]) * length(model.shape_center[a]) + ti.abs(vb[2]) * length(model.shape_center[b]))
        d = pb - pa
        if dot(d, d) <= far * far:
            to_a = pa - state.position[ba]
            to_b = pb - state.position[bb]
            dv = vec2(vb[0] - va[0], vb[1] - va[1])
            dv = dv + (vec2(-to_b[1], to_b[0]) * vb[2] - vec2(-to_a[1], to_a[0]) * va[2])
            m = disc_disc_moving(pa, ra, pb, rb, dv, dt, slop)
        return m

    @ti.func
    def center_at(shape, body, model: t.Model, state: t.State):
        """Where the centre of a shape of a body is."""
        center = model.shape_center[shape]
        at = state.position[body]
        if center[0] != 0.0 or center[1] != 0.0:
            at = at + rotate(ti.cos(state.angle[body]), ti.sin(state.angle[body]), center)
        return at

    @ti.func
    def hull_disc_manifold(a, b, turn, given, left, toward, model: t.Model, state: t.State):
        """A disc and a hull, whichever comes first; whether it is in the way, and the velocity of the second shape.

        That is ``left`` where it is ``given``. ``turn``: cosine and sine of the hull's angle.
        """
        disc_first = model.shape_type[a] == DISC
        disc = b
        other = a
        if disc_first:
            disc = a
            other = b
        body = model.shape_body[other]
        round_body = model.shape_body[disc]
        x = state.position[body]
        c = turn[0]
        s = turn[1]
        p = center_at(disc, round_body, model, state)
        hull = hull_of(other, model.shape_type[other], model.shape_radius[other], model)
        drift = velocity_at(body, round_body, p - x, p - state.position[round_body], state)
        if given:
            drift = left
        toward.velocity = rotate_back(c, s, drift)
        m = hull_disc_moving(hull, rotate_back(c, s, p - x), model.shape_radius[disc], toward, model)
        blocked = closes(m, toward.velocity, toward.dt, toward.slack)
        m.normal = rotate(c, s, m.normal)
        if disc_first:
            m.normal = m.normal * -1.0
        m.point0 = rotate(c, s, m.point0) + x
        return m, blocked, drift

    @ti.func
    def hulls_manifold(a, b, turn, speculative, given, left, toward, model: t.Model, state: t.State, motion: t.Motion):
        """Two hulls, as in ``hull_disc_manifold``; ``turn``: of the angle of A."""
        ba = model.shape_body[a]
        bb = model.shape_body[b]
        xa = state.position[ba]
        va = motion.predicted[ba]
        vb = motion.predicted[bb]
        center_a = model.shape_center[a]
        center_b = model.shape_center[b]
        ca = turn[0]
        sa = turn[1]
        cb = ti.cos(state.angle[bb])
        sb = ti.sin(state.angle[bb])
        c = ca * cb + sa * sb
        s = ca * sb - sa * cb
        drift = vec2(vb[0] - va[0], vb[1] - va[1])
        size_a = length(center_a) + model.shape_extent[a]
        size_b = length(center_b) + model.shape_extent[b]
        within = speculative + toward.dt * (length(drift) + ti.abs(va[2]) * size_a + ti.abs(vb[2]) * size_b)
        hull_a = hull_of(a, model.shape_type[a], model.shape_radius[a], model)
        hull_b = hull_of(b, model.shape_type[b], model.shape_radius[b], model)
        frame = frame_of(c, s, rotate_back(ca, sa, state.position[bb] - xa))
        drift = velocity_at(ba, bb, rotate(ca, sa, center_a), rotate(cb, sb, center_b), state)
        if given:
            drift = left
        toward.velocity = rotate_back(ca, sa, drift)
        toward.share = vb[3] * inverse_or_zero(va[3] + vb[3])
        m = Manifold()
        if length(state.position[bb] - xa) <= size_a + size_b + within:
            m = hull_hull_moving(hull_a, hull_b, frame, within, toward, model)
        moves = dot(drift, drift) * toward.dt * toward.dt > toward.slack * toward.slack
        blocked = moves and closes(m, toward.velocity, toward.dt, toward.slack)
        m.normal = rotate(ca, sa, m.normal)
        m.point0 = rotate(ca, sa, m.point0) + xa
        m.point1 = rotate(ca, sa, m.point1) + xa
        return m, blocked, drift

    @kernel
    def narrowphase(
        tid,
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
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            dt = motion.step_dt[w]
            speculative = motion.reach[w]
            slop = config.slop * model.length_scale[w]
            toward = Approach()
            toward.dt = dt
            toward.slack = config.slack * model.length_scale[w]
            toward.overlap = SLOPS * slop
            shape0 = model.shape_start[w]
            start = contacts.contact_start[w]
            capacity = contacts.contact_start[w + 1] - start
            n = 0
            listed = 0
            turned = -1  # the body of this cosine and sine: pairs of one first shape follow each other
            turn = vec2(1.0, 0.0)
            first_pair = pairs.start[w]
            last_pair = first_pair + pairs.count[w]
            pair = first_pair
            while pair < last_pair:
                if ti.static(only_discs):
                    pair, n = find_disc_contacts(w, pair, last_pair, n, config, model, state, motion, pairs, contacts)
                if pair < last_pair:
                    a = pairs.shape_a[pair]
                    b = pairs.shape_b[pair]
                    kind_a = model.shape_type[a]
                    kind_b = model.shape_type[b]
                    m = Manifold()
                    if kind_a == DISC and kind_b == DISC:
                        if ti.static(not only_discs):
                            m = discs_manifold(a, b, speculative, dt, slop, model, state, motion)
                    else:
                        hull_body = model.shape_body[ti.select(kind_a == DISC, b, a)]
                        if hull_body != turned:
                            turned = hull_body
                            turn = vec2(ti.cos(state.angle[hull_body]), ti.sin(state.angle[hull_body]))
                        asked = kind_a == DISC or model.body_type[model.shape_body[a]] != STATIC
                        given = False
                        left = vec2(0.0, 0.0)
                        again = True
                        while again:
                            again = False
                            blocked = False
                            drift = left
                            if kind_a == DISC or kind_b == DISC:
                                m, blocked, drift = hull_disc_manifold(a, b, turn, given, left, toward, model, state)
                            else:
                                if ti.static(not only_discs):
                                    m, blocked, drift = hulls_manifold(
                                        a, b, turn, speculative, given, left, toward, model, state, motion
                                    )
                            if blocked and not asked:
                                asked = True
                                given = True
                                if listed == 0:
                                    list_static(w, model, pairs)
                                    listed = 1
                                left = supported(pair, drift, toward, model, state, pairs)
                                again = left[0] != drift[0] or left[1] != drift[1]
                    if m.count > 0:
                        ba = model.shape_body[a]
                        bb = model.shape_body[b]
                        va = motion.predicted[ba]
                        vb = motion.predicted[bb]
                        # the lower feature first, so that contacts are sorted by key
                        swap = 0
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
                            to_a = p - state.position[ba]
                            to_b = p - state.position[bb]
                            speed = linear_speed(m.normal, va, vb)
                            if ti.static(not only_discs):
                                speed = relative_speed(m.normal, va, vb, cross(to_a, m.normal), cross(to_b, m.normal))
                            # a gap that the step's motion closes is a contact too
                            if g <= speculative + ti.max(-speed * dt, 0.0):
                                if n < capacity:
                                    # a scene of one material need not look it up
                                    mu = config.uniform_friction
                                    e = config.uniform_restitution
                                    if mu < 0.0:
                                        mu = model.shape_friction[a]
                                        if model.shape_friction[b] != mu:
                                            mu = ti.sqrt(mu * model.shape_friction[b])
                                    if e < 0.0:
                                        e = ti.max(model.shape_restitution[a], model.shape_restitution[b])
                                    shape_key = (ti.i64(a - shape0) << SHIFT_A) | (ti.i64(b - shape0) << SHIFT_B)
                                    contacts.key[start + n] = shape_key | ti.i64(feature)
                                    contacts.body_a[start + n] = ba
                                    contacts.body_b[start + n] = bb
                                    contacts.normal[start + n] = m.normal
                                    contacts.arm_a[start + n] = to_a
                                    contacts.arm_b[start + n] = to_b
                                    contacts.gap[start + n] = g
                                    contacts.friction[start + n] = mu
                                    contacts.restitution[start + n] = e
                                n += 1
                    pair += 1
            rows.contact_needed[w] = n
            if n > capacity:
                state.flags[w] = state.flags[w] | CONTACT_OVERFLOW
                n = 0
            contacts.contact_count[w] = n

    return {"narrowphase": narrowphase}


@cache
def stage_kernels(dtype: str) -> dict[str, Any]:
    """What a stage for anybody's arrays runs before and after ``narrowphase``; one thread a world."""
    t = group_types(dtype)

    @ti.func
    def is_finite(x):
        return x - x == 0.0

    @kernel
    def take_pairs(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        pair: ti.types.ndarray(dtype=ti.i32, ndim=2),
        pair_count: ti.types.ndarray(dtype=ti.i32, ndim=1),
        # Out:
        pairs: t.Pairs,
        contacts: t.Contacts,
    ):
        """Take a world's pairs of shapes in the order given, A static or the lower index, and look at its bodies.

        ``pair`` has no rows where ``pairs`` are made by others. A world with a body that is not finite, or a pair that
        is not of two shapes of it, is flagged and has no contacts.
        """
        w = tid + launch.world_offset
        flags = 0
        contacts.contact_count[w] = 0
        for body in range(model.body_start[w], model.body_start[w + 1]):
            x = state.position[body]
            if not (is_finite(x[0]) and is_finite(x[1]) and is_finite(state.angle[body])):
                flags = INVALID
        if pair.shape[0] != 0:
            first = pairs.start[w]
            count = pair_count[w]
            if count < 0 or count > pairs.start[w + 1] - first:
                flags = INVALID
            else:
                low = model.shape_start[w]
                high = model.shape_start[w + 1]
                bad = 0
                for i in range(first, first + count):
                    a = ti.min(pair[i, 0], pair[i, 1])
                    b = ti.max(pair[i, 0], pair[i, 1])
                    if a < low or b >= high or a == b:
                        bad = 1
                        break
                    if model.body_type[model.shape_body[b]] == STATIC:
                        pairs.shape_a[i] = b
                        pairs.shape_b[i] = a
                    else:
                        pairs.shape_a[i] = a
                        pairs.shape_b[i] = b
                if bad != 0:
                    flags = INVALID
                else:
                    pairs.count[w] = count
        state.flags[w] = flags

    @kernel
    def place_contacts(
        tid,
        launch: t.Launch,
        state: t.State,
        contacts: t.Contacts,
        # Out:
        point: ti.types.ndarray(dtype=t.vec2, ndim=1),
    ):
        """Where the contacts of a world are, midway between the surfaces."""
        w = tid + launch.world_offset
        first = contacts.contact_start[w]
        for i in range(first, first + contacts.contact_count[w]):
            point[i] = state.position[contacts.body_a[i]] + contacts.arm_a[i]

    return {"take_pairs": take_pairs, "place_contacts": place_contacts}
