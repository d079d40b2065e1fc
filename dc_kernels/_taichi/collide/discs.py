"""Contacts of pairs of discs, LANES of them side by side: a scene of discs has hardly any others."""

from functools import cache
from typing import Any

from dc_kernels._taichi.collide.closing import FAST
from dc_kernels._taichi.collide.manifold import EPSILON
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.bodies import body_functions, largest, magnitude, pairs_at, values_at
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS
from dc_kernels.solve.rows import LANES

DISC = int(ShapeType.DISC)
SHIFT_A = KEY_SHAPE_BITS + KEY_FEATURE_BITS
SHIFT_B = KEY_FEATURE_BITS


@cache
def disc_contacts(dtype: str) -> Any:
    """The function that adds the contacts of a run of pairs of centred discs, with the bits of ``disc_disc_moving``.

    It returns the first pair that is of other shapes, and the contacts found by then.
    """
    t = group_types(dtype)
    vec2, vec8 = t.vec2, t.vec8
    integers = ti.types.vector(LANES, ti.i32)
    of_bodies = body_functions(dtype)
    bodies_at, unknown_floor = of_bodies.bodies_at, of_bodies.unknown_floor
    epsilon = EPSILON[dtype]

    @ti.func
    def discs_ahead(first, last, model: t.Model, pairs: t.Pairs):
        """How many of the pairs from the first one on, at most LANES, are of two discs."""
        lanes = 0
        room = ti.min(last - first, LANES)
        kinds = 0
        if room == LANES:  # nearly always
            for i in ti.static(range(LANES)):
                kinds = kinds | (model.shape_type[pairs.shape_a[first + i]] ^ DISC)
                kinds = kinds | (model.shape_type[pairs.shape_b[first + i]] ^ DISC)
            if kinds == 0:
                lanes = LANES
        while lanes < room:
            a = model.shape_type[pairs.shape_a[first + lanes]]
            b = model.shape_type[pairs.shape_b[first + lanes]]
            if a == DISC and b == DISC:
                lanes += 1
            else:
                room = 0
        return lanes

    @ti.func
    def mixed_friction(a, b, model: t.Model):
        mu = model.shape_friction[a]
        if model.shape_friction[b] != mu:
            mu = ti.sqrt(mu * model.shape_friction[b])
        return mu

    @ti.func
    def find_disc_contacts(
        w,
        first,
        last,
        already,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
    ):
        floor = unknown_floor(config)
        dt = motion.step_dt[w]
        reach = motion.reach[w]
        slop = config.slop * model.length_scale[w]
        start = contacts.contact_start[w]
        capacity = contacts.contact_start[w + 1] - start
        shape0 = model.shape_start[w]
        found = already
        pair = first
        going = 1
        while going == 1 and pair < last:
            lanes = discs_ahead(pair, last, model, pairs)
            if lanes < LANES:
                going = 0
            if lanes > 0:
                # lanes beyond the last pair are the first one again, and store nothing
                at = integers(0)
                for i in ti.static(range(LANES)):
                    at[i] = pair + ti.select(i < lanes, i, 0)
                a = values_at(pairs.shape_a, at)
                b = values_at(pairs.shape_b, at)
                of_a = values_at(model.shape_body, a)
                of_b = values_at(model.shape_body, b)
                vax, vay, _, _ = bodies_at(motion.predicted, of_a, floor)
                vbx, vby, _, _ = bodies_at(motion.predicted, of_b, floor)
                xa, ya = pairs_at(state.position, of_a)
                xb, yb = pairs_at(state.position, of_b)
                ra = values_at(model.shape_radius, a)
                rb = values_at(model.shape_radius, b)
                radii = ra + rb
                x = xb - xa
                y = yb - ya
                vx = vbx - vax
                vy = vby - vay
                squared = x * x + y * y
                far = radii + reach + dt * (magnitude(vx) + magnitude(vy))
                near = ti.select(squared > far * far, vec8(0.0), vec8(1.0))
                if largest(near) > 0.0:
                    length = ti.sqrt(squared)
                    nx = ti.select(length > epsilon * radii, x / length, vec8(1.0))
                    ny = ti.select(length > epsilon * radii, y / length, vec8(0.0))
                    gap = length - ra - rb
                    along = ra + 0.5 * gap
                    px = xa + nx * along
                    py = ya + ny * along
                    closing = (nx * vx + ny * vy) * -1.0 * dt
                    way = ti.sqrt(vx * vx + vy * vy) * dt
                    passing = ti.select(gap > slop, ti.select(gap < closing, way, vec8(0.0)), vec8(0.0))
                    passing = ti.select(passing > FAST * radii, vec8(1.0), vec8(0.0))
                    if largest(passing) > 0.0:
                        when = (x * vx + y * vy) / (vx * vx + vy * vy)
                        miss_x = x - vx * when
                        miss_y = y - vy * when
                        end_x = x + vx * dt
                        end_y = y + vy * dt
                        later = ti.max(ti.sqrt(end_x * end_x + end_y * end_y) - radii + closing, gap)
                        later = ti.select(miss_x * miss_x + miss_y * miss_y >= radii * radii, later, gap)
                        gap = ti.select(passing > 0.0, later, gap)
                    touching = ti.select(gap <= reach + ti.max(closing, vec8(0.0)), near, vec8(0.0))
                    # which touch, without a branch that is guessed wrong every few pairs
                    count = 0
                    for i in ti.static(range(LANES)):
                        if i < lanes:
                            pairs.temp_b[pair + count] = i
                            count += ti.cast(touching[i] > 0.0, ti.i32)
                    arm_ax = px - xa
                    arm_ay = py - ya
                    arm_bx = px - xb
                    arm_by = py - yb
                    for k in range(ti.min(count, capacity - found)):
                        i = pairs.temp_b[pair + k]
                        c = start + found + k
                        contacts.key[c] = (ti.i64(a[i] - shape0) << SHIFT_A) | (ti.i64(b[i] - shape0) << SHIFT_B)
                        contacts.body_a[c] = of_a[i]
                        contacts.body_b[c] = of_b[i]
                        contacts.normal[c] = vec2(nx[i], ny[i])
                        contacts.arm_a[c] = vec2(arm_ax[i], arm_ay[i])
                        contacts.arm_b[c] = vec2(arm_bx[i], arm_by[i])
                        contacts.gap[c] = gap[i]
                        # a scene of one material need not look it up
                        mu = config.uniform_friction
                        e = config.uniform_restitution
                        if mu < 0.0:
                            mu = mixed_friction(a[i], b[i], model)
                        if e < 0.0:
                            e = ti.max(model.shape_restitution[a[i]], model.shape_restitution[b[i]])
                        contacts.friction[c] = mu
                        contacts.restitution[c] = e
                    found += count
                pair += lanes
        return pair, found

    return find_disc_contacts
