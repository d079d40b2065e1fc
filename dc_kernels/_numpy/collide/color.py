"""Colours of the graph of contacts and joints: no two constraints of a colour share a dynamic body."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR


def kernels(dtype: str) -> Kernels:
    """``color_constraints`` and ``keep_colors``; the arrays bring their scalar type."""
    return {"color_constraints": color_constraints, "keep_colors": keep_colors}


class Taken:
    """Colours taken at the bodies of a world: only dynamic ones forbid any, and the serial colour blocks nobody."""

    def __init__(self, w: int, model: Any) -> None:
        self.colors: dict[int, set[int]] = {b: set() for b in range(model.body_start[w], model.body_start[w + 1])}
        self._dynamic = model.body_type == BodyType.DYNAMIC

    def take(self, a: int, b: int, chosen: int) -> None:
        """Take a colour at two bodies."""
        for body in (a, b):
            if self._dynamic[body] and chosen != SERIAL_COLOR:
                self.colors[body].add(int(chosen))

    def at(self, a: int, b: int) -> set[int]:
        """Colours taken at either of two bodies."""
        return self.colors[a] | self.colors[b]

    def lowest_free(self, a: int, b: int) -> int:
        """The lowest colour that is free at two bodies, or the serial one."""
        return next(k for k in range(SERIAL_COLOR + 1) if k == SERIAL_COLOR or k not in self.at(a, b))


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

    Joints and a caller's own rows first, then contacts that keep their colour, then new ones and those of the serial
    colour, which take the lowest that is free at both bodies. The serial colour blocks nobody.
    """
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    taken = Taken(w, model)
    for j in range(rows.line_start[w], rows.line_start[w + 1]):
        joints.joint_color[j] = taken.lowest_free(joints.joint_body_a[j], joints.joint_body_b[j])
        taken.take(joints.joint_body_a[j], joints.joint_body_b[j], joints.joint_color[j])
    for k in range(rows.row_start[w], rows.row_start[w + 1]):
        rows.row_color[k] = taken.lowest_free(rows.row_body_a[k], rows.row_body_b[k])
        taken.take(rows.row_body_a[k], rows.row_body_b[k], rows.row_color[k])
    here = range(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    fresh = [c for c in here if contacts.color[c] < 0 or contacts.color[c] == SERIAL_COLOR]
    for c in here:
        if c not in fresh:
            taken.take(contacts.body_a[c], contacts.body_b[c], contacts.color[c])
    for c in fresh:
        contacts.color[c] = taken.lowest_free(contacts.body_a[c], contacts.body_b[c])
        taken.take(contacts.body_a[c], contacts.body_b[c], contacts.color[c])
    for b, colors in taken.colors.items():
        rows.color_mask[b] = np.uint64(sum(1 << k for k in colors))


def keep_colors(
    tid: int,
    launch: Any,
    model: Any,
    state: Any,
    joints: Any,
    contacts: Any,
    rows: Any,
) -> None:
    """Contacts lose a colour that is none, or that a joint or an earlier contact of one of their bodies has too."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    taken = Taken(w, model)
    for j in range(rows.line_start[w], rows.line_start[w + 1]):
        a, b = joints.joint_body_a[j], joints.joint_body_b[j]
        taken.take(a, b, taken.lowest_free(a, b))
    for k in range(rows.row_start[w], rows.row_start[w + 1]):
        a, b = rows.row_body_a[k], rows.row_body_b[k]
        taken.take(a, b, taken.lowest_free(a, b))
    for c in range(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w]):
        a, b, kept = contacts.body_a[c], contacts.body_b[c], contacts.color[c]
        if not 0 <= kept < SERIAL_COLOR or kept in taken.at(a, b):
            contacts.color[c] = -1
        else:
            taken.take(a, b, kept)
