"""What contacts carry from step to step: impulses, colours and ages, matched by key."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.model.enums import Flag

AT_ONCE = 8
NONFINITE = int(Flag.NONFINITE)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_contacts``; one thread a world."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2

    @ti.func
    def common(c, old, most, contacts: t.Contacts, cache: t.Cache):
        """How many of the keys from c on are those from ``old`` on in the cache."""
        run = 0
        differ = ti.i64(0)
        while differ == 0 and run + AT_ONCE <= most:  # without a branch for each key
            for i in ti.static(range(AT_ONCE)):
                differ = differ | (contacts.key[c + run + i] ^ cache.key[old + run + i])
            if differ == 0:
                run += AT_ONCE
        while run < most and contacts.key[c + run] == cache.key[old + run]:
            run += 1
        return run

    @ti.func
    def match_keys(first, last, end, scale, contacts: t.Contacts, cache: t.Cache):
        """What the contacts ``first`` .. ``last`` carry from the cached ones ``first`` .. ``end``: see the kernel.

        Contacts that go on stand in runs.
        """
        c = first
        old = first
        while c < last:
            run = common(c, old, ti.min(last - c, end - old), contacts, cache)
            for i in range(run):
                contacts.impulse[c + i] = cache.impulse[old + i] * scale
                contacts.color[c + i] = cache.color[old + i]
                contacts.age[c + i] = cache.age[old + i] + 1
            c += run
            old += run
            if c < last:
                while old < end and cache.key[old] < contacts.key[c]:
                    old += 1
                if not (old < end and cache.key[old] == contacts.key[c]):
                    contacts.impulse[c] = vec2(0.0, 0.0)
                    contacts.color[c] = -1
                    contacts.age[c] = 0
                    c += 1

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
            match_keys(start, start + contacts.contact_count[w], start + cache.count[w], scale, contacts, cache)
            first_row = joints.joint_row_start[model.joint_start[w]]
            last_row = joints.joint_row_start[model.joint_start[w + 1]]
            check = real(0.0)  # x - x is 0 for a finite x, NaN for inf and NaN; bounds of the rows may hide both
            for k in range(first_row, last_row):
                x = cache.joint_impulse[k] * scale
                joints.joint_impulse[k] = x
                check += x - x
            if not (check == 0.0):
                state.flags[w] = NONFINITE

    return {"match_contacts": match_contacts}
