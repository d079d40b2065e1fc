"""What contacts carry from step to step: impulses matched by key, and colours of the constraint graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR


def kernels(dtype: str) -> Kernels:
    """``match_contacts`` and ``color_constraints``; the arrays bring their scalar type."""
    return {"match_contacts": match_contacts, "color_constraints": color_constraints}


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
    scale = (
        motion.step_dt[w] / contacts.contact_dt[w]
        if config.start and contacts.contact_dt[w] > 0
        else motion.step_dt.dtype.type(0)
    )
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
    for j in range(model.joint_start[w], model.joint_start[w + 1]):
        joints.joint_impulse[j] = cache.joint_impulse[j] * scale


def color_constraints(
    tid: int,
    launch: Any,
    model: Any,
    state: Any,
    joints: Any,
    contacts: Any,
    rows: Any,
) -> None:
    """Greedy colours: no two constraints of a colour share a dynamic body.

    Joints first, then contacts that keep their colour, then new ones and those of the serial colour, which take the
    lowest that is free at both bodies. The serial colour blocks nobody.
    """
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    taken: dict[int, set[int]] = {b: set() for b in range(model.body_start[w], model.body_start[w + 1])}

    def take(a: int, b: int, chosen: int) -> None:
        for body in (a, b):
            if model.body_type[body] == BodyType.DYNAMIC and chosen != SERIAL_COLOR:
                taken[body].add(int(chosen))

    def lowest_free(a: int, b: int) -> int:
        return next(k for k in range(SERIAL_COLOR + 1) if k == SERIAL_COLOR or k not in taken[a] | taken[b])

    for j in range(model.joint_start[w], model.joint_start[w + 1]):
        joints.joint_color[j] = lowest_free(joints.joint_body_a[j], joints.joint_body_b[j])
        take(joints.joint_body_a[j], joints.joint_body_b[j], joints.joint_color[j])
    here = range(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    fresh = [c for c in here if contacts.color[c] < 0 or contacts.color[c] == SERIAL_COLOR]
    for c in here:
        if c not in fresh:
            take(contacts.body_a[c], contacts.body_b[c], contacts.color[c])
    for c in fresh:
        contacts.color[c] = lowest_free(contacts.body_a[c], contacts.body_b[c])
        take(contacts.body_a[c], contacts.body_b[c], contacts.color[c])
    for b, colors in taken.items():
        rows.color_mask[b] = np.uint64(sum(1 << k for k in colors))
