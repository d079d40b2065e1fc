"""What contacts carry from step to step: impulses, colours and ages, matched by key."""

from collections.abc import Callable
from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.enums import Flag

NONFINITE = wp.constant(int(Flag.NONFINITE))


@cache
def scale_function(dtype: str) -> Callable[..., Any]:
    """``scale_of`` a world's impulses of the step before, as this step starts from them."""
    t = group_types(dtype)
    real = t.real

    @wp.func(module=kernel_module("match", dtype))
    def scale_of(w: int, config: t.Config, motion: t.Motion, contacts: t.Contacts):
        """The ratio of the time steps; 0 before the first step, and where the settings start from zero."""
        scale = real(0.0)
        if config.start != 0 and contacts.contact_dt[w] > real(0.0):
            scale = motion.step_dt[w] / contacts.contact_dt[w]
        return scale

    return scale_of


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_contacts``; one thread a world."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("match", dtype)
    scale_of = scale_function(dtype)
    contiguous = contiguous_groups(dtype)

    @wp.func_native(ranges_code(dtype, "collide/match.h"))
    def match_keys(
        contacts: t.Contacts,
        cache: t.Cache,
        scale: real,
        i0: wp.int32,
        i1: wp.int32,
        end: wp.int32,
        team: wp.uint64,
    ): ...

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
        scale = scale_of(w, config, motion, contacts)
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        match_keys(contacts, cache, scale, start, end, start + cache.count[w], launch.team)
        joint = model.joint_start[w]
        last_joint = model.joint_start[w + 1]
        if joint < last_joint:  # two loads less in a world without joints
            check = real(0.0)  # x - x is 0 for a finite x, NaN for inf and NaN; bounds of the rows may hide both
            for k in range(joints.joint_row_start[joint], joints.joint_row_start[last_joint]):
                x = cache.joint_impulse[k] * scale
                joints.joint_impulse[k] = x
                check += x - x
            if check != real(0.0):
                state.flags[w] = NONFINITE

    return {"match_contacts": match_contacts}
