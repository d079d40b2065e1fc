"""Colours of the graph of contacts and joints: no two constraints of a colour share a dynamic body."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR


def kernels(dtype: str) -> Kernels:
    """``color_constraints``; the arrays bring their scalar type."""
    return {"color_constraints": color_constraints}


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
