"""What contacts carry of their rolling resistance from step to step, in scenes where a shape resists rolling."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.match import scale_function
from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``match_rolling`` and ``keep_rolling``; one thread a world."""
    t = group_types(dtype)
    module = kernel_module("rolling", dtype)
    scale_of = scale_function(dtype)
    contiguous = contiguous_groups(dtype)

    @wp.func_native(native_code("collide/match_rolling.h", dtype=dtype))
    def match_keys(contacts: t.Contacts, cache: t.Cache, scale: t.real, i0: wp.int32, i1: wp.int32, end: wp.int32): ...

    @wp.kernel(module=module, enable_backward=False)
    def match_rolling(
        launch: t.Launch, config: t.Config, state: t.State, motion: t.Motion, contacts: t.Contacts, cache: t.Cache
    ):
        """Merge of two sorted lists: a known key keeps its impulse of rolling resistance, scaled to the time step."""
        w = wp.tid() + launch.world_offset
        contiguous(state)
        contiguous(motion)
        contiguous(contacts)
        contiguous(cache)
        if state.flags[w] != 0:
            return
        scale = scale_of(w, config, motion, contacts)
        start = contacts.contact_start[w]
        match_keys(contacts, cache, scale, start, start + contacts.contact_count[w], start + cache.count[w])

    @wp.kernel(module=module, enable_backward=False)
    def keep_rolling(launch: t.Launch, state: t.State, contacts: t.Contacts, cache: t.Cache):
        """Impulses of rolling resistance into the cache, beside what ``commit`` has put there."""
        w = wp.tid() + launch.world_offset
        contiguous(state)
        contiguous(contacts)
        contiguous(cache)
        if state.flags[w] != 0:
            return
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            cache.rolling_impulse[c] = contacts.rolling_impulse[c]

    return {"match_rolling": match_rolling, "keep_rolling": keep_rolling}
