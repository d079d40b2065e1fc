"""Contact events: which pairs of shapes touch, and what a step has changed of that."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np

from dc_kernels._numpy.collide.approach import approach_of
from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.events.lists import compare, passes, read, write
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS


def kernels(dtype: str) -> Kernels:
    """``note_touches``; the arrays bring their scalar type."""
    return {"note_touches": note_touches}


def note_touches(tid: int, launch: Any, config: Any, model: Any, state: Any, contacts: Any, touches: Any) -> None:
    """Merge a world's contacts with the pairs that touched before, and list what has begun, ended and hit."""
    w = tid + launch.world_offset
    if passes(w, state, touches):
        touches.begun_count[w] = touches.ended_count[w] = touches.hit_count[w] = 0
        return
    start, shape0 = contacts.contact_start[w], model.shape_start[w]
    known = {pair: start + i for i, pair in enumerate(read(touches, "", w, start))}
    earlier = {name: getattr(touches, name).copy() for name in ("speed", "blow", "point", "normal")}
    found = []
    used = range(start, start + contacts.contact_count[w])
    for pair, group in groupby(used, lambda c: int(contacts.key[c]) >> KEY_FEATURE_BITS):
        mine = list(group)
        a, b = int(shape0 + (pair >> KEY_SHAPE_BITS)), int(shape0 + (pair & (2**KEY_SHAPE_BITS - 1)))
        mine = [c for c in mine if contacts.color[c] >= 0]  # that are not off
        presses = (contacts.impulse[mine, 0] != 0).any() or (contacts.gap[mine] < 0).any()
        if not mine or (not presses and (a, b) not in known):
            continue
        speed, fastest = contacts.gap.dtype.type(0), mine[0]
        for c in mine:
            if contacts.impulse[c, 0] > 0 and approach_of(c, state, contacts) > speed:
                speed, fastest = approach_of(c, state, contacts), c
        point = state.position[contacts.body_a[fastest]] + contacts.arm_a[fastest]
        slot, normal = start + len(found), contacts.normal[fastest]
        old = known.get((a, b))
        # a gap that closes within a step lets an impact take two: the second one is no other hit
        goes_on = old is not None and earlier["speed"][old] > config.hit_speed
        blow = speed if speed > config.hit_speed and not goes_on else 0.0
        if old is not None and touches.part[w] > 0 and earlier["blow"][old] >= blow:
            blow, point, normal = (earlier[name][old] for name in ("blow", "point", "normal"))
        touches.impulse[slot], touches.speed[slot] = contacts.impulse[mine, 0].sum(), speed
        touches.blow[slot], touches.point[slot], touches.normal[slot] = blow, point, normal
        found.append((a, b))
    write(touches, "", w, start, found)
    hit = [start + i for i in range(len(found)) if touches.blow[start + i] > 0]
    write(touches, "hit_", w, start, [found[i - start] for i in hit])
    for name, source in (("speed", "blow"), ("point", "point"), ("normal", "normal")):
        getattr(touches, f"hit_{name}")[start : start + len(hit)] = getattr(touches, source)[np.array(hit, np.int64)]
    compare(touches, w, start)
