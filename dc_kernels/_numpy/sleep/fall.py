"""Falling asleep: how long bodies have been at rest, islands of them, and the contacts that they keep."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.sleep.islands import bodies_of, fields_of, islands, joints_of, moves, see_body, see_joint
from dc_kernels.model.enums import BodyType, Flag, Rest
from dc_kernels.sleep.sleepers import LOOK_EVERY


def kernels(dtype: str, rolls: bool = False) -> Kernels:
    """``show_sleepers``, ``rest``, ``fall_asleep`` and ``lay_down``; the arrays bring their scalar type."""
    return {"show_sleepers": show_sleepers, "rest": rest, "fall_asleep": fall_asleep, "lay_down": lay_down}


def lay(w: int, model: Any, state: Any, joints: Any, contacts: Any, sleepers: Any) -> None:
    """Lay down the bodies of a world that fall asleep, and keep the contacts of all that sleep."""
    sleeping = others = 0
    for b in bodies_of(w, model):
        if model.body_type[b] != BodyType.DYNAMIC:
            sleepers.asleep[b] = Rest.AWAKE
            see_body(b, state, sleepers)
            others += moves(b, model, state)
        elif sleepers.asleep[b] == Rest.AWAKE:
            others += 1
        else:
            sleeping += 1
            if sleepers.asleep[b] == Rest.FALLING:
                sleepers.asleep[b] = Rest.ASLEEP
                state.position[b] += 0.0  # 0 instead of -0, as later steps would make it
                state.angle[b] += 0.0
                state.velocity[b] = state.angular_velocity[b] = 0
                see_body(b, state, sleepers)
    for j in joints_of(w, model):
        see_joint(j, joints, sleepers)
    sleepers.gravity[w] = model.gravity[w]
    start = contacts.contact_start[w]
    used = np.arange(start, start + contacts.contact_count[w])
    bodies = np.stack([contacts.body_a[used], contacts.body_b[used]])
    kept = used[(sleepers.asleep[bodies] == Rest.ASLEEP).any(axis=0)]
    for name in fields_of(contacts):
        getattr(sleepers, name)[start : start + len(kept)] = getattr(contacts, name)[kept]
    sleepers.count[w] = len(kept)
    sleepers.sleeping[w] = sleeping
    sleepers.dormant[w] = sleeping > 0 and others == 0


def show_sleepers(tid: int, launch: Any, state: Any, motion: Any, contacts: Any, sleepers: Any) -> None:
    """Put the contacts of sleepers among those of the step, by key; impulses are scaled to its time step."""
    w = tid + launch.world_offset
    if state.flags[w] or not sleepers.count[w]:
        return
    start = contacts.contact_start[w]
    kept = slice(start, start + sleepers.count[w])
    if contacts.contact_dt[w] > 0:
        for impulse in (sleepers.impulse, sleepers.rolling_impulse):
            impulse[kept] *= motion.step_dt[w] / contacts.contact_dt[w]
    found = slice(start, start + contacts.contact_count[w])
    order = np.argsort(np.concatenate([contacts.key[found], sleepers.key[kept]]), kind="stable")
    for name in fields_of(contacts):
        both = np.concatenate([getattr(contacts, name)[found], getattr(sleepers, name)[kept]])
        getattr(contacts, name)[start : start + len(order)] = both[order]
    contacts.contact_count[w] = len(order)


def rest(tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, sleepers: Any) -> None:
    """End of a step: for how long bodies have rested; whether to look for islands; dormant worlds age."""
    w = tid + launch.world_offset
    dt = motion.step_dt[w]
    if state.flags[w] == Flag.ASLEEP:
        state.flags[w] = 0
        state.time[w] += float(dt)
        return
    if state.flags[w]:
        return
    size, g = model.length_scale[w], _gravity(w, model)
    slow = config.sleep_speed * config.sleep_speed * g * size
    awake = _awake(w, model, sleepers)
    for b in awake:
        rim = dt.dtype.type(0.5) * size * state.angular_velocity[b]
        at_rest = (state.velocity[b] ** 2).sum() <= slow and rim * rim <= slow
        sleepers.rest_time[b] = sleepers.rest_time[b] + dt if at_rest else 0
    moving = [b for b in bodies_of(w, model) if moves(b, model, state)]
    sleepers.position[moving], sleepers.angle[moving] = state.position[moving], state.angle[moving]
    if not awake and not moving and sleepers.sleeping[w]:
        sleepers.dormant[w] = 1
    sleepers.waited[w] = min(sleepers.waited[w] + 1, LOOK_EVERY)
    longest = sleepers.rest_time[awake].max(initial=0)
    if sleepers.waited[w] == LOOK_EVERY and _is_enough(longest, w, config, model):
        sleepers.waited[w] = LOOK_EVERY + 1


def fall_asleep(
    tid: int, launch: Any, config: Any, model: Any, state: Any, joints: Any, contacts: Any, sleepers: Any
) -> None:
    """Let islands of bodies that have come to rest fall asleep."""
    w = tid + launch.world_offset
    if sleepers.waited[w] <= LOOK_EVERY:
        return
    sleepers.waited[w] = 0
    awake = _awake(w, model, sleepers)
    moving = [b for b in bodies_of(w, model) if moves(b, model, state)]
    used = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    links = list(zip(contacts.body_a[used], contacts.body_b[used]))
    links += [(joints.joint_body_a[j], joints.joint_body_b[j]) for j in joints_of(w, model)]
    carried = {b for link in links for b, other in (link, link[::-1]) if other in moving}
    both = (link for link in links if (model.body_type[list(link)] == BodyType.DYNAMIC).all())
    asleep = [b for b in bodies_of(w, model) if sleepers.asleep[b]]
    falling = False
    for island in islands([*awake, *asleep], both):
        members = sorted(island & set(awake))
        if members and not carried & island and _is_enough(sleepers.rest_time[members], w, config, model):
            sleepers.asleep[members] = Rest.FALLING
            falling = True
    if falling:
        lay(w, model, state, joints, contacts, sleepers)


def lay_down(tid: int, launch: Any, model: Any, state: Any, joints: Any, contacts: Any, sleepers: Any) -> None:
    """Lay down the bodies that fall asleep because a user wants so."""
    lay(tid + launch.world_offset, model, state, joints, contacts, sleepers)


def _awake(w: int, model: Any, sleepers: Any) -> list[int]:
    """The dynamic bodies of a world that are awake."""
    return [b for b in bodies_of(w, model) if model.body_type[b] == BodyType.DYNAMIC and not sleepers.asleep[b]]


def _gravity(w: int, model: Any) -> Any:
    return np.sqrt((model.gravity[w] ** 2).sum())


def _is_enough(time: Any, w: int, config: Any, model: Any) -> bool:
    """Whether bodies that have rested for these times may sleep: for ``sleep_time`` sqrt(size / g), g not 0."""
    least, g = config.sleep_time * config.sleep_time * model.length_scale[w], _gravity(w, model)
    return bool(g > 0 and (time * time * g >= least).all())
