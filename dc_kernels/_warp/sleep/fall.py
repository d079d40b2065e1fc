"""Falling asleep: how long bodies have rested, islands of them, and the contacts that they keep; one thread a world."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.sleep.islands import ASLEEP, AWAKE, DYNAMIC, FALLING, KINEMATIC, island_functions, join, root_of
from dc_kernels.model.enums import Flag
from dc_kernels.sleep.sleepers import LOOK_EVERY

PASSED_OVER = wp.constant(int(Flag.ASLEEP))
EVERY = wp.constant(LOOK_EVERY)
LOOK = wp.constant(LOOK_EVERY + 1)  # in place of the steps waited, where islands are to be looked for at the step's end
RESTED = wp.constant(2)  # of what ``count_rest`` returns: some body has rested for long enough
CODES = {"DYNAMIC": DYNAMIC, "KINEMATIC": KINEMATIC, "AWAKE": AWAKE}


@cache
def kernels(dtype: str, rolls: bool = False) -> dict[str, Any]:
    """``show_sleepers``, ``rest`` and ``fall_asleep``, and ``lay_down`` for a user who wants bodies to sleep.

    ``rolls``: contacts have impulses of rolling resistance.
    """
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("sleep", dtype, *(["rolls"] if rolls else []))
    contiguous = contiguous_groups(dtype)
    functions = island_functions(dtype)
    moves, see_body, see_joint = functions.moves, functions.see_body, functions.see_joint

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=rolls))
    def keep_contact(source: t.Contacts, i: wp.int32, target: t.Sleepers, k: wp.int32): ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=rolls))
    def move_contact(source: t.Contacts, i: wp.int32, target: t.Contacts, k: wp.int32): ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=rolls))
    def show_contact(source: t.Sleepers, i: wp.int32, target: t.Contacts, k: wp.int32): ...

    @wp.func_native(native_code("sleep/count_rest.h", dtype=dtype, RESTED=RESTED, **CODES))
    def count_rest(
        model: t.Model,
        state: t.State,
        sleepers: t.Sleepers,
        b0: wp.int32,
        b1: wp.int32,
        slow: real,
        dt: real,
        size: real,
        g: real,
        enough: real,
    ) -> wp.int32: ...

    @wp.func(module=module)
    def enough_of(size: real, config: t.Config):
        """The least product of gravity and a rest time's square by which a body may sleep; see ``is_enough``."""
        return config.sleep_time * config.sleep_time * size

    @wp.func(module=module)
    def is_enough(time: real, g: real, size: real, config: t.Config):
        """Whether a body that has rested for so long may sleep; never without gravity. ``count_rest`` asks so too."""
        return g > real(0.0) and time > real(0.0) and time * time * g >= enough_of(size, config)

    @wp.func(module=module)
    def lay(w: int, model: t.Model, state: t.State, joints: t.Joints, contacts: t.Contacts, sleepers: t.Sleepers):
        """Lay down the bodies of a world that fall asleep, and keep the contacts of all that sleep."""
        sleeping = int(0)
        others = int(0)
        for b in range(model.body_start[w], model.body_start[w + 1]):
            if model.body_type[b] != DYNAMIC:
                sleepers.asleep[b] = AWAKE
                see_body(b, state, sleepers)
                if moves(b, model, state):
                    others += 1
            elif sleepers.asleep[b] == AWAKE:
                others += 1
            else:
                sleeping += 1
                if sleepers.asleep[b] == FALLING:
                    sleepers.asleep[b] = ASLEEP
                    # later steps of a world that is awake in part add zeros to both, which make 0 of -0
                    state.position[b] = state.position[b] + vec2(real(0.0), real(0.0))
                    state.angle[b] = state.angle[b] + real(0.0)
                    state.velocity[b] = vec2(real(0.0), real(0.0))
                    state.angular_velocity[b] = real(0.0)
                    see_body(b, state, sleepers)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            see_joint(j, joints, sleepers)
        sleepers.gravity[w] = model.gravity[w]
        start = contacts.contact_start[w]
        n = int(start)
        for c in range(start, start + contacts.contact_count[w]):
            if sleepers.asleep[contacts.body_a[c]] == ASLEEP or sleepers.asleep[contacts.body_b[c]] == ASLEEP:
                keep_contact(contacts, c, sleepers, n)
                n += 1
        sleepers.count[w] = n - start
        sleepers.sleeping[w] = sleeping
        sleepers.dormant[w] = 0
        if sleeping > 0 and others == 0:
            sleepers.dormant[w] = 1

    @wp.kernel(module=module, enable_backward=False)
    def show_sleepers(launch: t.Launch, state: t.State, motion: t.Motion, contacts: t.Contacts, sleepers: t.Sleepers):
        """Put the contacts of sleepers among those of the step, by key; impulses are scaled to its time step."""
        w = wp.tid() + launch.world_offset
        contiguous(motion)
        contiguous(contacts)
        contiguous(sleepers)
        if state.flags[w] != 0 or sleepers.count[w] == 0:
            return
        start = contacts.contact_start[w]
        kept = start + sleepers.count[w] - 1
        if contacts.contact_dt[w] > real(0.0) and contacts.contact_dt[w] != motion.step_dt[w]:
            scale = motion.step_dt[w] / contacts.contact_dt[w]
            for c in range(start, kept + 1):
                sleepers.impulse[c] = sleepers.impulse[c] * scale
                if wp.static(rolls):
                    sleepers.rolling_impulse[c] = sleepers.rolling_impulse[c] * scale
        found = start + contacts.contact_count[w] - 1
        to = found + kept + 1 - start
        contacts.contact_count[w] = to + 1 - start
        while kept >= start:
            if found >= start and contacts.key[found] > sleepers.key[kept]:
                move_contact(contacts, found, contacts, to)
                found -= 1
            else:
                show_contact(sleepers, kept, contacts, to)
                kept -= 1
            to -= 1

    @wp.kernel(module=module, enable_backward=False)
    def rest(
        launch: t.Launch, config: t.Config, model: t.Model, state: t.State, motion: t.Motion, sleepers: t.Sleepers
    ):
        """End of a step: for how long bodies have rested; whether to look for islands; dormant worlds age."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(sleepers)
        dt = motion.step_dt[w]
        if state.flags[w] == PASSED_OVER:
            state.flags[w] = 0
            state.time[w] = state.time[w] + wp.float64(dt)
            return
        if state.flags[w] != 0:
            return
        size = model.length_scale[w]
        g = wp.length(model.gravity[w])
        slow = config.sleep_speed * config.sleep_speed * g * size
        enough = enough_of(size, config)
        first = model.body_start[w]
        found = count_rest(model, state, sleepers, first, model.body_start[w + 1], slow, dt, size, g, enough)
        if found == 0 and sleepers.sleeping[w] > 0:
            sleepers.dormant[w] = 1
        waited = wp.min(sleepers.waited[w] + 1, EVERY)
        if waited == EVERY and found >= RESTED:
            waited = LOOK
        sleepers.waited[w] = waited

    @wp.kernel(module=module, enable_backward=False)
    def fall_asleep(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        sleepers: t.Sleepers,
    ):
        """Let islands of bodies that have come to rest fall asleep.

        An island is what contacts and joints connect over bodies that are awake; one that touches a kinematic body
        which moves stays awake.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(sleepers)
        if sleepers.waited[w] != LOOK:
            return
        sleepers.waited[w] = 0
        first = model.body_start[w]
        last = model.body_start[w + 1]
        size = model.length_scale[w]
        g = wp.length(model.gravity[w])
        for b in range(first, last):
            sleepers.parent[b] = b
            sleepers.island_time[b] = sleepers.rest_time[b]
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        for c in range(start, end):
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            if model.body_type[a] == DYNAMIC and model.body_type[b] == DYNAMIC:
                join(sleepers.parent, a, b)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            if model.body_type[a] == DYNAMIC and model.body_type[b] == DYNAMIC:
                join(sleepers.parent, a, b)
            elif moves(a, model, state):
                sleepers.island_time[b] = real(-1.0)
            elif moves(b, model, state):
                sleepers.island_time[a] = real(-1.0)
        for c in range(start, end):
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            if moves(a, model, state):
                sleepers.island_time[b] = real(-1.0)
            if moves(b, model, state):
                sleepers.island_time[a] = real(-1.0)
        for b in range(first, last):
            root = root_of(sleepers.parent, b)
            sleepers.island_time[root] = wp.min(sleepers.island_time[root], sleepers.island_time[b])
        falling = int(0)
        for b in range(first, last):
            if model.body_type[b] == DYNAMIC and sleepers.asleep[b] == AWAKE:
                if is_enough(sleepers.island_time[root_of(sleepers.parent, b)], g, size, config):
                    sleepers.asleep[b] = FALLING
                    falling += 1
        if falling > 0:
            lay(w, model, state, joints, contacts, sleepers)

    @wp.kernel(module=module, enable_backward=False)
    def lay_down(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        sleepers: t.Sleepers,
    ):
        """Lay down the bodies that fall asleep because a user wants so."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(sleepers)
        lay(w, model, state, joints, contacts, sleepers)

    return {"show_sleepers": show_sleepers, "rest": rest, "fall_asleep": fall_asleep, "lay_down": lay_down}
