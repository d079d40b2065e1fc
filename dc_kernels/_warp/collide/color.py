"""Colours of the graph of contacts and joints: no two constraints of a colour share a dynamic body."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR

DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
SERIAL = wp.constant(SERIAL_COLOR)


@wp.func_native("""
const unsigned long long open = ~mask & ((1ull << 63) - 1);
#if defined(__CUDA_ARCH__)
return open ? __ffsll(open) - 1 : 63;
#else
return open ? __builtin_ctzll(open) : 63;
#endif
""")
def lowest_free(mask: wp.uint64) -> wp.int32:
    """Lowest colour that no bit of the mask takes; the serial one, 63, when all others are taken."""
    ...


@wp.func
def color_bit(color: int):
    """The colour's bit; constraints of the serial colour block nobody."""
    if color == SERIAL:
        return wp.uint64(0)
    return wp.uint64(1) << wp.uint64(color)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``color_constraints`` and ``keep_colors``; one thread a world."""
    t = group_types(dtype)
    module = kernel_module("color", dtype)
    contiguous = contiguous_groups(dtype)

    @wp.func_native(ranges_code(dtype, "collide/count_fresh.h", SERIAL=SERIAL_COLOR))
    def count_fresh(color: wp.array(dtype=wp.int32), i0: wp.int32, i1: wp.int32, team: wp.uint64) -> wp.int32: ...

    @wp.func_native(ranges_code(dtype, "collide/color.h", SERIAL=SERIAL_COLOR, DYNAMIC=int(BodyType.DYNAMIC)))
    def color_contacts(
        body_type: wp.array(dtype=wp.int32),
        contacts: t.Contacts,
        taken: wp.array(dtype=wp.uint64),
        begun: wp.int32,
        fresh: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func(module=module)
    def taken(a: int, b: int, body_type: wp.array(dtype=wp.int32), color_mask: wp.array(dtype=wp.uint64)):
        """Colours that a further constraint of two bodies must not have: only dynamic bodies forbid any."""
        colors = wp.uint64(0)
        if body_type[a] == DYNAMIC:
            colors = color_mask[a]
        if body_type[b] == DYNAMIC:
            colors = colors | color_mask[b]
        return colors

    @wp.func(module=module)
    def take(a: int, b: int, color: int, color_mask: wp.array(dtype=wp.uint64)):
        """A constraint of two bodies has the colour; bodies that do not move take it too, but nobody asks them."""
        color_mask[a] = color_mask[a] | color_bit(color)
        color_mask[b] = color_mask[b] | color_bit(color)

    @wp.kernel(module=module, enable_backward=False)
    def color_constraints(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Greedy colours: no two constraints of a colour share a dynamic body.

        Joints and a caller's own rows come first and so get the same colours in each step; contacts that persist keep
        theirs; new ones, and those of the serial colour, take the lowest that is free at both bodies.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(rows)
        if state.flags[w] != 0:
            return
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        fresh = count_fresh(contacts.color, start, end, launch.team)
        begun = int(0)
        if rows.line_start[w] < rows.line_start[w + 1] or rows.row_start[w] < rows.row_start[w + 1]:
            begun = 1
        elif fresh == 0:
            return  # nothing new, nothing to colour
        if begun == 1:
            for b in range(model.body_start[w], model.body_start[w + 1]):
                rows.color_mask[b] = wp.uint64(0)
        for j in range(rows.line_start[w], rows.line_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            free = lowest_free(taken(a, b, model.body_type, rows.color_mask))
            joints.joint_color[j] = free
            take(a, b, free, rows.color_mask)
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            a = rows.row_body_a[k]
            b = rows.row_body_b[k]
            free = lowest_free(taken(a, b, model.body_type, rows.color_mask))
            rows.row_color[k] = free
            take(a, b, free, rows.color_mask)
        color_contacts(model.body_type, contacts, rows.color_mask, begun, fresh, start, end, launch.team)

    @wp.kernel(module=module, enable_backward=False)
    def keep_colors(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Contacts lose a colour that is none, or that a joint or an earlier contact of one of their bodies has too."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(rows)
        if state.flags[w] != 0:
            return
        for b in range(model.body_start[w], model.body_start[w + 1]):
            rows.color_mask[b] = wp.uint64(0)
        for j in range(rows.line_start[w], rows.line_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            take(a, b, lowest_free(taken(a, b, model.body_type, rows.color_mask)), rows.color_mask)
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            a = rows.row_body_a[k]
            b = rows.row_body_b[k]
            take(a, b, lowest_free(taken(a, b, model.body_type, rows.color_mask)), rows.color_mask)
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            kept = contacts.color[c]
            if kept < 0 or kept >= SERIAL:
                contacts.color[c] = -1
                continue
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            if (taken(a, b, model.body_type, rows.color_mask) & color_bit(kept)) != wp.uint64(0):
                contacts.color[c] = -1
                continue
            take(a, b, kept, rows.color_mask)

    return {"color_constraints": color_constraints, "keep_colors": keep_colors}
