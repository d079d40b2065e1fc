"""Semi-implicit Euler (Wu 2018, chapter 2.1): velocities before the contacts, positions after them."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import BodyType, Flag

STATIC = wp.constant(int(BodyType.STATIC))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
NONFINITE = wp.constant(int(Flag.NONFINITE))


@cache
def kernels(dtype: str, traits: bool = False) -> dict[str, Any]:
    """``predict``, ``displace`` and ``commit``; one thread a world; ``traits``: bodies have damping, gravity scales."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("integrate", dtype, *(["traits"] if traits else []))
    contiguous = contiguous_groups(dtype)

    @wp.func_native(native_code("collide/copy_contacts.h", dtype=dtype))
    def copy_contacts(contacts: t.Contacts, cache: t.Cache, i0: wp.int32, i1: wp.int32): ...

    @wp.func(module=module)
    def damped(v: Any, a: Any, rate: real, dt: real):
        """What v has become after dt where dv/dt = a - rate v: exact, whatever rate and dt."""
        x = rate * dt
        kept = wp.exp(-x)
        share = (real(1.0) - kept) / wp.max(x, real(0.1))  # of dt, in which a acts undamped
        if x < real(0.1):  # the difference above has few digits: Taylor's series of (1 - exp(-x)) / x
            share = real(1.0) - x / real(7.0)
            for k in range(6, 1, -1):
                share = real(1.0) - x / real(k) * share
        return v * kept + a * (dt * share)

    @wp.kernel(module=module, enable_backward=False)
    def predict(
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
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        if state.flags[w] != 0:
            return
        dt = motion.step_dt[w]
        g = model.gravity[w]
        # x - x is 0 for a finite x, NaN for inf and NaN
        check = real(0.0)
        fastest = real(0.0)
        squares = real(0.0)
        moving = int(0)
        for b in range(model.body_start[w], model.body_start[w + 1] - motion.empty_bodies[w]):
            kind = model.body_type[b]
            if kind == DYNAMIC:
                m = model.inv_mass[b]
                if wp.static(traits):
                    a = g * model.gravity_scale[b] + state.force[b] * m
                    v = damped(state.velocity[b], a, model.linear_damping[b], dt)
                    turning = state.torque[b] * model.inv_inertia[b]
                    spin = damped(state.angular_velocity[b], turning, model.angular_damping[b], dt)
                else:
                    v = state.velocity[b] + (g + state.force[b] * m) * dt
                    spin = state.angular_velocity[b] + state.torque[b] * model.inv_inertia[b] * dt
                motion.predicted[b] = vec4(v[0], v[1], spin, m)
            elif kind == STATIC:
                motion.predicted[b] = vec4(real(0.0), real(0.0), real(0.0), real(0.0))
            else:
                motion.predicted[b] = vec4(
                    state.velocity[b][0], state.velocity[b][1], state.angular_velocity[b], real(0.0)
                )
            p = motion.predicted[b]
            check += (p[0] - p[0]) + (p[1] - p[1]) + (p[2] - p[2])
            square = p[0] * p[0] + p[1] * p[1]
            fastest = wp.max(fastest, square)
            if kind == DYNAMIC:
                squares += square
                moving += 1
        if check != real(0.0):
            state.flags[w] = NONFINITE
            return
        if moving > 0:
            fastest = wp.min(fastest, real(16.0) * squares / real(moving))
        scale = model.length_scale[w]
        motion.reach[w] = wp.max(
            wp.min(wp.sqrt(fastest) * dt, config.speculative_max * scale), config.speculative * scale
        )

    @wp.kernel(module=module, enable_backward=False)
    def displace(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
    ):
        """What the solved velocities move the bodies by in this step; position correction adds to it."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        if state.flags[w] != 0:
            return
        dt = motion.step_dt[w]
        for b in range(model.body_start[w], model.body_start[w + 1] - motion.empty_bodies[w]):
            v = motion.solved[b]
            motion.displacement[b] = vec4(v[0] * dt, v[1] * dt, v[2] * dt, v[3])

    @wp.kernel(module=module, enable_backward=False)
    def commit(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        cache: t.Cache,
    ):
        """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous(cache)
        if state.flags[w] != 0:
            return
        first = model.body_start[w]
        last = model.body_start[w + 1] - motion.empty_bodies[w]
        check = real(0.0)
        for b in range(first, last):
            v = motion.solved[b]
            d = motion.displacement[b]
            x = state.position[b] + vec2(d[0], d[1])
            a = state.angle[b] + d[2]
            check += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]) + (x[0] - x[0]) + (x[1] - x[1]) + (a - a)
        if check != real(0.0):
            state.flags[w] = NONFINITE
            return
        for b in range(first, last):
            if model.body_type[b] != STATIC:
                v = motion.solved[b]
                d = motion.displacement[b]
                state.position[b] = state.position[b] + vec2(d[0], d[1])
                state.angle[b] = state.angle[b] + d[2]
                state.velocity[b] = vec2(v[0], v[1])
                state.angular_velocity[b] = v[2]
        state.time[w] = state.time[w] + wp.float64(motion.step_dt[w])
        start = contacts.contact_start[w]
        n = contacts.contact_count[w]
        copy_contacts(contacts, cache, start, start + n)
        joint = model.joint_start[w]
        last_joint = model.joint_start[w + 1]
        if joint < last_joint:  # two loads less in a world without joints
            for k in range(joints.joint_row_start[joint], joints.joint_row_start[last_joint]):
                cache.joint_impulse[k] = joints.joint_impulse[k]
        cache.count[w] = n
        contacts.contact_dt[w] = motion.step_dt[w]

    return {"predict": predict, "displace": displace, "commit": commit}
