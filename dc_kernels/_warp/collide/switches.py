"""Contacts that do not act: apart from the others while a step is made, and back among them at its end."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.collide.approach import approach_function
from dc_kernels._warp.common import kernel_module, rotate
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels.collide.switches import ASIDE, SLOPS
from dc_kernels.model.enums import BodyType, ShapeRole
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

ONE_WAY = wp.constant(int(ShapeRole.ONE_WAY))
ONE_SIDED = wp.constant(int(ShapeRole.ONE_SIDED))
STATIC = wp.constant(int(BodyType.STATIC))
SHIFT_A = wp.constant(wp.int64(KEY_SHAPE_BITS + KEY_FEATURE_BITS))
SHIFT_B = wp.constant(wp.int64(KEY_FEATURE_BITS))
SHAPE = wp.constant(wp.int64(2**KEY_SHAPE_BITS - 1))


@cache
def off_functions(dtype: str) -> SimpleNamespace:
    """``any_off`` and ``is_off``: of a world, and of a pair of shapes, once the contacts that are off are shown."""
    t = group_types(dtype)
    module = kernel_module("continuous", dtype)

    @wp.func(module=module)
    def any_off(w: int, contacts: t.Contacts):
        """Whether a contact of a world does not act in this step."""
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            if contacts.color[c] < 0:
                return True
        return False

    @wp.func(module=module)
    def is_off(one: int, other: int, w: int, model: t.Model, contacts: t.Contacts):
        """Whether two shapes have contacts of which none acts in this step."""
        shape0 = model.shape_start[w]
        a = wp.int64(wp.min(one, other) - shape0)
        b = wp.int64(wp.max(one, other) - shape0)
        pair = a << (SHIFT_A - SHIFT_B) | b
        if model.body_type[model.shape_body[wp.max(one, other)]] == STATIC:
            pair = b << (SHIFT_A - SHIFT_B) | a
        low = contacts.contact_start[w]
        end = low + contacts.contact_count[w]
        high = end
        while low < high:
            middle = (low + high) // 2
            if contacts.key[middle] >> SHIFT_B < pair:
                low = middle + 1
            else:
                high = middle
        off = bool(False)
        while low < end and contacts.key[low] >> SHIFT_B == pair:
            if contacts.color[low] >= 0:
                return False
            off = True
            low += 1
        return off

    return SimpleNamespace(any_off=any_off, is_off=is_off)


@cache
def kernels(dtype: str, rolls: bool = False) -> dict[str, Any]:
    """``screen_contacts``, ``show_switched``, and ``switch_contacts`` for a user; one thread a world.

    ``rolls``: contacts have impulses of rolling resistance; one that is off has none, as it has no other.
    """
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("switches", dtype, *(["rolls"] if rolls else []))
    contiguous = contiguous_groups(dtype)
    approach_of = approach_function(dtype, "switches")

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=rolls))
    def move_contact(source: t.Contacts, i: wp.int32, target: t.Contacts, k: wp.int32): ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=False))
    def put_aside(source: t.Contacts, i: wp.int32, target: t.Switches, k: wp.int32): ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=False))
    def move_aside(source: t.Switches, i: wp.int32, target: t.Switches, k: wp.int32): ...

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=False))
    def put_back(source: t.Switches, i: wp.int32, target: t.Contacts, k: wp.int32): ...

    @wp.func(module=module)
    def holds(
        s: int, o: int, normal: vec2, gap: real, approach: real, slop: real, deep: real, model: t.Model, state: t.State
    ):
        """Whether a shape holds another one that it did not hold in the step before.

        Args:
            normal: of the contact, from the shape to the other.
            gap: least of the pair [m].
            approach: speed at which they approach there [m/s].
            slop: overlap up to which shapes touch [m].
            deep: overlap up to which what approaches touches [m].
        """
        role = model.shape_role[s]
        if role != ONE_WAY and role != ONE_SIDED:
            return True
        body = model.shape_body[s]
        c = wp.cos(state.angle[body])
        sine = wp.sin(state.angle[body])
        if role == ONE_WAY:
            way = model.shape_one_way[s]
            side = wp.dot(normal, rotate(c, sine, vec2(wp.cos(way), wp.sin(way))))
            return side > real(ASIDE) and (gap >= -slop or (gap >= -deep and approach >= real(0.0)))
        first = model.vertex_start[s]
        front = rotate(c, sine, model.vertex_normals[first])
        other = model.shape_body[o]
        turned = rotate(wp.cos(state.angle[other]), wp.sin(state.angle[other]), model.shape_center[o])
        reach = state.position[other] - state.position[body] + turned - rotate(c, sine, model.vertices[first])
        if wp.dot(front, reach) < real(0.0) or wp.dot(front, normal) <= real(0.0):
            return False
        return gap >= -slop or approach >= real(0.0)

    @wp.kernel(module=module, enable_backward=False)
    def screen_contacts(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        rows: t.Rows,
        switches: t.Switches,
    ):
        """Move the contacts of a world that do not hold to those that are off, pair by pair; let all others act."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(contacts)
        contiguous(rows)
        contiguous(switches)
        if state.flags[w] != 0:
            return
        slop = real(SLOPS) * config.slop * model.length_scale[w]
        deep = wp.max(slop, motion.reach[w])
        shape0 = model.shape_start[w]
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        last = start
        off = start
        c = start
        while c < end:
            pair = contacts.key[c] >> SHIFT_B
            a = shape0 + int(contacts.key[c] >> SHIFT_A)
            b = shape0 + int(pair & SHAPE)
            to = c
            deepest = c
            held = bool(False)
            while to < end and contacts.key[to] >> SHIFT_B == pair:
                held = held or contacts.color[to] >= 0
                if contacts.gap[to] < contacts.gap[deepest]:
                    deepest = to
                to += 1
            if not held and model.shape_role.shape[0] > 0:
                n = contacts.normal[deepest]
                gap = contacts.gap[deepest]
                approach = approach_of(deepest, state, contacts)
                held = holds(a, b, n, gap, approach, slop, deep, model, state)
                held = held and holds(b, a, -n, gap, approach, slop, deep, model, state)
            elif not held:
                held = True
            while c < to:
                if held:
                    if last < c:
                        move_contact(contacts, c, contacts, last)
                    switches.enabled[last] = 1
                    if rows.surface_speed.shape[0] > 0:
                        rows.surface_speed[last] = model.shape_surface_speed[a] + model.shape_surface_speed[b]
                    last += 1
                else:
                    put_aside(contacts, c, switches, off)
                    switches.impulse[off] = vec2(real(0.0), real(0.0))
                    off += 1
                c += 1
        contacts.contact_count[w] = last - start
        switches.count[w] = off - start

    @wp.kernel(module=module, enable_backward=False)
    def switch_contacts(launch: t.Launch, state: t.State, contacts: t.Contacts, rows: t.Rows, switches: t.Switches):
        """Move the contacts of a world that are not ``enabled`` to those that are off."""
        w = wp.tid() + launch.world_offset
        contiguous(state)
        contiguous(contacts)
        contiguous(rows)
        contiguous(switches)
        if state.flags[w] != 0:
            return
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        more = int(0)
        for c in range(start, end):
            if switches.enabled[c] == 0:
                more += 1
        if more == 0:
            return
        known = start + switches.count[w] - 1
        to = known + more
        switches.count[w] = to + 1 - start
        c = end - 1
        while c >= start:
            if switches.enabled[c] == 0:
                while known >= start and switches.key[known] > contacts.key[c]:
                    move_aside(switches, known, switches, to)
                    known -= 1
                    to -= 1
                put_aside(contacts, c, switches, to)
                switches.impulse[to] = vec2(real(0.0), real(0.0))
                switches.color[to] = -1
                to -= 1
            c -= 1
        last = start
        for i in range(start, end):
            if switches.enabled[i] != 0:
                if last < i:
                    move_contact(contacts, i, contacts, last)
                    if rows.surface_speed.shape[0] > 0:
                        rows.surface_speed[last] = rows.surface_speed[i]
                last += 1
        for i in range(start, last):
            switches.enabled[i] = 1
        contacts.contact_count[w] = last - start

    @wp.kernel(module=module, enable_backward=False)
    def show_switched(launch: t.Launch, state: t.State, contacts: t.Contacts, switches: t.Switches):
        """Put the contacts of a world that are off among those of the step, by key."""
        w = wp.tid() + launch.world_offset
        contiguous(state)
        contiguous(contacts)
        contiguous(switches)
        if state.flags[w] != 0 or switches.count[w] == 0:
            return
        start = contacts.contact_start[w]
        known = start + switches.count[w] - 1
        found = start + contacts.contact_count[w] - 1
        to = found + switches.count[w]
        contacts.contact_count[w] = to + 1 - start
        switches.count[w] = 0
        while known >= start:
            if found >= start and contacts.key[found] > switches.key[known]:
                move_contact(contacts, found, contacts, to)
                found -= 1
            else:
                put_back(switches, known, contacts, to)
                if wp.static(rolls):
                    contacts.rolling_impulse[to] = real(0.0)
                known -= 1
            to -= 1

    return {"screen_contacts": screen_contacts, "switch_contacts": switch_contacts, "show_switched": show_switched}
