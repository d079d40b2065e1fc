"""What contacts carry from step to step: impulses, colours and ages, matched by key."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import Flag


def kernels(dtype: str) -> Kernels:
    """``match_contacts``; the arrays bring their scalar type."""
    return {"match_contacts": match_contacts}


def scale_of(w: int, config: Any, motion: Any, contacts: Any) -> Any:
    """What impulses of the step before are multiplied by; 0 before the first, and where settings start from zero."""
    if config.start and contacts.contact_dt[w] > 0:
        return motion.step_dt[w] / contacts.contact_dt[w]
    return motion.step_dt.dtype.type(0)


def match_contacts(
    tid: int,
    launch: Any,
    config: Any,
    model: Any,
    state: Any,
    joints: Any,
    motion: Any,
    contacts: Any,
    cache: Any,
) -> None:
    """A known key keeps impulse (scaled to the new time step), colour and age."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    start = contacts.contact_start[w]
    scale = scale_of(w, config, motion, contacts)
    place = {int(cache.key[c]): c for c in range(start, start + cache.count[w])}
    for c in range(start, start + contacts.contact_count[w]):
        old = place.get(int(contacts.key[c]))
        if old is None:
            contacts.impulse[c], contacts.color[c], contacts.age[c] = 0.0, -1, 0
        else:
            contacts.impulse[c], contacts.color[c], contacts.age[c] = (
                cache.impulse[old] * scale,
                cache.color[old],
                cache.age[old] + 1,
            )
    first_row = joints.joint_row_start[model.joint_start[w]]
    last_row = joints.joint_row_start[model.joint_start[w + 1]]
    joints.joint_impulse[first_row:last_row] = cache.joint_impulse[first_row:last_row] * scale
    if not np.isfinite(joints.joint_impulse[first_row:last_row]).all():  # bounds of the rows may hide it
        state.flags[w] = Flag.NONFINITE
