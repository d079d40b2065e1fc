"""Waking: what a user's writes, or something that moves, rouses, with all that it touches."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.sleep.islands import (
    bodies_of,
    fields_of,
    is_other,
    is_other_joint,
    islands,
    joints_of,
    moves,
    see_body,
    see_joint,
    sleeps,
)
from dc_kernels.model.enums import BodyType, Flag, Rest
from dc_kernels.sleep.sleepers import MARK


def kernels(dtype: str, rolls: bool = False) -> Kernels:
    """What phases begin and end with, and what finds in ``collide`` who wakes; the arrays bring their scalar type."""
    return {
        "notice_writes": notice_writes,
        "enter_worlds": enter_worlds,
        "leave_worlds": leave_worlds,
        "mark_sleepers": mark_sleepers,
        "wake_touched": wake_touched,
        "admit_worlds": admit_worlds,
    }


def notice_writes(tid: int, launch: Any, model: Any, state: Any, joints: Any, contacts: Any, sleepers: Any) -> None:
    """Rouse sleepers that were moved or pushed by hand, whose joints or gravity changed, or that lose a support."""
    w = tid + launch.world_offset
    if not sleepers.sleeping[w]:
        return
    falls = (sleepers.gravity[w] != model.gravity[w]).any()
    changed = [j for j in joints_of(w, model) if is_other_joint(j, joints, sleepers)]
    moved, disturbed = set(), bool(changed)
    for b in bodies_of(w, model):
        if model.body_type[b] != BodyType.DYNAMIC:
            if is_other(b, ("position", "angle"), state, sleepers):
                sleepers.asleep[b] = Rest.ROUSED
                moved.add(b)
            disturbed |= moves(b, model, state)
            see_body(b, state, sleepers)
        elif sleepers.asleep[b] != Rest.AWAKE:
            pushed = state.velocity[b].any() or state.angular_velocity[b] != 0
            pushed |= is_other(b, ("position", "angle", "force", "torque"), state, sleepers)
            if is_other(b, ("position", "angle"), state, sleepers):
                moved.add(b)
            if falls or pushed or sleepers.asleep[b] == Rest.ROUSED:
                sleepers.asleep[b] = Rest.ROUSED
                disturbed = True
    for j in changed:
        see_joint(j, joints, sleepers)
        for body in (joints.joint_body_a[j], joints.joint_body_b[j]):
            if sleeps(body, model, sleepers):
                sleepers.asleep[body] = Rest.ROUSED
    sleepers.gravity[w] = model.gravity[w]
    start = contacts.contact_start[w]
    links = [(sleepers.body_a[c], sleepers.body_b[c]) for c in range(start, start + sleepers.count[w])]
    links += [(joints.joint_body_a[j], joints.joint_body_b[j]) for j in joints_of(w, model)]
    for a, b in [] if sleepers.dormant[w] else links[: sleepers.count[w]]:
        for other, body in ((a, b), (b, a)):
            awake = model.body_type[other] == BodyType.DYNAMIC and sleepers.asleep[other] == Rest.AWAKE
            if awake and sleepers.asleep[body] == Rest.ASLEEP:
                sleepers.asleep[body] = Rest.ROUSED
    for a, b in links if moved else []:
        for support, body in ((a, b), (b, a)):
            if sleepers.asleep[support] == Rest.ROUSED and sleeps(body, model, sleepers):
                sleepers.asleep[body] = Rest.ROUSED
    held = {body for link in links for body in link}
    for body in bodies_of(w, model) if moved else []:
        if body not in held and sleeps(body, model, sleepers):
            sleepers.asleep[body] = Rest.ROUSED
    if disturbed or moved:
        sleepers.dormant[w] = 0


def enter_worlds(tid: int, launch: Any, state: Any, stats: Any, sleepers: Any) -> None:
    """Let the stages of a phase pass over dormant worlds."""
    w = tid + launch.world_offset
    if sleepers.dormant[w] and not state.flags[w]:
        state.flags[w] = Flag.ASLEEP
        stats.sweeps[w] = stats.change[w] = stats.residual[w] = 0
        stats.iteration[w].finished = 1
    elif not sleepers.dormant[w] and state.flags[w] == Flag.ASLEEP:
        state.flags[w] = 0


def leave_worlds(tid: int, launch: Any, state: Any) -> None:
    """End of a phase: dormant worlds have no flag to be seen."""
    w = tid + launch.world_offset
    if state.flags[w] == Flag.ASLEEP:
        state.flags[w] = 0


def wake_islands(w: int, model: Any, joints: Any, pairs: Any, contacts: Any, sleepers: Any) -> None:
    """Wake what is roused, and what sleeps and touches it, is joined to it or near it, over any number."""
    used = range(pairs.start[w], pairs.start[w] + pairs.count[w])
    links = [(model.shape_body[pairs.shape_a[k]], model.shape_body[pairs.shape_b[k]]) for k in used]
    kept = range(contacts.contact_start[w], contacts.contact_start[w] + sleepers.count[w])
    links += [(sleepers.body_a[c], sleepers.body_b[c]) for c in kept]
    links += [(joints.joint_body_a[j], joints.joint_body_b[j]) for j in joints_of(w, model)]
    asleep = [b for b in bodies_of(w, model) if sleeps(b, model, sleepers)]
    both = (link for link in links if all(sleeps(body, model, sleepers) for body in link))
    for island in islands(asleep, both):
        members = sorted(island)
        if (sleepers.asleep[members] == Rest.ROUSED).any():
            sleepers.asleep[members] = Rest.AWAKE
            sleepers.rest_time[members] = 0
            sleepers.sleeping[w] -= len(members)


def mark_sleepers(
    tid: int, launch: Any, model: Any, state: Any, joints: Any, motion: Any, pairs: Any, contacts: Any, sleepers: Any
) -> None:
    """Wake what is roused; tell the narrowphase which bodies sleep, so that it passes over pairs of them."""
    w = tid + launch.world_offset
    if state.flags[w] or not sleepers.sleeping[w]:
        return

    def awake(body: int) -> bool:
        dynamic = model.body_type[body] == BodyType.DYNAMIC and sleepers.asleep[body] == Rest.AWAKE
        return dynamic or moves(body, model, state)

    for j in joints_of(w, model):
        a, b = joints.joint_body_a[j], joints.joint_body_b[j]
        for body, other in ((a, b), (b, a)):
            if sleepers.asleep[body] == Rest.ASLEEP and awake(other):
                sleepers.asleep[body] = Rest.ROUSED
    wake_islands(w, model, joints, pairs, contacts, sleepers)
    if not sleepers.sleeping[w]:
        return
    for b in bodies_of(w, model):
        if model.body_type[b] == BodyType.DYNAMIC:
            if sleepers.asleep[b] == Rest.ASLEEP:
                motion.solved[b] = motion.predicted[b]  # what it moves by if it wakes
                motion.predicted[b] = [0, 0, 0, -MARK]
        elif sleepers.asleep[b] == Rest.ROUSED or moves(b, model, state):
            motion.predicted[b, 3] = 2.0 * MARK


def wake_touched(
    tid: int, launch: Any, model: Any, state: Any, joints: Any, motion: Any, pairs: Any, contacts: Any, sleepers: Any
) -> None:
    """Wake what something touches that moves; the narrowphase is run anew only for a world where there is such."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    if not sleepers.sleeping[w]:
        state.flags[w] = Flag.ASLEEP
        return
    used = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    touched = {b for b in (*contacts.body_a[used], *contacts.body_b[used]) if sleeps(b, model, sleepers)}
    if touched:
        sleepers.asleep[list(touched)] = Rest.ROUSED
        wake_islands(w, model, joints, pairs, contacts, sleepers)
    else:
        state.flags[w] = Flag.ASLEEP
    for b in bodies_of(w, model):
        if model.body_type[b] != BodyType.DYNAMIC:
            sleepers.asleep[b] = Rest.AWAKE
            motion.predicted[b, 3] = 0
        elif motion.predicted[b, 3] < 0 and sleepers.asleep[b] == Rest.AWAKE:
            motion.predicted[b] = motion.solved[b]


def admit_worlds(tid: int, launch: Any, state: Any, contacts: Any, rows: Any, sleepers: Any) -> None:
    """Go on with all worlds that are not dormant; those need room for the contacts of sleepers, too."""
    w = tid + launch.world_offset
    if state.flags[w] == Flag.ASLEEP and not sleepers.dormant[w]:
        state.flags[w] = 0
    if state.flags[w] or not sleepers.count[w]:
        return
    start = contacts.contact_start[w]
    kept = np.arange(start, start + sleepers.count[w])
    bodies = np.stack([sleepers.body_a[kept], sleepers.body_b[kept]])
    kept = kept[(sleepers.asleep[bodies] == Rest.ASLEEP).any(axis=0)]
    for name in fields_of(sleepers):
        array = getattr(sleepers, name)
        array[start : start + len(kept)] = array[kept]
    sleepers.count[w] = len(kept)
    rows.contact_needed[w] += len(kept)
    if rows.contact_needed[w] > contacts.contact_start[w + 1] - start:
        state.flags[w] = Flag.CONTACT_OVERFLOW
        contacts.contact_count[w] = 0
