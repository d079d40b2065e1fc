"""Colours of the graph of contacts and joints: no two constraints of a colour share a dynamic body."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import SERIAL_COLOR

DYNAMIC = int(BodyType.DYNAMIC)
SERIAL = SERIAL_COLOR


@ti.func
def lowest_free(mask):
    """Lowest colour that no bit of the mask takes; the serial one, 63, when all others are taken."""
    below = mask & ~(mask + ti.u64(1))  # the ones below the lowest zero, which are as many as its place
    return ti.min(ti.cast(ti.math.popcnt(below), ti.i32), SERIAL)


@ti.func
def color_bit(color):
    """The colour's bit; constraints of the serial colour block nobody."""
    bit = ti.u64(0)
    if color != SERIAL:
        bit = ti.u64(1) << ti.u64(color)
    return bit


@ti.func
def taken(a, b, body_type: ti.template(), color_mask: ti.template()):
    """Colours that a further constraint of two bodies must not have: only dynamic bodies forbid any."""
    colors = ti.u64(0)
    if body_type[a] == DYNAMIC:
        colors = color_mask[a]
    if body_type[b] == DYNAMIC:
        colors = colors | color_mask[b]
    return colors


@ti.func
def take(a, b, color, color_mask: ti.template()):
    """A constraint of two bodies has the colour; bodies that do not move take it too, but nobody asks them."""
    bit = color_bit(color)
    color_mask[a] = color_mask[a] | bit
    color_mask[b] = color_mask[b] | bit


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``color_constraints`` and ``keep_colors``; one thread a world."""
    t = group_types(dtype)

    @ti.func
    def color_first(w, model: t.Model, joints: t.Joints, rows: t.Rows, store: ti.template()):
        """Each joint, and each row of a caller's own, takes the lowest colour that is free; ``store``: and keeps it."""
        for b in range(model.body_start[w], model.body_start[w + 1]):
            rows.color_mask[b] = ti.u64(0)
        for j in range(rows.line_start[w], rows.line_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            free = lowest_free(taken(a, b, model.body_type, rows.color_mask))
            if ti.static(store):
                joints.joint_color[j] = free
            take(a, b, free, rows.color_mask)
        for k in range(rows.row_start[w], rows.row_start[w + 1]):
            a = rows.row_body_a[k]
            b = rows.row_body_b[k]
            free = lowest_free(taken(a, b, model.body_type, rows.color_mask))
            if ti.static(store):
                rows.row_color[k] = free
            take(a, b, free, rows.color_mask)

    @kernel
    def color_constraints(
        tid,
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
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            start = contacts.contact_start[w]
            end = start + contacts.contact_count[w]
            fresh = rows.line_start[w + 1] - rows.line_start[w] + rows.row_start[w + 1] - rows.row_start[w]
            if fresh == 0:
                for c in range(start, end):
                    fresh += ti.cast((contacts.color[c] < 0) | (contacts.color[c] == SERIAL), ti.i32)
            if fresh != 0:  # else nothing new, nothing to colour
                color_first(w, model, joints, rows, True)
                for c in range(start, end):
                    kept = contacts.color[c]
                    if kept >= 0 and kept != SERIAL:
                        take(contacts.body_a[c], contacts.body_b[c], kept, rows.color_mask)
                for c in range(start, end):
                    kept = contacts.color[c]
                    if kept < 0 or kept == SERIAL:
                        a = contacts.body_a[c]
                        b = contacts.body_b[c]
                        free = lowest_free(taken(a, b, model.body_type, rows.color_mask))
                        contacts.color[c] = free
                        take(a, b, free, rows.color_mask)

    @kernel
    def keep_colors(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Contacts lose a colour that is none, or that a joint or an earlier contact of one of their bodies has too."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            color_first(w, model, joints, rows, False)
            start = contacts.contact_start[w]
            for c in range(start, start + contacts.contact_count[w]):
                kept = contacts.color[c]
                a = contacts.body_a[c]
                b = contacts.body_b[c]
                colors = ~ti.u64(0)
                if kept >= 0 and kept < SERIAL:
                    colors = taken(a, b, model.body_type, rows.color_mask) & color_bit(kept)
                if colors != ti.u64(0):
                    contacts.color[c] = -1
                else:
                    take(a, b, kept, rows.color_mask)

    return {"color_constraints": color_constraints, "keep_colors": keep_colors}
