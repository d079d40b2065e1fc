"""Candidate pairs -> contact points with normals from A to B and stable keys, sorted by key.

Each pair is treated in the frame of one of its shapes and turned to world axes at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dc_kernels._numpy.collide.closing import disc_disc_moving, hull_disc_moving, hull_hull_moving
from dc_kernels._numpy.collide.manifold import Hull, Manifold, hull_disc, hull_hull, length
from dc_kernels._numpy.collide.support import closes, supported
from dc_kernels._numpy.common import Array, Kernels, cross, dot, rotate, rotation
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

SLOPS = 2.0  # overlap up to which shapes touch: what rests a slop deep meets a tile a slop higher


def kernels(dtype: str, only_discs: bool) -> Kernels:
    """``narrowphase``, the same whatever moves.

    Args:
        dtype: "float32" or "float64": what counts as zero distance.
        only_discs: whether all that moves are discs about their centre of mass.
    """
    epsilon = 1e-9 if dtype == "float32" else 1e-15

    def narrowphase(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        motion: Any,
        pairs: Any,
        contacts: Any,
        rows: Any,
    ) -> None:
        """Contacts of a world: gap below the speculative distance, or closing within the step."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return

        def hull_of(shape: int) -> Hull:
            first, last = model.vertex_start[shape], model.vertex_start[shape + 1]
            if model.shape_type[shape] == ShapeType.POLYGON:
                return Hull(model.vertices[first:last], model.vertex_normals[first:last], model.shape_radius[shape])
            v1, v2, before, beyond = model.vertices[first : first + 4]
            return Hull(
                model.vertices[first : first + 2],
                model.vertex_normals[first : first + 2],
                model.shape_radius[shape],
                None if (before == v1).all() else before,
                None if (beyond == v2).all() else beyond,
                segment=True,
            )

        def approach(a: int, at_a: Array, b: int, at_b: Array, velocity: Array, spin: Array) -> Array:
            """Velocity of a point of B's body against one of A's body."""
            ba, bb = model.shape_body[a], model.shape_body[b]
            arm_a, arm_b = at_a - state.position[ba], at_b - state.position[bb]
            turning = spin[bb] * np.array([-arm_b[1], arm_b[0]]) - spin[ba] * np.array([-arm_a[1], arm_a[0]])
            return velocity[bb, :2] - velocity[ba, :2] + turning

        def manifold(a: int, b: int) -> Manifold:
            """Points of a pair in world axes."""
            xa, xb = state.position[model.shape_body[a]], state.position[model.shape_body[b]]
            turn_a, turn_b = rotation(state.angle[model.shape_body[a]]), rotation(state.angle[model.shape_body[b]])
            centre_a, centre_b = xa + rotate(turn_a, model.shape_center[a]), xb + rotate(turn_b, model.shape_center[b])
            disc_a, disc_b = model.shape_type[a] == ShapeType.DISC, model.shape_type[b] == ShapeType.DISC
            ra, rb = model.shape_radius[a], model.shape_radius[b]
            if disc_a and disc_b:
                drift = approach(a, centre_a, b, centre_b, motion.predicted, motion.predicted[:, 2])
                return disc_disc_moving(centre_a, ra, centre_b, rb, drift, dt, slop, epsilon)
            if disc_a:
                local = rotate(turn_b.T, centre_a - xb)
                drift = rotate(turn_b.T, approach(b, centre_a, a, centre_a, state.velocity, state.angular_velocity))
                return hull_disc_moving(hull_of(b), local, ra, drift, **bounds).placed(turn_b, xb, flip=True)
            if disc_b:
                local, hull_a = rotate(turn_a.T, centre_b - xa), hull_of(a)
                drift = approach(a, centre_b, b, centre_b, state.velocity, state.angular_velocity)

                def met(velocity: Array) -> Manifold:
                    m = hull_disc_moving(hull_a, local, rb, rotate(turn_a.T, velocity), **bounds)
                    return m.placed(turn_a, xa)

                return supported_meeting(a, b, drift, met)
            relative = rotation(state.angle[model.shape_body[b]] - state.angle[model.shape_body[a]])
            hull_b = hull_of(b).placed(relative, rotate(turn_a.T, xb - xa))
            va, vb = motion.predicted[model.shape_body[a]], motion.predicted[model.shape_body[b]]
            spin = sum(
                abs(v[2]) * (length(model.shape_center[s]) + model.shape_extent[s]) for v, s in ((va, a), (vb, b))
            )
            within = speculative + dt * (length(vb - va) + spin)
            drift = approach(a, centre_a, b, centre_b, state.velocity, state.angular_velocity)
            share, hull_a = vb[3] / (va[3] + vb[3]), hull_of(a)

            def met(velocity: Array) -> Manifold:
                w = rotate(turn_a.T, velocity)
                return hull_hull_moving(hull_a, hull_b, w, share, reach=within, **bounds).placed(turn_a, xa)

            return supported_meeting(a, b, drift, met)

        def still(a: int, b: int, reach: Any) -> Manifold:
            """Points of a static hull and a shape as they are now, in world axes."""
            xa, xb = state.position[model.shape_body[a]], state.position[model.shape_body[b]]
            turn_a, turn_b = rotation(state.angle[model.shape_body[a]]), rotation(state.angle[model.shape_body[b]])
            if model.shape_type[b] == ShapeType.DISC:
                local = rotate(turn_a.T, xb + rotate(turn_b, model.shape_center[b]) - xa)
                m = hull_disc(hull_of(a), local, model.shape_radius[b], epsilon)
                m.beside = m.corner
            else:
                relative = rotation(state.angle[model.shape_body[b]] - state.angle[model.shape_body[a]])
                hull_b = hull_of(b).placed(relative, rotate(turn_a.T, xb - xa))
                m = hull_hull(hull_of(a), hull_b, reach, bounds["slack"], bounds["overlap"], epsilon)
            return m.placed(turn_a, xa)

        def supported_meeting(a: int, b: int, velocity: Array, met: Callable[[Array], Manifold]) -> Manifold:
            """Where a shape meets another by its velocity, or by what static shapes leave of it that it meets first."""
            m = met(velocity)
            if model.body_type[model.shape_body[a]] != BodyType.STATIC or not closes(m, velocity, dt, bounds["slack"]):
                return m
            mine = range(pairs.start[w], pairs.start[w] + pairs.count[w])
            others = [int(pairs.shape_a[pair]) for pair in reversed(mine) if pairs.shape_b[pair] == b]
            static = model.body_type[model.shape_body] == BodyType.STATIC
            hulls = [k for k in others if k != a and static[k] and model.shape_type[k] != ShapeType.DISC]
            far = length(velocity) * dt
            return met(supported(velocity, (still(k, b, far) for k in hulls), dt, bounds["slack"]))

        dt = motion.step_dt[w]
        speculative = motion.reach[w]
        slop = config.slop * model.length_scale[w]
        bounds = {"dt": dt, "slack": config.slack * model.length_scale[w], "overlap": SLOPS * slop, "epsilon": epsilon}
        found = []
        for pair in range(pairs.start[w], pairs.start[w] + pairs.count[w]):
            a, b = int(pairs.shape_a[pair]), int(pairs.shape_b[pair])
            ba, bb = model.shape_body[a], model.shape_body[b]
            va, vb = motion.predicted[ba], motion.predicted[bb]
            if min(va[3], vb[3]) < 0 and max(va[3], vb[3]) <= 0:
                continue  # asleep, both or beside what does not move (sleep/wake.py)
            m = manifold(a, b)
            shapes = (a - int(model.shape_start[w])) << KEY_SHAPE_BITS | (b - int(model.shape_start[w]))
            for point, g, feature in m.points:
                to_a, to_b = point - state.position[ba], point - state.position[bb]
                speed = dot(m.normal, vb - va) + cross(to_b, m.normal) * vb[2] - cross(to_a, m.normal) * va[2]
                if g <= speculative + max(-speed * dt, 0.0):
                    found.append((shapes << KEY_FEATURE_BITS | feature, a, b, m.normal, to_a, to_b, g))
        found.sort(key=lambda contact: contact[0])
        rows.contact_needed[w] = len(found)
        if len(found) > contacts.contact_start[w + 1] - contacts.contact_start[w]:
            state.flags[w] |= Flag.CONTACT_OVERFLOW
            contacts.contact_count[w] = 0
            return
        contacts.contact_count[w] = len(found)
        for c, (number, a, b, n, to_a, to_b, g) in enumerate(found, contacts.contact_start[w]):
            contacts.key[c] = number
            contacts.body_a[c], contacts.body_b[c] = model.shape_body[a], model.shape_body[b]
            contacts.normal[c], contacts.arm_a[c], contacts.arm_b[c], contacts.gap[c] = n, to_a, to_b, g
            contacts.friction[c] = np.sqrt(model.shape_friction[a] * model.shape_friction[b])
            contacts.restitution[c] = max(model.shape_restitution[a], model.shape_restitution[b])

    return {"narrowphase": narrowphase}


def stage_kernels(dtype: str) -> Kernels:
    """What a stage for anybody's arrays runs before and after ``narrowphase``; the arrays bring their scalar type."""
    return {"take_pairs": take_pairs, "place_contacts": place_contacts}


def take_pairs(
    tid: int, launch: Any, model: Any, state: Any, pair: Array, pair_count: Array, pairs: Any, contacts: Any
) -> None:
    """Take a world's pairs of shapes in the order given, A static or the lower index, and look at its bodies."""
    w = tid + launch.world_offset
    state.flags[w] = contacts.contact_count[w] = 0
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    if not (np.isfinite(state.position[bodies]).all() and np.isfinite(state.angle[bodies]).all()):
        state.flags[w] = Flag.INVALID
    if len(pair) == 0:
        return
    first, count = pairs.start[w], pair_count[w]
    given = np.sort(pair[first : first + max(count, 0)], axis=1)
    a, b = given.T
    inside = (a >= model.shape_start[w]) & (b < model.shape_start[w + 1]) & (a != b)
    if not 0 <= count <= pairs.start[w + 1] - first or not inside.all():
        state.flags[w] = Flag.INVALID
        return
    static = model.body_type[model.shape_body[b]] == BodyType.STATIC
    pairs.shape_a[first : first + count] = np.where(static, b, a)
    pairs.shape_b[first : first + count] = np.where(static, a, b)
    pairs.count[w] = count


def place_contacts(tid: int, launch: Any, state: Any, contacts: Any, point: Array) -> None:
    """Where the contacts of a world are, midway between the surfaces."""
    w = tid + launch.world_offset
    first = contacts.contact_start[w]
    used = slice(first, first + contacts.contact_count[w])
    point[used] = state.position[contacts.body_a[used]] + contacts.arm_a[used]
