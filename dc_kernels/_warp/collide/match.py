"""What contacts carry from step to step: impulses, colours and ages, matched by key."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_contacts``; one thread a world."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("match", dtype)
    contiguous = contiguous_groups(dtype)

    @wp.kernel(module=module, enable_backward=False)
    def match_contacts(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        cache: t.Cache,
    ):
        """Merge of two sorted lists: a known key keeps impulse (scaled to the new time step), colour and age."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous(cache)
        if state.flags[w] != 0:
            return
        scale = real(0.0)
        if config.start != 0 and contacts.contact_dt[w] > real(0.0):
            scale = motion.step_dt[w] / contacts.contact_dt[w]
        start = contacts.contact_start[w]
        old = start
        end = start + cache.count[w]
        for c in range(start, start + contacts.contact_count[w]):
            k = contacts.key[c]
            while old < end and cache.key[old] < k:
                old += 1
            if old < end and cache.key[old] == k:
                contacts.impulse[c] = cache.impulse[old] * scale
                contacts.color[c] = cache.color[old]
                contacts.age[c] = cache.age[old] + 1
            else:
                contacts.impulse[c] = vec2(real(0.0), real(0.0))
                contacts.color[c] = -1
                contacts.age[c] = 0
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            joints.joint_impulse[j] = cache.joint_impulse[j] * scale

    return {"match_contacts": match_contacts}
