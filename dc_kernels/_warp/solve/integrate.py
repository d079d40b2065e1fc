"""Semi-implicit Euler (seed, chapter 2.1): velocities before the contacts, positions after them."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels.model.enums import BodyType, Flag

STATIC = wp.constant(int(BodyType.STATIC))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
NONFINITE = wp.constant(int(Flag.NONFINITE))


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``predict``, ``displace`` and ``commit``; one thread a world."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("integrate", dtype)

    # fmt: off
    @wp.func_native(
        "for (int i = i0; i < i1; ++i) cache_key.data[i] = key.data[i];"
        "for (int i = i0; i < i1; ++i) cache_impulse.data[i] = impulse.data[i];"
        "for (int i = i0; i < i1; ++i) cache_color.data[i] = color.data[i];"
        "for (int i = i0; i < i1; ++i) cache_age.data[i] = age.data[i];"
    )
    def copy_contacts(
        i0: wp.int32, i1: wp.int32,
        key: wp.array(dtype=wp.int64), impulse: wp.array(dtype=vec2),
        color: wp.array(dtype=wp.int32), age: wp.array(dtype=wp.int32),
        cache_key: wp.array(dtype=wp.int64), cache_impulse: wp.array(dtype=vec2),
        cache_color: wp.array(dtype=wp.int32), cache_age: wp.array(dtype=wp.int32),
    ): ...
    # fmt: on

    @wp.kernel(module=module, enable_backward=False)
    def predict(
        world_offset: int,
        speculative_factor: real,
        speculative_limit: real,
        # Model:
        body_start: wp.array(dtype=wp.int32),
        length_scale: wp.array(dtype=real),
        gravity: wp.array(dtype=vec2),
        body_type: wp.array(dtype=wp.int32),
        inv_mass: wp.array(dtype=real),
        inv_inertia: wp.array(dtype=real),
        # State in:
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
        force: wp.array(dtype=vec2),
        torque: wp.array(dtype=real),
        step_dt: wp.array(dtype=real),
        # State in, out:
        flags: wp.array(dtype=wp.int32),
        # out:
        predicted: wp.array(dtype=vec4),
        reach: wp.array(dtype=real),
    ):
        """Velocities with forces and gravity applied; the fourth component is the inverse mass.

        ``reach`` is the speculative distance of the step: what the fastest body covers, for whatever it hits may leave
        as fast, within limits; in a world where most bodies rest, four times what they cover in the mean square. With a
        fixed 0.02 instead of up to 0.1 diameters, overlaps at impact reach 65 mm, not 1.
        """
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        dt = step_dt[w]
        g = gravity[w]
        # x - x is 0 for a finite x, NaN for inf and NaN
        check = real(0.0)
        fastest = real(0.0)
        squares = real(0.0)
        moving = int(0)
        for b in range(body_start[w], body_start[w + 1]):
            kind = body_type[b]
            if kind == DYNAMIC:
                m = inv_mass[b]
                v = velocity[b] + (g + force[b] * m) * dt
                spin = angular_velocity[b] + torque[b] * inv_inertia[b] * dt
                predicted[b] = vec4(v[0], v[1], spin, m)
            elif kind == STATIC:
                predicted[b] = vec4(real(0.0), real(0.0), real(0.0), real(0.0))
            else:
                predicted[b] = vec4(velocity[b][0], velocity[b][1], angular_velocity[b], real(0.0))
            p = predicted[b]
            check += (p[0] - p[0]) + (p[1] - p[1]) + (p[2] - p[2])
            square = p[0] * p[0] + p[1] * p[1]
            fastest = wp.max(fastest, square)
            if kind == DYNAMIC:
                squares += square
                moving += 1
        if check != real(0.0):
            flags[w] = NONFINITE
            return
        if moving > 0:
            fastest = wp.min(fastest, real(16.0) * squares / real(moving))
        scale = length_scale[w]
        reach[w] = wp.max(wp.min(wp.sqrt(fastest) * dt, speculative_limit * scale), speculative_factor * scale)

    @wp.kernel(module=module, enable_backward=False)
    def displace(
        world_offset: int,
        body_start: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        step_dt: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        # out:
        displacement: wp.array(dtype=vec4),
    ):
        """What the solved velocities move the bodies by in this step; position correction adds to it."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        dt = step_dt[w]
        for b in range(body_start[w], body_start[w + 1]):
            v = solved[b]
            displacement[b] = vec4(v[0] * dt, v[1] * dt, v[2] * dt, v[3])

    @wp.kernel(module=module, enable_backward=False)
    def commit(
        world_offset: int,
        # Model:
        body_start: wp.array(dtype=wp.int32),
        body_type: wp.array(dtype=wp.int32),
        step_dt: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        displacement: wp.array(dtype=vec4),
        # State in, out:
        position: wp.array(dtype=vec2),
        angle: wp.array(dtype=real),
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
        time: wp.array(dtype=wp.float64),
        flags: wp.array(dtype=wp.int32),
        # Contacts in:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        key: wp.array(dtype=wp.int64),
        impulse: wp.array(dtype=vec2),
        color: wp.array(dtype=wp.int32),
        age: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
        # Cache out:
        contact_dt: wp.array(dtype=real),
        cache_count: wp.array(dtype=wp.int32),
        cache_key: wp.array(dtype=wp.int64),
        cache_impulse: wp.array(dtype=vec2),
        cache_color: wp.array(dtype=wp.int32),
        cache_age: wp.array(dtype=wp.int32),
        joint_cache: wp.array(dtype=real),
    ):
        """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        first = body_start[w]
        last = body_start[w + 1]
        check = real(0.0)
        for b in range(first, last):
            v = solved[b]
            d = displacement[b]
            x = position[b] + vec2(d[0], d[1])
            a = angle[b] + d[2]
            check += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]) + (x[0] - x[0]) + (x[1] - x[1]) + (a - a)
        if check != real(0.0):
            flags[w] = NONFINITE
            return
        for b in range(first, last):
            if body_type[b] != STATIC:
                v = solved[b]
                d = displacement[b]
                position[b] = position[b] + vec2(d[0], d[1])
                angle[b] = angle[b] + d[2]
                velocity[b] = vec2(v[0], v[1])
                angular_velocity[b] = v[2]
        time[w] = time[w] + wp.float64(step_dt[w])
        start = contact_start[w]
        n = contact_count[w]
        copy_contacts(start, start + n, key, impulse, color, age, cache_key, cache_impulse, cache_color, cache_age)
        for j in range(joint_start[w], joint_start[w + 1]):
            joint_cache[j] = joint_impulse[j]
        cache_count[w] = n
        contact_dt[w] = step_dt[w]

    return {"predict": predict, "displace": displace, "commit": commit}
