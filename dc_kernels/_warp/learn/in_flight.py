"""What a network reads of a solve in flight, contact by contact, and its correction of the impulses."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types, struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.learn.channels import RUNAWAY, Answer, Channel, Feature, Output, Scale
from dc_kernels.learn.groups import READING, SETTINGS
from dc_kernels.solve.rows import COLUMNS, LANES

UNKNOWN = 4.0  # A before the first sweep
ON_CONE = 0.999  # of the limit, from which on a contact slides
HEADERS = ("prelude.h", "learn/lanes.h", "solve/bodies.h", "side.h", "learn/steps.h", "learn/features.h")


@wp.func
def stopped(x: Any, friction: Any):
    """Impulses with the normal one stopped at 0, then the tangential one at its limit, as a sweep does."""
    n = wp.max(x[0], type(friction)(0.0))
    limit = friction * n
    return type(x)(n, wp.clamp(x[1], -limit, limit))


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``solve_features`` and ``correct_impulses``; a thread each world that is asked for."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Reading, Settings = struct_type("reading", dtype, READING), struct_type("reading_settings", dtype, SETTINGS)
    module = kernel_module("in_flight", dtype, variant)
    columns = COLUMNS[variant]
    zero, one = real(0.0), real(1.0)
    places = {name.upper(): columns.index(name) * LANES for name in ("en", "et", "bias")}
    enums = {f"FEATURE_{one.name}": int(one) for one in Feature} | {f"CHANNEL_{one.name}": int(one) for one in Channel}
    sizes = {"LANES": LANES, "WIDTH": len(columns) * LANES, "LOCAL": len(Feature), "IMAGE": len(Channel)}
    constants = {"UNKNOWN": UNKNOWN, "ON_CONE": ON_CONE, "NETWORK": int(Answer.NETWORK)}
    macros = {"IS_FLOAT": dtype == "float32", **constants, **sizes, **places, **enums}
    vec4s = wp.array(dtype=vec4)

    @wp.func_native(native_code(*HEADERS, dtype=dtype, **macros))
    def read_world(
        k: wp.int32,
        settings: Settings,
        model: t.Model,
        state: t.State,
        contacts: t.Contacts,
        rows: t.Rows,
        bodies: vec4s,
        stats: t.Stats,
        reading: Reading,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def solve_features(
        world_offset: int,
        settings: Settings,
        model: t.Model,
        state: t.State,
        contacts: t.Contacts,
        rows: t.Rows,
        motion: t.Motion,
        stats: t.Stats,
        # out:
        reading: Reading,
    ):
        """Read the contacts of the worlds that are asked for: steps, rates, scales; the rest for a network.

        That is what a network reads of each (``Feature``), what it splats (``Channel``), and where.
        """
        k = wp.tid() + world_offset
        if reading.answer[k] != Answer.NOTHING and reading.packed_start[k + 1] > reading.packed_start[k]:
            read_world(k, settings, model, state, contacts, rows, motion.solved, stats, reading)

    @wp.func(module=module)
    def correction(
        m: int, x: vec2, scale: vec4, even: bool, share: real, reading: Reading, output: wp.array2d(dtype=real)
    ):
        """What an output, or an even share, adds to the impulses x of a contact, before the cone."""
        s = reading.step[m]
        wide = one + reading.rate[m]
        if even:
            return wide * share * s
        free_n = output[m, Output.FREE_N] + output[m, Output.CARRIED_N] * x[0] / scale[Scale.IMPULSE]
        free_t = output[m, Output.FREE_T] + output[m, Output.CARRIED_T] * x[1] / scale[Scale.IMPULSE]
        dn = wide * output[m, Output.STEP_N] * s[0] + scale[Scale.EXPECTED] * free_n
        dt = wide * output[m, Output.STEP_T] * s[1] + scale[Scale.EXPECTED] * free_t
        return vec2(dn, dt)

    @wp.kernel(module=module, enable_backward=False)
    def correct_impulses(
        world_offset: int,
        settings: Settings,
        output: wp.array2d(dtype=real),
        # in, out:
        contacts: t.Contacts,
        reading: Reading,
        # out:
        stats: t.Stats,
    ):
        """Add the correction of a network, or by an even share, to the impulses and stop them at their cones.

        The correction (columns ``Output``) is multiples of 1 + A times the step, with the A near the contact; and, of
        the RMS expected, 1 + A times that of the step, parts alike for all contacts and parts by the impulse carried
        over its RMS. A world with an output that is not finite, or with a correction of more than ``limit`` times the
        RMS expected, is left as it is; and so is one where that is beyond ``RUNAWAY`` times what it carried.
        """
        k = wp.tid() + world_offset
        base = reading.packed_start[k]
        count = reading.packed_start[k + 1] - base
        if count == 0 or reading.answer[k] == Answer.NOTHING:
            return
        even = reading.answer[k] == Answer.EVEN
        w = reading.active[k]
        first = contacts.contact_start[w]
        scale = reading.scale[k]
        squares = zero
        for k0 in range(count):
            c = first + k0
            x = contacts.impulse[c]
            reading.before[c] = x
            reading.known[c] = x
            change = correction(base + k0, x, scale, even, settings.share, reading, output)
            squares += change[0] * change[0] + change[1] * change[1]
        rms = wp.sqrt(squares / real(count))
        # a comparison with NaN is false
        most = settings.limit * scale[Scale.EXPECTED]
        if most > real(RUNAWAY) * reading.least[w] or not (rms <= most):
            return
        for k0 in range(count):
            c = first + k0
            x = contacts.impulse[c]
            change = correction(base + k0, x, scale, even, settings.share, reading, output)
            x = stopped(x + change, contacts.friction[c])
            contacts.impulse[c] = x
            reading.known[c] = x
        stats.replaced[w] = 1

    return {"solve_features": solve_features, "correct_impulses": correct_impulses}
