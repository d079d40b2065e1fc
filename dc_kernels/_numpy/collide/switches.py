"""Contacts that do not act: apart from the others while a step is made, and back among them at its end."""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np

from dc_kernels._numpy.collide.approach import approach_of
from dc_kernels._numpy.common import Array, Kernels, dot, rotate, rotation
from dc_kernels.collide.switches import ASIDE, SLOPS
from dc_kernels.model.enums import ShapeRole
from dc_kernels.model.fields import CONTACTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS

FIELDS = tuple(name for name, field in CONTACTS.items() if field.per == "contact")
"""Fields of a contact that is kept apart; one that is off has no impulse, also of its rolling resistance."""


def kernels(dtype: str, rolls: bool = False) -> Kernels:
    """``screen_contacts``, ``show_switched``, and ``switch_contacts``; the arrays bring their scalar type."""
    return {"screen_contacts": screen_contacts, "switch_contacts": switch_contacts, "show_switched": show_switched}


def holds(s: int, o: int, normal: Array, gap: Any, approach: Any, slop: Any, deep: Any, model: Any, state: Any) -> bool:
    """Whether a shape holds another one that it did not hold in the step before (see ``collide/switches.py``)."""
    role, body, other = model.shape_role[s], model.shape_body[s], model.shape_body[o]
    turn = rotation(state.angle[body])
    if role == ShapeRole.ONE_WAY:
        way = model.shape_one_way[s]
        side = dot(normal, rotate(turn, np.array([np.cos(way), np.sin(way)])))
        return bool(side > ASIDE and (gap >= -slop or (gap >= -deep and approach >= 0)))
    if role == ShapeRole.ONE_SIDED:
        first = model.vertex_start[s]
        front = rotate(turn, model.vertex_normals[first])
        centre = rotate(rotation(state.angle[other]), model.shape_center[o])
        reach = state.position[other] - state.position[body] + centre - rotate(turn, model.vertices[first])
        return bool(dot(front, reach) >= 0 and dot(front, normal) > 0 and (gap >= -slop or approach >= 0))
    return True


def part(w: int, on: list[int], off: list[int], contacts: Any, rows: Any, switches: Any) -> None:
    """Let some contacts of a world act, and add the others to those that are off; both are in order."""
    start = contacts.contact_start[w]
    for name in FIELDS:
        array, aside = getattr(contacts, name), getattr(switches, name)
        kept = np.concatenate([aside[start : start + switches.count[w]], array[off]])
        aside[start : start + len(kept)] = kept
        array[start : start + len(on)] = array[on].copy()
    for array in (rows.surface_speed, contacts.rolling_impulse):
        if len(array):
            array[start : start + len(on)] = array[on].copy()
    contacts.contact_count[w] = len(on)
    switches.count[w] += len(off)
    all_off = slice(start, start + switches.count[w])
    order = np.argsort(switches.key[all_off], kind="stable")
    for name in FIELDS:
        getattr(switches, name)[all_off] = getattr(switches, name)[all_off][order]
    switches.impulse[all_off] = 0
    switches.color[all_off] = -1
    switches.enabled[start : start + len(on)] = 1


def screen_contacts(
    tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, contacts: Any, rows: Any, switches: Any
) -> None:
    """Move the contacts of a world that do not hold to those that are off, pair by pair; let all others act."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    slop = SLOPS * config.slop * model.length_scale[w]
    deep = max(slop, motion.reach[w])
    start = contacts.contact_start[w]
    on: list[int] = []
    off: list[int] = []
    used = range(start, start + contacts.contact_count[w])
    for pair, group in groupby(used, lambda c: int(contacts.key[c]) >> KEY_FEATURE_BITS):
        mine = list(group)
        shapes = [int(model.shape_start[w]) + k for k in (pair >> KEY_SHAPE_BITS, pair & (2**KEY_SHAPE_BITS - 1))]
        held = bool((contacts.color[mine] >= 0).any()) or not len(model.shape_role)
        if not held:
            c = mine[int(contacts.gap[mine].argmin())]
            more = (contacts.gap[c], approach_of(c, state, contacts), slop, deep, model, state)
            normal = contacts.normal[c]
            held = holds(*shapes, normal, *more) and holds(*shapes[::-1], -normal, *more)
        (on if held else off).extend(mine)
        if len(rows.surface_speed):
            rows.surface_speed[mine] = model.shape_surface_speed[shapes].sum()
    switches.count[w] = 0
    part(w, on, off, contacts, rows, switches)


def switch_contacts(tid: int, launch: Any, state: Any, contacts: Any, rows: Any, switches: Any) -> None:
    """Move the contacts of a world that are not ``enabled`` to those that are off."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    start = contacts.contact_start[w]
    used = np.arange(start, start + contacts.contact_count[w])
    on = switches.enabled[used] != 0
    part(w, used[on].tolist(), used[~on].tolist(), contacts, rows, switches)


def show_switched(tid: int, launch: Any, state: Any, contacts: Any, switches: Any) -> None:
    """Put the contacts of a world that are off among those of the step, by key."""
    w = tid + launch.world_offset
    if state.flags[w] or not switches.count[w]:
        return
    start, found = contacts.contact_start[w], contacts.contact_count[w]
    off = slice(start, start + switches.count[w])
    order = np.argsort(np.concatenate([contacts.key[start : start + found], switches.key[off]]))
    for name in FIELDS:
        array = getattr(contacts, name)
        merged = np.concatenate([array[start : start + found], getattr(switches, name)[off]])[order]
        array[start : start + len(merged)] = merged
    if len(contacts.rolling_impulse):
        rolling = contacts.rolling_impulse[start : start + found]
        merged = np.concatenate([rolling, np.zeros(switches.count[w], rolling.dtype)])[order]
        contacts.rolling_impulse[start : start + len(merged)] = merged
    contacts.contact_count[w] = found + switches.count[w]
    switches.count[w] = 0
