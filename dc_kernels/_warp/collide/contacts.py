"""What contacts carry from step to step: impulses matched by key, and colours of the constraint graph."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR

DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
SERIAL = wp.constant(SERIAL_COLOR)


@wp.func
def lowest_free(mask: wp.uint64):
    """Lowest colour that no bit of the mask takes; the serial one when all others are taken."""
    color = int(0)
    while color < SERIAL and ((mask >> wp.uint64(color)) & wp.uint64(1)) != wp.uint64(0):
        color += 1
    return color


@wp.func
def color_bit(color: int):
    """The colour's bit; constraints of the serial colour block nobody."""
    if color == SERIAL:
        return wp.uint64(0)
    return wp.uint64(1) << wp.uint64(color)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_contacts`` and ``color_constraints``; one thread a world."""
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("contacts", dtype)

    @wp.kernel(module=module, enable_backward=False)
    def match_contacts(
        world_offset: int,
        use_cache: int,
        flags: wp.array(dtype=wp.int32),
        step_dt: wp.array(dtype=real),
        # Cache in:
        contact_dt: wp.array(dtype=real),
        cache_count: wp.array(dtype=wp.int32),
        cache_key: wp.array(dtype=wp.int64),
        cache_impulse: wp.array(dtype=vec2),
        cache_color: wp.array(dtype=wp.int32),
        cache_age: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_cache: wp.array(dtype=real),
        # Contacts in, out:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        key: wp.array(dtype=wp.int64),
        impulse: wp.array(dtype=vec2),
        color: wp.array(dtype=wp.int32),
        age: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
    ):
        """Merge of two sorted lists: a known key keeps impulse (scaled to the new time step), colour and age."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        scale = real(0.0)
        if use_cache != 0 and contact_dt[w] > real(0.0):
            scale = step_dt[w] / contact_dt[w]
        start = contact_start[w]
        old = start
        end = start + cache_count[w]
        for c in range(start, start + contact_count[w]):
            k = key[c]
            while old < end and cache_key[old] < k:
                old += 1
            if old < end and cache_key[old] == k:
                impulse[c] = cache_impulse[old] * scale
                color[c] = cache_color[old]
                age[c] = cache_age[old] + 1
            else:
                impulse[c] = vec2(real(0.0), real(0.0))
                color[c] = -1
                age[c] = 0
        for j in range(joint_start[w], joint_start[w + 1]):
            joint_impulse[j] = joint_cache[j] * scale

    @wp.func(module=module)
    def taken(body: int, body_type: wp.array(dtype=wp.int32), color_mask: wp.array(dtype=wp.uint64)):
        """Colours that a further constraint of the body must not have: only dynamic bodies forbid any."""
        if body_type[body] == DYNAMIC:
            return color_mask[body]
        return wp.uint64(0)

    @wp.kernel(module=module, enable_backward=False)
    def color_constraints(
        world_offset: int,
        flags: wp.array(dtype=wp.int32),
        # Model:
        body_start: wp.array(dtype=wp.int32),
        body_type: wp.array(dtype=wp.int32),
        # Joints:
        joint_start: wp.array(dtype=wp.int32),
        joint_body_a: wp.array(dtype=wp.int32),
        joint_body_b: wp.array(dtype=wp.int32),
        # Contacts in:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        # Scratch:
        color_mask: wp.array(dtype=wp.uint64),
        # out:
        joint_color: wp.array(dtype=wp.int32),
        color: wp.array(dtype=wp.int32),
    ):
        """Greedy colours: no two constraints of a colour share a dynamic body.

        Joints come first and so get the same colours in each step; contacts that persist keep theirs; new ones,
        and those of the serial colour, take the lowest that is free at both bodies.
        """
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        start = contact_start[w]
        end = start + contact_count[w]
        if joint_start[w] == joint_start[w + 1]:
            # nothing new, nothing to colour
            fresh = int(0)
            for c in range(start, end):
                if color[c] < 0 or color[c] == SERIAL:
                    fresh += 1
            if fresh == 0:
                return
        for b in range(body_start[w], body_start[w + 1]):
            color_mask[b] = wp.uint64(0)
        # masks of bodies that do not move fill up too, but nobody asks for them
        for j in range(joint_start[w], joint_start[w + 1]):
            a = joint_body_a[j]
            b = joint_body_b[j]
            free = lowest_free(taken(a, body_type, color_mask) | taken(b, body_type, color_mask))
            joint_color[j] = free
            color_mask[a] = color_mask[a] | color_bit(free)
            color_mask[b] = color_mask[b] | color_bit(free)
        for c in range(start, end):
            kept = color[c]
            if kept >= 0 and kept != SERIAL:
                a = body_a[c]
                b = body_b[c]
                color_mask[a] = color_mask[a] | color_bit(kept)
                color_mask[b] = color_mask[b] | color_bit(kept)
        for c in range(start, end):
            kept = color[c]
            if kept < 0 or kept == SERIAL:
                a = body_a[c]
                b = body_b[c]
                free = lowest_free(taken(a, body_type, color_mask) | taken(b, body_type, color_mask))
                color[c] = free
                color_mask[a] = color_mask[a] | color_bit(free)
                color_mask[b] = color_mask[b] | color_bit(free)

    return {"match_contacts": match_contacts, "color_constraints": color_constraints}
