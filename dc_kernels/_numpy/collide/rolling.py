"""What contacts carry of their rolling resistance from step to step, in scenes where a shape resists rolling."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.collide.match import scale_of
from dc_kernels._numpy.common import Kernels


def kernels(dtype: str) -> Kernels:
    """``match_rolling`` and ``keep_rolling``; the arrays bring their scalar type."""
    return {"match_rolling": match_rolling, "keep_rolling": keep_rolling}


def match_rolling(tid: int, launch: Any, config: Any, state: Any, motion: Any, contacts: Any, cache: Any) -> None:
    """A known key keeps its impulse of rolling resistance, scaled to the new time step."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    start, scale = contacts.contact_start[w], scale_of(w, config, motion, contacts)
    used, known = (slice(start, start + count) for count in (contacts.contact_count[w], cache.count[w]))
    contacts.rolling_impulse[used] = 0
    _, now, before = np.intersect1d(contacts.key[used], cache.key[known], assume_unique=True, return_indices=True)
    contacts.rolling_impulse[start + now] = cache.rolling_impulse[start + before] * scale


def keep_rolling(tid: int, launch: Any, state: Any, contacts: Any, cache: Any) -> None:
    """Impulses of rolling resistance into the cache, beside what ``commit`` has put there."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    used = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    cache.rolling_impulse[used] = contacts.rolling_impulse[used]
