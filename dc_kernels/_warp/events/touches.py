"""Contact events: which pairs of shapes touch, and what a step has changed of that; one thread a world."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.approach import approach_function
from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.events.lists import copy_pairs, is_before, list_missing
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

ASLEEP = wp.constant(int(Flag.ASLEEP))
SHIFT_A = wp.constant(wp.int64(KEY_SHAPE_BITS + KEY_FEATURE_BITS))
SHIFT_B = wp.constant(wp.int64(KEY_FEATURE_BITS))
SHAPE = wp.constant(wp.int64(2**KEY_SHAPE_BITS - 1))


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``note_touches``."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("touches", dtype)
    contiguous = contiguous_groups(dtype)
    approach_of = approach_function(dtype, "touches")

    @wp.kernel(module=module, enable_backward=False)
    def note_touches(
        launch: t.Launch, config: t.Config, model: t.Model, state: t.State, contacts: t.Contacts, touches: t.Touches
    ):
        """Merge a world's contacts with the pairs that touched before, and list what has begun, ended and hit."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(contacts)
        contiguous(touches)
        if state.flags[w] != 0 and (state.flags[w] != ASLEEP or touches.part[w] == 0):
            touches.begun_count[w] = 0
            touches.ended_count[w] = 0
            touches.hit_count[w] = 0
            return
        shape0 = model.shape_start[w]
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        known = start
        last_known = start + touches.count[w]
        # what touches now, where the lists of what has begun and hit will be
        n = start
        c = start
        while c < end:
            pair = contacts.key[c] >> SHIFT_B
            a = shape0 + int(contacts.key[c] >> SHIFT_A)
            b = shape0 + int(pair & SHAPE)
            impulse = real(0.0)
            speed = real(0.0)
            fastest = c
            presses = bool(False)
            lasts = bool(False)
            while c < end and contacts.key[c] >> SHIFT_B == pair:
                acts = contacts.color[c] >= 0  # it is not off
                lasts = lasts or acts
                impulse += contacts.impulse[c][0]
                presses = presses or (acts and (contacts.impulse[c][0] != real(0.0) or contacts.gap[c] < real(0.0)))
                if contacts.impulse[c][0] > real(0.0):
                    approach = approach_of(c, state, contacts)
                    if approach > speed:
                        speed = approach
                        fastest = c
                c += 1
            while known < last_known and is_before(touches.a[known], touches.b[known], a, b):
                known += 1
            touched = lasts and known < last_known and touches.a[known] == a and touches.b[known] == b
            if presses or touched:
                touches.begun_a[n] = a
                touches.begun_b[n] = b
                touches.impulse[n] = impulse
                touches.temp[n] = speed
                blow = speed
                # a gap that closes within a step lets an impact take two: the second one is no other hit
                if speed <= config.hit_speed or (touched and touches.speed[known] > config.hit_speed):
                    blow = real(0.0)
                if touched and touches.part[w] > 0 and touches.blow[known] >= blow:
                    blow = touches.blow[known]
                    if blow > real(0.0):
                        touches.hit_normal[n] = touches.normal[known]
                        touches.hit_point[n] = touches.point[known]
                elif blow > real(0.0):
                    touches.hit_normal[n] = contacts.normal[fastest]
                    touches.hit_point[n] = state.position[contacts.body_a[fastest]] + contacts.arm_a[fastest]
                touches.hit_speed[n] = blow
                n += 1
        now = n - start
        touches.count[w] = now
        copy_pairs(start, now, touches.begun_a, touches.begun_b, touches.a, touches.b)
        n = start
        for i in range(start, start + now):
            touches.speed[i] = touches.temp[i]
            blow = touches.hit_speed[i]
            touches.blow[i] = blow
            if blow > real(0.0):
                touches.normal[i] = touches.hit_normal[i]
                touches.point[i] = touches.hit_point[i]
                touches.hit_a[n] = touches.a[i]
                touches.hit_b[n] = touches.b[i]
                touches.hit_speed[n] = blow
                touches.hit_normal[n] = touches.normal[i]
                touches.hit_point[n] = touches.point[i]
                n += 1
        touches.hit_count[w] = n - start
        before = touches.before_count[w]
        touches.begun_count[w] = list_missing(
            start,
            now,
            touches.a,
            touches.b,
            before,
            touches.before_a,
            touches.before_b,
            touches.begun_a,
            touches.begun_b,
        )
        touches.ended_count[w] = list_missing(
            start,
            before,
            touches.before_a,
            touches.before_b,
            now,
            touches.a,
            touches.b,
            touches.ended_a,
            touches.ended_b,
        )
        touches.part[w] = (touches.part[w] + 1) % touches.parts[w]
        if touches.part[w] == 0:
            touches.before_count[w] = now
            copy_pairs(start, now, touches.a, touches.b, touches.before_a, touches.before_b)

    return {"note_touches": note_touches}
