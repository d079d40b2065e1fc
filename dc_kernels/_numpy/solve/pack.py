"""Contacts and joints of a world as rows in blocks of LANES, colour by colour; and their solved impulses back."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.solve.constraints.contact import make_contact_row
from dc_kernels._numpy.solve.constraints.distance import make_distance_row
from dc_kernels._numpy.solve.constraints.jacobian import make_jacobian_row
from dc_kernels._numpy.solve.constraints.rolling import make_rolling_row
from dc_kernels._numpy.solve.row import PackedRow, by_lane
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import Flag
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, ROLLING_COLOR, SERIAL_COLOR, SURFACED


def kernels(dtype: str, variant: str) -> Kernels:
    """``pack_rows`` and ``unpack_impulses``; the arrays bring their scalar type."""
    columns = len(COLUMNS[variant])

    def pack_rows(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        joints: Any,
        motion: Any,
        contacts: Any,
        rows: Any,
        stats: Any,
    ) -> None:
        """Rows of a world's contacts and joints, in blocks of LANES colour by colour."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        own_contacts = np.arange(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
        own_joints = np.arange(rows.line_start[w], rows.line_start[w + 1])
        own_rows = np.arange(rows.row_start[w], rows.row_start[w + 1])
        rows.row_slot[own_rows] = -1
        own_rows = own_rows[(rows.row_lower[own_rows] != 0) | (rows.row_upper[own_rows] != 0)]
        colors = [contacts.color[own_contacts], joints.joint_color[own_joints], rows.row_color[own_rows]]
        colors = np.concatenate(colors)
        highest = colors.max(initial=-1) + 1
        rolling: list[tuple[int, int, PackedRow]] = []  # contact, colour, row
        if variant in SURFACED:
            for c in own_contacts:
                if (row := make_rolling_row(c, w, model, motion, contacts, rows)) is not None:
                    color = contacts.color[c] + ROLLING_COLOR if highest <= ROLLING_COLOR else SERIAL_COLOR
                    rolling.append((int(c), int(color), row))
            colors = np.concatenate([colors, np.array([color for _, color, _ in rolling], np.int32)])
        fill = rows.color_fill[w * COLORS : (w + 1) * COLORS]
        fill[:] = np.bincount(colors, minlength=COLORS)
        ends = rows.color_block[w * (COLORS + 1) : (w + 1) * (COLORS + 1)]
        ends[:] = rows.block_start[w] + np.concatenate([[0], np.cumsum(-(-fill // LANES))])
        rows.block_needed[w] = ends[-1] - ends[0]
        if ends[-1] > rows.block_start[w + 1]:
            state.flags[w] |= Flag.ROW_OVERFLOW
            return
        used = slice(ends[0], ends[-1])
        by_lane(rows.column, columns)[used] = 0.0
        by_lane(rows.body)[used] = launch.padding_body
        jacobi = config.method == METHODS["jacobi"]
        if jacobi:
            rows.body_rows[model.body_start[w] : model.body_start[w + 1]] = 0
        fill[:] = 0
        squares = rows.column.dtype.type(0)

        def place(k: int, row: PackedRow) -> int:
            """Put a row into the next lane of a colour; where its normal impulse lies."""
            block, lane = ends[k] + fill[k] // LANES, fill[k] % LANES
            fill[k] += 1
            by_lane(rows.body)[block, :, lane] = row.a, row.b
            if jacobi:
                rows.body_rows[row.a] += 1
                rows.body_rows[row.b] += 1
            by_lane(rows.column, columns)[block, :, lane] = row.columns(variant, model)
            return block * 2 * LANES + lane

        for c in own_contacts:
            row = make_contact_row(c, w, variant, config, model, state, motion, contacts, rows)
            rows.slot[c] = place(contacts.color[c], row)
            rows.square[c] = row.square
            squares += row.square
        for j in own_joints:
            row = make_distance_row(j, w, config, model, state, motion, joints)
            if not np.isfinite(row.gap):
                state.flags[w] = Flag.NONFINITE
            rows.joint_slot[j] = place(joints.joint_color[j], row)
            squares += row.square
        for k in own_rows:
            row = make_jacobian_row(k, model, motion, rows)
            rows.row_slot[k] = place(rows.row_color[k], row)
            squares += row.square
        rows.limit_slot[ends[0] * LANES : ends[-1] * LANES] = -1
        if len(rows.roll_slot):
            rows.roll_slot[own_contacts] = -1
        for c, color, row in rolling:
            rows.roll_slot[c] = place(color, row)
            block, lane = divmod(rows.roll_slot[c], 2 * LANES)
            rows.limit_slot[block * LANES + lane] = rows.slot[c]
        rows.scale[w] = np.sqrt(squares)
        rows.deepest[w] = contacts.gap[own_contacts].min(initial=0.0)
        stats.colors[w] = highest

    def unpack_impulses(tid: int, launch: Any, model: Any, state: Any, joints: Any, contacts: Any, rows: Any) -> None:
        """Solved impulses back to contacts and joints."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        own = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
        contacts.impulse[own, 0] = rows.impulse[rows.slot[own]]
        contacts.impulse[own, 1] = rows.impulse[rows.slot[own] + LANES]
        if len(rows.roll_slot):
            slot = rows.roll_slot[own]
            contacts.rolling_impulse[own] = np.where(slot >= 0, rows.impulse[slot], 0)
        own = slice(rows.line_start[w], rows.line_start[w + 1])
        joints.joint_impulse[own] = rows.impulse[rows.joint_slot[own]]
        own = slice(rows.row_start[w], rows.row_start[w + 1])
        awake = rows.row_held[own] >= 0
        rows.row_impulse[own] = np.where(awake, rows.impulse[rows.row_slot[own]], rows.row_impulse[own])
        rows.row_impulse[own][rows.row_slot[own] < 0] = 0.0

    return {"pack_rows": pack_rows, "unpack_impulses": unpack_impulses}
