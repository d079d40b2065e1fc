"""What contacts carry from step to step: impulses matched by key, and colours of the constraint graph."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR


def kernels(dtype: str) -> Kernels:
    """``match_contacts`` and ``color_constraints``; the arrays bring their scalar type."""
    return {"match_contacts": match_contacts, "color_constraints": color_constraints}


def match_contacts(
    tid: int,
    world_offset: int,
    use_cache: int,
    flags: Array,
    step_dt: Array,
    contact_dt: Array,
    cache_count: Array,
    cache_key: Array,
    cache_impulse: Array,
    cache_color: Array,
    cache_age: Array,
    joint_start: Array,
    joint_cache: Array,
    contact_start: Array,
    contact_count: Array,
    key: Array,
    impulse: Array,
    color: Array,
    age: Array,
    joint_impulse: Array,
) -> None:
    """A known key keeps impulse (scaled to the new time step), colour and age."""
    w = tid + world_offset
    if flags[w]:
        return
    start = contact_start[w]
    scale = step_dt[w] / contact_dt[w] if use_cache and contact_dt[w] > 0 else step_dt.dtype.type(0)
    place = {int(cache_key[c]): c for c in range(start, start + cache_count[w])}
    for c in range(start, start + contact_count[w]):
        old = place.get(int(key[c]))
        if old is None:
            impulse[c], color[c], age[c] = 0.0, -1, 0
        else:
            impulse[c], color[c], age[c] = cache_impulse[old] * scale, cache_color[old], cache_age[old] + 1
    for j in range(joint_start[w], joint_start[w + 1]):
        joint_impulse[j] = joint_cache[j] * scale


def color_constraints(
    tid: int,
    world_offset: int,
    flags: Array,
    body_start: Array,
    body_type: Array,
    joint_start: Array,
    joint_body_a: Array,
    joint_body_b: Array,
    contact_start: Array,
    contact_count: Array,
    body_a: Array,
    body_b: Array,
    color_mask: Array,
    joint_color: Array,
    color: Array,
) -> None:
    """Greedy colours: no two constraints of a colour share a dynamic body.

    Joints first, then contacts that keep their colour, then new ones and those of the serial colour, which take the
    lowest that is free at both bodies. The serial colour blocks nobody.
    """
    w = tid + world_offset
    if flags[w]:
        return
    taken: dict[int, set[int]] = {b: set() for b in range(body_start[w], body_start[w + 1])}

    def take(a: int, b: int, chosen: int) -> None:
        for body in (a, b):
            if body_type[body] == BodyType.DYNAMIC and chosen != SERIAL_COLOR:
                taken[body].add(int(chosen))

    def lowest_free(a: int, b: int) -> int:
        return next(k for k in range(SERIAL_COLOR + 1) if k == SERIAL_COLOR or k not in taken[a] | taken[b])

    for j in range(joint_start[w], joint_start[w + 1]):
        joint_color[j] = lowest_free(joint_body_a[j], joint_body_b[j])
        take(joint_body_a[j], joint_body_b[j], joint_color[j])
    contacts = range(contact_start[w], contact_start[w] + contact_count[w])
    fresh = [c for c in contacts if color[c] < 0 or color[c] == SERIAL_COLOR]
    for c in contacts:
        if c not in fresh:
            take(body_a[c], body_b[c], color[c])
    for c in fresh:
        color[c] = lowest_free(body_a[c], body_b[c])
        take(body_a[c], body_b[c], color[c])
    for b, colors in taken.items():
        color_mask[b] = np.uint64(sum(1 << k for k in colors))
