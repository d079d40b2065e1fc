"""Contacts and joints of a world as rows in blocks of LANES, colour by colour; and their solved impulses back.

All rows are made anew in each step: of the 10 ns that a contact takes, 4 find its place, and rows that stayed in theirs
would save no more.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.constraints.contact import contact_rows
from dc_kernels._warp.solve.constraints.distance import distance_row
from dc_kernels._warp.solve.constraints.jacobian import jacobian_rows
from dc_kernels._warp.solve.constraints.rolling import KEY_BITS, rolling_rows
from dc_kernels._warp.solve.lanes import row_macros
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import Flag
from dc_kernels.solve.rows import COLORS, COLUMNS, JOINTED, LANES, OWN, ROLLING_COLOR, SERIAL_COLOR, SURFACED

ROW_OVERFLOW = wp.constant(int(Flag.ROW_OVERFLOW))
NONFINITE = wp.constant(int(Flag.NONFINITE))
JACOBI = wp.constant(METHODS["jacobi"])
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
ROLLING = wp.constant(ROLLING_COLOR)
SERIAL = wp.constant(SERIAL_COLOR)


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``pack_rows`` and ``unpack_impulses``; one thread a world."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    Row = t.Row
    module = kernel_module("rows", dtype, variant)
    contiguous = contiguous_groups(dtype)
    jointed, own, surfaced = variant in JOINTED, variant in OWN, variant in SURFACED
    infinity = real(float("inf"))
    width = wp.constant(len(COLUMNS[variant]) * LANES)
    make_contact_rows = contact_rows(dtype, variant)
    make_distance_row = distance_row(dtype, variant)
    if own:
        make_jacobian_rows = jacobian_rows(dtype, variant)
    rolling = rolling_rows(dtype, variant)
    resistance_of, make_rolling_row = rolling.resistance_of, rolling.make_rolling_row

    def code(*names: str) -> str:
        return native_code("prelude.h", *(f"pack/{name}.h" for name in names), dtype=dtype, **row_macros(variant))

    @wp.func_native(code("store_row"))
    def store_row(columns: wp.array(dtype=real), r: wp.int32, row: Row): ...

    surface = ["pack/surface.h"] if surfaced else []
    laid = {"ROLLING_COLOR": ROLLING_COLOR, **KEY_BITS, **row_macros(variant)}

    @wp.func_native(ranges_code(dtype, *surface, "pack/lay_out.h", **laid))
    def lay_out(
        w: wp.int32,
        padding_body: wp.int32,
        model: t.Model,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
        team: wp.uint64,
    ) -> wp.int32: ...

    @wp.func_native(native_code("pack/count_rows.h", dtype=dtype))
    def count_rows(contacts: t.Contacts, body_rows: wp.array(dtype=wp.int32), i0: wp.int32, i1: wp.int32): ...

    @wp.func_native(code("least"))
    def least_of(x: wp.array(dtype=real), i0: wp.int32, i1: wp.int32) -> real: ...

    @wp.func_native(ranges_code(dtype, "pack/unpack.h"))
    def unpack_contacts(
        impulse: wp.array(dtype=real),
        slot: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec2),
        i0: wp.int32,
        i1: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func(module=module)
    def between(row: Row):
        """A row along one normal, as contacts and joints have it, as one of the variant rows."""
        if wp.static(own):
            row.direction_a = row.normal
            row.most = infinity
            row.held = real(1.0)
        return row

    @wp.func(module=module)
    def place(w: int, color: int, jacobi: bool, row: Row, rows: t.Rows):
        """Put a row into the next lane of its colour; where its normal impulse lies."""
        fill = w * N_COLORS + color
        index = rows.color_fill[fill]
        rows.color_fill[fill] = index + 1
        block = rows.color_block[w * (N_COLORS + 1) + color] + index / N_LANES
        lane = index % N_LANES
        i = block * 2 * N_LANES + lane
        rows.body[i] = row.body_a
        rows.body[i + N_LANES] = row.body_b
        if jacobi:
            rows.body_rows[row.body_a] += 1
            rows.body_rows[row.body_b] += 1
        store_row(rows.column, block * width + lane, row)
        return i

    @wp.kernel(module=module, enable_backward=False)
    def pack_rows(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Rows of a world's contacts and joints, in blocks of LANES colour by colour."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous(rows)
        contiguous(stats)
        if state.flags[w] != 0:
            return
        used = lay_out(w, launch.padding_body, model, joints, contacts, rows, launch.team)
        if used < 0:
            state.flags[w] = state.flags[w] | ROW_OVERFLOW
            return
        jacobi = config.method == JACOBI
        if jacobi:
            for b in range(model.body_start[w], model.body_start[w + 1]):
                rows.body_rows[b] = 0
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        scale = make_contact_rows(w, launch.padding_body, config, model, state, motion, contacts, rows, launch.team)
        if jacobi:
            count_rows(contacts, rows.body_rows, start, end)
        if wp.static(jointed):
            check = real(0.0)  # x - x is 0 for a finite x, NaN for inf and NaN
            for j in range(rows.line_start[w], rows.line_start[w + 1]):
                row = make_distance_row(j, w, config, model, state, motion, joints)
                check += row.gap - row.gap
                rows.joint_slot[j] = place(w, joints.joint_color[j], jacobi, between(row), rows)
                scale += row.square
            if check != real(0.0):
                state.flags[w] = NONFINITE
        if wp.static(own):
            scale = make_jacobian_rows(w, wp.where(jacobi, 1, 0), scale, model, motion, rows)
        if wp.static(surfaced):
            if rows.roll_slot.shape[0] > 0:
                for c in range(start, end):
                    rows.roll_slot[c] = -1
                    resistance = resistance_of(c, w, model, contacts)
                    if resistance > real(0.0):
                        color = SERIAL
                        if used <= ROLLING:
                            color = contacts.color[c] + ROLLING
                        row = make_rolling_row(c, w, resistance, model, contacts, rows)
                        i = place(w, color, jacobi, row, rows)
                        rows.limit_slot[i / (2 * N_LANES) * N_LANES + i % N_LANES] = rows.slot[c]
                        rows.roll_slot[c] = i
        rows.scale[w] = wp.sqrt(scale)
        rows.deepest[w] = least_of(contacts.gap, start, end)
        stats.colors[w] = used

    @wp.kernel(module=module, enable_backward=False)
    def unpack_impulses(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Solved impulses back to contacts and joints."""
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
        unpack_contacts(rows.impulse, rows.slot, contacts.impulse, start, end, launch.team)
        if wp.static(jointed):
            for j in range(rows.line_start[w], rows.line_start[w + 1]):
                joints.joint_impulse[j] = rows.impulse[rows.joint_slot[j]]
        if wp.static(own):
            for k in range(rows.row_start[w], rows.row_start[w + 1]):
                if rows.row_slot[k] < 0:
                    rows.row_impulse[k] = real(0.0)
                elif rows.row_held[k] >= real(0.0):
                    rows.row_impulse[k] = rows.impulse[rows.row_slot[k]]
        if wp.static(surfaced):
            if rows.roll_slot.shape[0] > 0:
                for c in range(start, end):
                    i = rows.roll_slot[c]
                    contacts.rolling_impulse[c] = real(0.0)
                    if i >= 0:
                        contacts.rolling_impulse[c] = rows.impulse[i]

    return {"pack_rows": pack_rows, "unpack_impulses": unpack_impulses}
