"""Waking: what a user's writes, or something that moves, rouses, with all that it touches; one thread a world."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.sleep.islands import ASLEEP, AWAKE, DYNAMIC, ROUSED, differ, island_functions, join, root_of
from dc_kernels.model.enums import Flag
from dc_kernels.sleep.sleepers import MARK

PASSED_OVER = wp.constant(int(Flag.ASLEEP))
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))
SLEEPER_MARK = wp.constant(-MARK)  # in place of the inverse mass of a body that sleeps
MOVER_MARK = wp.constant(2.0 * MARK)  # in place of the zero of one that moves all the same


@cache
def kernels(dtype: str, rolls: bool = False) -> dict[str, Any]:
    """What phases begin and end with, and what finds in ``collide`` who wakes; ``rolls``: contacts resist rolling."""
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    module = kernel_module("sleep", dtype, *(["rolls"] if rolls else []))
    contiguous = contiguous_groups(dtype)
    functions = island_functions(dtype)
    sleeps, moves, is_other_place = functions.sleeps, functions.moves, functions.is_other_place
    see_body, see_joint, is_other_joint = functions.see_body, functions.see_joint, functions.is_other_joint

    @wp.func_native(native_code("sleep/disturbed.h", dtype=dtype))
    def disturbed(state: t.State, sleepers: t.Sleepers, b0: wp.int32, b1: wp.int32) -> wp.int32: ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=rolls))
    def move_kept(source: t.Sleepers, i: wp.int32, target: t.Sleepers, k: wp.int32): ...

    @wp.func(module=module)
    def is_awake(body: int, model: t.Model, state: t.State, sleepers: t.Sleepers):
        """Whether a body may move in this step."""
        dynamic = model.body_type[body] == DYNAMIC and sleepers.asleep[body] == AWAKE
        return dynamic or moves(body, model, state)

    @wp.func(module=module)
    def wake_islands(
        w: int, model: t.Model, joints: t.Joints, pairs: t.Pairs, contacts: t.Contacts, sleepers: t.Sleepers
    ):
        """Wake what is roused, and what sleeps and touches it, is joined to it or near it, over any number.

        Near are the candidates of this step, a function of the state: pairs that are kept depend on when they were
        found, and so on the room of all worlds.
        """
        first = model.body_start[w]
        last = model.body_start[w + 1]
        for b in range(first, last):
            sleepers.parent[b] = b
            sleepers.island_time[b] = real(0.0)
        for pair in range(pairs.start[w], pairs.start[w] + pairs.count[w]):
            a = model.shape_body[pairs.shape_a[pair]]
            b = model.shape_body[pairs.shape_b[pair]]
            if sleeps(a, model, sleepers) and sleeps(b, model, sleepers):
                join(sleepers.parent, a, b)
        start = contacts.contact_start[w]
        for c in range(start, start + sleepers.count[w]):
            a = sleepers.body_a[c]
            b = sleepers.body_b[c]
            if sleeps(a, model, sleepers) and sleeps(b, model, sleepers):
                join(sleepers.parent, a, b)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            if sleeps(a, model, sleepers) and sleeps(b, model, sleepers):
                join(sleepers.parent, a, b)
        for b in range(first, last):
            if sleepers.asleep[b] == ROUSED and model.body_type[b] == DYNAMIC:
                sleepers.island_time[root_of(sleepers.parent, b)] = real(1.0)
        for b in range(first, last):
            if sleeps(b, model, sleepers) and sleepers.island_time[root_of(sleepers.parent, b)] > real(0.0):
                sleepers.asleep[b] = AWAKE
                sleepers.rest_time[b] = real(0.0)
                sleepers.sleeping[w] = sleepers.sleeping[w] - 1

    @wp.func(module=module)
    def lean_on(a: int, b: int, model: t.Model, sleepers: t.Sleepers):
        """Rouse a body that sleeps against one which is awake."""
        if sleepers.asleep[a] == ASLEEP and sleepers.asleep[b] == AWAKE and model.body_type[b] == DYNAMIC:
            sleepers.asleep[a] = ROUSED

    @wp.func(module=module)
    def pass_on(a: int, b: int, model: t.Model, sleepers: t.Sleepers):
        """Rouse a body that sleeps on, or is joined to, one that is roused; it is known to be held."""
        sleepers.parent[b] = 1
        if sleepers.asleep[a] == ROUSED and sleeps(b, model, sleepers):
            sleepers.asleep[b] = ROUSED

    @wp.kernel(module=module, enable_backward=False)
    def notice_writes(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        sleepers: t.Sleepers,
    ):
        """Rouse sleepers that were moved or pushed by hand, whose joints or gravity changed, or that lose a support."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(sleepers)
        if sleepers.sleeping[w] == 0:
            return
        first = model.body_start[w]
        last = model.body_start[w + 1]
        changed = int(0)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            if is_other_joint(j, joints, sleepers):
                changed += 1
        falls = differ(sleepers.gravity[w], model.gravity[w])
        if sleepers.dormant[w] == 1 and changed == 0 and not falls and disturbed(state, sleepers, first, last) == 0:
            return
        woken = int(0)
        moved = int(0)
        for b in range(first, last):
            v = state.velocity[b]
            if model.body_type[b] != DYNAMIC:
                if is_other_place(b, state, sleepers):
                    sleepers.asleep[b] = ROUSED
                    moved += 1
                elif moves(b, model, state):
                    woken += 1
                see_body(b, state, sleepers)
            elif sleepers.asleep[b] != AWAKE:
                pushed = v[0] != real(0.0) or v[1] != real(0.0) or state.angular_velocity[b] != real(0.0)
                pushed = pushed or differ(sleepers.force[b], state.force[b]) or sleepers.torque[b] != state.torque[b]
                if is_other_place(b, state, sleepers):
                    moved += 1
                    pushed = True
                if falls or pushed or sleepers.asleep[b] == ROUSED:
                    sleepers.asleep[b] = ROUSED
                    woken += 1
        if changed > 0:
            for j in range(model.joint_start[w], model.joint_start[w + 1]):
                if is_other_joint(j, joints, sleepers):
                    a = joints.joint_body_a[j]
                    b = joints.joint_body_b[j]
                    see_joint(j, joints, sleepers)
                    if sleeps(a, model, sleepers):
                        sleepers.asleep[a] = ROUSED
                    if sleeps(b, model, sleepers):
                        sleepers.asleep[b] = ROUSED
        sleepers.gravity[w] = model.gravity[w]
        start = contacts.contact_start[w]
        kept = start + sleepers.count[w]
        if sleepers.dormant[w] == 0:
            # of two bodies that touched a user has let one sleep; the other may be elsewhere by now
            for c in range(start, kept):
                a = sleepers.body_a[c]
                b = sleepers.body_b[c]
                lean_on(a, b, model, sleepers)
                lean_on(b, a, model, sleepers)
        if moved > 0:
            # what it carried, or held by a joint, wakes; what it touches now is met by the narrowphase
            for b in range(first, last):
                sleepers.parent[b] = 0
            for c in range(start, kept):
                a = sleepers.body_a[c]
                b = sleepers.body_b[c]
                pass_on(a, b, model, sleepers)
                pass_on(b, a, model, sleepers)
            for j in range(model.joint_start[w], model.joint_start[w + 1]):
                pass_on(joints.joint_body_a[j], joints.joint_body_b[j], model, sleepers)
                pass_on(joints.joint_body_b[j], joints.joint_body_a[j], model, sleepers)
            # what was let sleep before a step found its contacts may have lain on any
            for b in range(first, last):
                if sleepers.parent[b] == 0 and sleeps(b, model, sleepers):
                    sleepers.asleep[b] = ROUSED
        if woken + moved + changed > 0:
            sleepers.dormant[w] = 0

    @wp.kernel(module=module, enable_backward=False)
    def enter_worlds(launch: t.Launch, state: t.State, stats: t.Stats, sleepers: t.Sleepers):
        """Let the stages of a phase pass over dormant worlds."""
        w = wp.tid() + launch.world_offset
        if sleepers.dormant[w] == 1 and state.flags[w] == 0:
            state.flags[w] = PASSED_OVER
            stats.sweeps[w] = 0
            stats.change[w] = real(0.0)
            stats.residual[w] = real(0.0)
            stats.iteration[w].finished = 1
        elif sleepers.dormant[w] == 0 and state.flags[w] == PASSED_OVER:
            state.flags[w] = 0

    @wp.kernel(module=module, enable_backward=False)
    def leave_worlds(launch: t.Launch, state: t.State):
        """End of a phase: dormant worlds have no flag to be seen."""
        w = wp.tid() + launch.world_offset
        if state.flags[w] == PASSED_OVER:
            state.flags[w] = 0

    @wp.kernel(module=module, enable_backward=False)
    def mark_sleepers(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
        sleepers: t.Sleepers,
    ):
        """Wake what is roused; tell the narrowphase which bodies sleep, so that it passes over pairs of them.

        It meets them at rest, and so finds all that touches them in the step; ``motion.solved`` keeps the velocities
        that they have if they wake.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(pairs)
        contiguous(contacts)
        contiguous(sleepers)
        if state.flags[w] != 0 or sleepers.sleeping[w] == 0:
            return
        first = model.body_start[w]
        last = model.body_start[w + 1]
        roused = int(0)
        for b in range(first, last):
            if sleepers.asleep[b] == ROUSED and model.body_type[b] == DYNAMIC:
                roused += 1
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            # of two bodies that a user has let one of sleep
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            if sleepers.asleep[a] == ASLEEP and is_awake(b, model, state, sleepers):
                sleepers.asleep[a] = ROUSED
                roused += 1
            if sleepers.asleep[b] == ASLEEP and is_awake(a, model, state, sleepers):
                sleepers.asleep[b] = ROUSED
                roused += 1
        if roused > 0:
            wake_islands(w, model, joints, pairs, contacts, sleepers)
        if sleepers.sleeping[w] == 0:
            return
        for b in range(first, last):
            p = motion.predicted[b]
            if model.body_type[b] == DYNAMIC:
                if sleepers.asleep[b] == ASLEEP:
                    motion.solved[b] = p
                    motion.predicted[b] = vec4(real(0.0), real(0.0), real(0.0), real(SLEEPER_MARK))
            elif sleepers.asleep[b] == ROUSED or moves(b, model, state):
                motion.predicted[b] = vec4(p[0], p[1], p[2], real(MOVER_MARK))

    @wp.kernel(module=module, enable_backward=False)
    def wake_touched(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
        sleepers: t.Sleepers,
    ):
        """Wake what something touches that moves; the narrowphase is run anew only for a world where there is such.

        A contact of a sleeper that the narrowphase has found is one with a body that is awake, or moves, or was moved.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(pairs)
        contiguous(contacts)
        contiguous(sleepers)
        if state.flags[w] != 0:
            return
        if sleepers.sleeping[w] == 0:
            state.flags[w] = PASSED_OVER
            return
        touched = int(0)
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            if sleeps(a, model, sleepers):
                sleepers.asleep[a] = ROUSED
                touched += 1
            if sleeps(b, model, sleepers):
                sleepers.asleep[b] = ROUSED
                touched += 1
        if touched > 0:
            wake_islands(w, model, joints, pairs, contacts, sleepers)
        else:
            state.flags[w] = PASSED_OVER
        for b in range(model.body_start[w], model.body_start[w + 1]):
            p = motion.predicted[b]
            if model.body_type[b] != DYNAMIC:
                sleepers.asleep[b] = AWAKE
                motion.predicted[b] = vec4(p[0], p[1], p[2], real(0.0))
            elif p[3] < real(0.0) and sleepers.asleep[b] == AWAKE:
                motion.predicted[b] = motion.solved[b]

    @wp.kernel(module=module, enable_backward=False)
    def admit_worlds(launch: t.Launch, state: t.State, contacts: t.Contacts, rows: t.Rows, sleepers: t.Sleepers):
        """Go on with all worlds that are not dormant; those need room for the contacts of sleepers, too."""
        w = wp.tid() + launch.world_offset
        contiguous(contacts)
        contiguous(rows)
        contiguous(sleepers)
        if state.flags[w] == PASSED_OVER and sleepers.dormant[w] == 0:
            state.flags[w] = 0
        if state.flags[w] != 0 or sleepers.count[w] == 0:
            return
        start = contacts.contact_start[w]
        n = int(start)
        for c in range(start, start + sleepers.count[w]):
            if sleepers.asleep[sleepers.body_a[c]] == ASLEEP or sleepers.asleep[sleepers.body_b[c]] == ASLEEP:
                if n < c:
                    move_kept(sleepers, c, sleepers, n)
                n += 1
        sleepers.count[w] = n - start
        rows.contact_needed[w] = rows.contact_needed[w] + n - start
        if rows.contact_needed[w] > contacts.contact_start[w + 1] - start:
            state.flags[w] = CONTACT_OVERFLOW
            contacts.contact_count[w] = 0

    return {
        "notice_writes": notice_writes,
        "enter_worlds": enter_worlds,
        "leave_worlds": leave_worlds,
        "mark_sleepers": mark_sleepers,
        "wake_touched": wake_touched,
        "admit_worlds": admit_worlds,
    }
