"""Semi-implicit Euler (Wu 2018, chapter 2.1): velocities before the contacts, positions after them."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.model.enums import BodyType, Flag

STATIC = int(BodyType.STATIC)
DYNAMIC = int(BodyType.DYNAMIC)
NONFINITE = int(Flag.NONFINITE)


@cache
def kernels(dtype: str, traits: bool = False) -> dict[str, Any]:
    """``predict``, ``displace`` and ``commit``; one thread a world; ``traits``: bodies have damping, gravity scales."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4

    @ti.func
    def damped(v, a, rate, dt):
        """What v has become after dt where dv/dt = a - rate v: exact, whatever rate and dt."""
        x = rate * dt
        kept = ti.exp(-x)
        share = (1.0 - kept) / ti.max(x, real(0.1))  # of dt, in which a acts undamped
        if x < 0.1:  # the difference above has few digits: Taylor's series of (1 - exp(-x)) / x
            share = 1.0 - x / 7.0
            for k in ti.static((6, 5, 4, 3, 2)):
                share = 1.0 - x / k * share
        return v * kept + a * (dt * share)

    if traits:

        @ti.func
        def moved(b, g, dt, m, model: t.Model, state: t.State):
            a = g * model.gravity_scale[b] + state.force[b] * m
            v = damped(state.velocity[b], a, model.linear_damping[b], dt)
            turning = state.torque[b] * model.inv_inertia[b]
            spin = damped(state.angular_velocity[b], turning, model.angular_damping[b], dt)
            return vec4(v[0], v[1], spin, m)

    else:

        @ti.func
        def moved(b, g, dt, m, model: t.Model, state: t.State):
            v = state.velocity[b] + (g + state.force[b] * m) * dt
            spin = state.angular_velocity[b] + state.torque[b] * model.inv_inertia[b] * dt
            return vec4(v[0], v[1], spin, m)

    @kernel
    def predict(
        tid,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
    ):
        """Velocities with forces and gravity applied; the fourth component is the inverse mass.

        ``reach`` is the speculative distance of the step: what the fastest body covers, for whatever it hits may leave
        as fast, within limits; in a world where most bodies rest, four times what they cover in the mean square. With a
        fixed 0.02 instead of up to 0.1 diameters, overlaps at impact reach 65 mm, not 1.
        """
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            dt = motion.step_dt[w]
            g = model.gravity[w]
            # x - x is 0 for a finite x, NaN for inf and NaN
            check = real(0.0)
            fastest = real(0.0)
            squares = real(0.0)
            moving = 0
            for b in range(model.body_start[w], model.body_start[w + 1]):
                kind = model.body_type[b]
                p = vec4(0.0, 0.0, 0.0, 0.0)
                if kind == DYNAMIC:
                    m = model.inv_mass[b]
                    p = moved(b, g, dt, m, model, state)
                elif kind != STATIC:
                    p = vec4(state.velocity[b][0], state.velocity[b][1], state.angular_velocity[b], 0.0)
                else:  # what hits it looks at its velocity, which stays what was written
                    v = state.velocity[b]
                    spin = state.angular_velocity[b]
                    check += (v[0] - v[0]) + (v[1] - v[1]) + (spin - spin)
                motion.predicted[b] = p
                check += (p[0] - p[0]) + (p[1] - p[1]) + (p[2] - p[2])
                square = p[0] * p[0] + p[1] * p[1]
                fastest = ti.max(fastest, square)
                if kind == DYNAMIC:
                    squares += square
                    moving += 1
            now = state.time[w]
            origin = model.origin[w]
            far = (now - now) + (origin[0] - origin[0]) + (origin[1] - origin[1])
            if not (check == 0.0 and far == 0.0):
                state.flags[w] = NONFINITE
            else:
                if moving > 0:
                    fastest = ti.min(fastest, 16.0 * squares / real(moving))
                scale = model.length_scale[w]
                motion.reach[w] = ti.max(
                    ti.min(ti.sqrt(fastest) * dt, config.speculative_max * scale), config.speculative * scale
                )

    @kernel
    def displace(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
    ):
        """What the solved velocities move the bodies by in this step; position correction adds to it."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            dt = motion.step_dt[w]
            for b in range(model.body_start[w], model.body_start[w + 1]):
                v = motion.solved[b]
                motion.displacement[b] = vec4(v[0] * dt, v[1] * dt, v[2] * dt, v[3])

    @kernel
    def commit(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        cache: t.Cache,
    ):
        """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            first = model.body_start[w]
            last = model.body_start[w + 1]
            check = real(0.0)
            for b in range(first, last):
                v = motion.solved[b]
                d = motion.displacement[b]
                x = state.position[b] + vec2(d[0], d[1])
                a = state.angle[b] + d[2]
                check += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]) + (x[0] - x[0]) + (x[1] - x[1]) + (a - a)
            if not (check == 0.0):
                state.flags[w] = NONFINITE
            else:
                for b in range(first, last):
                    if model.body_type[b] != STATIC:
                        v = motion.solved[b]
                        d = motion.displacement[b]
                        state.position[b] = state.position[b] + vec2(d[0], d[1])
                        state.angle[b] = state.angle[b] + d[2]
                        state.velocity[b] = vec2(v[0], v[1])
                        state.angular_velocity[b] = v[2]
                state.time[w] = state.time[w] + ti.f64(motion.step_dt[w])
                start = contacts.contact_start[w]
                n = contacts.contact_count[w]
                for c in range(start, start + n):
                    cache.key[c] = contacts.key[c]
                    cache.impulse[c] = contacts.impulse[c]
                    cache.color[c] = contacts.color[c]
                    cache.age[c] = contacts.age[c]
                first_row = joints.joint_row_start[model.joint_start[w]]
                last_row = joints.joint_row_start[model.joint_start[w + 1]]
                for k in range(first_row, last_row):
                    cache.joint_impulse[k] = joints.joint_impulse[k]
                cache.count[w] = n
                contacts.contact_dt[w] = motion.step_dt[w]

    return {"predict": predict, "displace": displace, "commit": commit}
