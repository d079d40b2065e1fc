"""What contacts carry from step to step: impulses, colours and ages, matched by key."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.kernels import kernel


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_contacts``; one thread a world."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2

    @kernel
    def match_contacts(
        tid,
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
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            scale = real(0.0)
            if config.start != 0 and contacts.contact_dt[w] > 0.0:
                scale = motion.step_dt[w] / contacts.contact_dt[w]
            start = contacts.contact_start[w]
            old = start
            end = start + cache.count[w]
            for c in range(start, start + contacts.contact_count[w]):
                k = contacts.key[c]
                while old < end and cache.key[old] < k:
                    old += 1
                impulse = vec2(0.0, 0.0)
                color = -1
                age = 0
                if old < end and cache.key[old] == k:
                    impulse = cache.impulse[old] * scale
                    color = cache.color[old]
                    age = cache.age[old] + 1
                contacts.impulse[c] = impulse
                contacts.color[c] = color
                contacts.age[c] = age
            first_row = joints.joint_row_start[model.joint_start[w]]
            last_row = joints.joint_row_start[model.joint_start[w + 1]]
            for k in range(first_row, last_row):
                joints.joint_impulse[k] = cache.joint_impulse[k] * scale

    return {"match_contacts": match_contacts}
