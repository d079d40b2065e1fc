"""Contacts and joints of a world as rows in blocks of LANES, colour by colour; and their solved impulses back."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.solve.bodies import LANE_BITS, LAST_LANE, body_functions
from dc_kernels._taichi.solve.constraints.contact import contact_rows
from dc_kernels._taichi.solve.constraints.distance import distance_row
from dc_kernels._taichi.solve.constraints.jacobian import jacobian_row
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import Flag
from dc_kernels.solve.rows import COLORS, COLUMNS, JOINTED, LANES, SURFACED

ROW_OVERFLOW = int(Flag.ROW_OVERFLOW)
NONFINITE = int(Flag.NONFINITE)
JACOBI = METHODS["jacobi"]
INFINITY = float("inf")
CHUNK = 256  # contacts whose places are found before the rows of any is made
NONE = -1

VARIANTS = tuple(name for name in COLUMNS if name not in SURFACED)
"""Variants of rows that there are kernels for."""


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``pack_rows`` and ``unpack_impulses``; one thread a world."""
    t = group_types(dtype)
    vec2, vec8 = t.vec2, t.vec8
    columns = COLUMNS[variant]
    jointed, own = variant in JOINTED, variant == "rows"
    width = len(columns)
    at = {name: i for i, name in enumerate(columns)}
    NX, NY, EN, ET, BIAS, MU, GAP = (at[c] for c in ("nx", "ny", "en", "et", "bias", "mu", "gap"))
    # the variant that lacks a column never writes it
    RAN, RBN, RAT, RBT, IA, IB = (at.get(c, 0) for c in ("rAn", "rBn", "rAt", "rBt", "iA", "iB"))
    LO, HI, AX, AY, SOFT, HELD = (at.get(c, 0) for c in ("lo", "hi", "ax", "ay", "soft", "held"))
    make_contact_rows = contact_rows(dtype, variant)
    unknown_floor = body_functions(dtype).unknown_floor
    make_distance_row = distance_row(dtype, variant)
    make_jacobian_row = jacobian_row(dtype, variant)

    @ti.func
    def store_row(rows: t.Rows, k, lane, row):
        """The columns of one row of a joint or a caller's own, in a lane of the block whose first column is k."""
        rows.column[k + NX][lane] = row.normal[0]
        rows.column[k + NY][lane] = row.normal[1]
        rows.column[k + RAN][lane] = row.normal_arm_a
        rows.column[k + RBN][lane] = row.normal_arm_b
        rows.column[k + RAT][lane] = row.tangent_arm_a
        rows.column[k + RBT][lane] = row.tangent_arm_b
        rows.column[k + IA][lane] = row.inv_inertia_a
        rows.column[k + IB][lane] = row.inv_inertia_b
        rows.column[k + EN][lane] = row.normal_mass
        rows.column[k + ET][lane] = row.tangent_mass
        rows.column[k + BIAS][lane] = row.bias
        rows.column[k + MU][lane] = row.friction
        rows.column[k + GAP][lane] = row.gap
        rows.column[k + LO][lane] = row.least
        if ti.static(own):
            rows.column[k + HI][lane] = row.most
            rows.column[k + AX][lane] = row.direction_a[0]
            rows.column[k + AY][lane] = row.direction_a[1]
            rows.column[k + SOFT][lane] = row.softness
            rows.column[k + HELD][lane] = row.held

    @ti.func
    def lay_out(w, padding_body, model: t.Model, joints: t.Joints, contacts: t.Contacts, rows: t.Rows):
        """Blocks of each colour of a world, and empty lanes in its last one; the colours used, -1 without room."""
        start = contacts.contact_start[w]
        count = w * COLORS
        for k in range(count, count + COLORS):
            rows.color_fill[k] = 0
        used = 0
        for c in range(start, start + contacts.contact_count[w]):
            color = contacts.color[c]
            rows.color_fill[count + color] = rows.color_fill[count + color] + 1
            used = ti.max(used, color + 1)
        for j in range(rows.line_start[w], rows.line_start[w + 1]):
            color = joints.joint_color[j]
            rows.color_fill[count + color] = rows.color_fill[count + color] + 1
            used = ti.max(used, color + 1)
        if ti.static(own):
            for k in range(rows.row_start[w], rows.row_start[w + 1]):
                if rows.row_lower[k] != 0.0 or rows.row_upper[k] != 0.0:  # else it can carry nothing, and has no row
                    color = rows.row_color[k]
                    rows.color_fill[count + color] = rows.color_fill[count + color] + 1
                    used = ti.max(used, color + 1)
        first = rows.block_start[w]
        ends = w * (COLORS + 1)
        block = first
        for k in range(COLORS):
            rows.color_block[ends + k] = block
            block += (rows.color_fill[count + k] + LANES - 1) // LANES
        rows.color_block[ends + COLORS] = block
        rows.block_needed[w] = block - first
        if block > rows.block_start[w + 1]:
            used = -1
        for k in range(used):
            filled = rows.color_fill[count + k]
            rows.color_fill[count + k] = 0
            if ti.static(jointed):  # rows that are made one by one leave lanes empty
                if filled % LANES != 0:
                    last = rows.color_block[ends + k + 1] - 1
                    for i in range(last * width, (last + 1) * width):
                        rows.column[i] = vec8(0.0)
                    for i in range(2 * last, 2 * last + 2):
                        for lane in range(LANES):
                            rows.body[i][lane] = padding_body
        return used

    @ti.func
    def place(w, color, jacobi, row, rows: t.Rows):
        """Put a row into the next lane of its colour; where its normal impulse lies."""
        fill = w * COLORS + color
        index = rows.color_fill[fill]
        rows.color_fill[fill] = index + 1
        block = rows.color_block[w * (COLORS + 1) + color] + index // LANES
        lane = index % LANES
        rows.body[2 * block][lane] = row.body_a
        rows.body[2 * block + 1][lane] = row.body_b
        if jacobi:
            rows.body_rows[row.body_a] = rows.body_rows[row.body_a] + 1
            rows.body_rows[row.body_b] = rows.body_rows[row.body_b] + 1
        store_row(rows, block * width, lane, row)
        return 2 * block * LANES + lane

    @ti.func
    def place_contacts(
        w,
        used,
        padding_body,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Rows of a world's contacts, those of the blocks that CHUNK contacts have filled, and the rest at last.

        A block's contacts stand where its bodies A then do, and the one that was filled before it where the last of
        its bodies B does: so the caches hold them, without a branch that is guessed wrong once a block. Empty lanes of
        a colour's last block are zero and point at the padding body.
        """
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        fill = w * COLORS
        ends = w * (COLORS + 1)
        floor = unknown_floor(config)
        begin = start
        while begin < end:
            stop = ti.min(begin + CHUNK, end)
            filled = NONE
            for c in range(begin, stop):
                color = contacts.color[c]
                index = rows.color_fill[fill + color]
                rows.color_fill[fill + color] = index + 1
                at = rows.color_block[ends + color] + (index >> LANE_BITS)
                lane = index & LAST_LANE
                rows.slot[c] = 2 * at * LANES + lane
                rows.body[2 * at][lane] = c
                rows.body[2 * at + 1][lane] = filled
                filled = ti.select(lane == LAST_LANE, at, filled)
            if stop == end:
                for color in range(used):
                    index = rows.color_fill[fill + color]
                    if (index & LAST_LANE) != 0:
                        at = rows.color_block[ends + color] + (index >> LANE_BITS)
                        for lane in range(index & LAST_LANE, LANES):
                            rows.body[2 * at][lane] = rows.body[2 * at][0]
                        rows.body[2 * at + 1][LAST_LANE] = filled
                        filled = at
            while filled != NONE:
                at = filled
                filled = rows.body[2 * at + 1][LAST_LANE]
                make_contact_rows(w, at, floor, config, model, state, motion, contacts, rows)
            begin = stop
        for color in range(used):
            index = rows.color_fill[fill + color]
            lanes = index & LAST_LANE
            if lanes != 0:
                at = rows.color_block[ends + color] + (index >> LANE_BITS)
                for k in range(at * width, (at + 1) * width):
                    for lane in range(lanes, LANES):
                        rows.column[k][lane] = 0.0
                for lane in range(lanes, LANES):
                    rows.body[2 * at][lane] = padding_body
                    rows.body[2 * at + 1][lane] = padding_body

    @kernel
    def pack_rows(
        tid,
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
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            used = lay_out(w, launch.padding_body, model, joints, contacts, rows)
            if used < 0:
                state.flags[w] = state.flags[w] | ROW_OVERFLOW
            else:
                jacobi = config.method == JACOBI
                if jacobi:
                    for b in range(model.body_start[w], model.body_start[w + 1]):
                        rows.body_rows[b] = 0
                place_contacts(w, used, launch.padding_body, config, model, state, motion, contacts, rows)
                least = 0.0
                start = contacts.contact_start[w]
                last = start + contacts.contact_count[w]
                for c in range(start, last):
                    least = ti.min(least, contacts.gap[c])
                scale = 0.0
                for lane in range(LANES):
                    squares = 0.0
                    for k in range((last - start - lane + LANES - 1) // LANES):
                        squares += rows.square[start + lane + k * LANES]
                    scale += squares
                if jacobi:
                    for c in range(start, start + contacts.contact_count[w]):
                        a = contacts.body_a[c]
                        b = contacts.body_b[c]
                        rows.body_rows[a] = rows.body_rows[a] + 1
                        rows.body_rows[b] = rows.body_rows[b] + 1
                if ti.static(jointed):
                    for j in range(rows.line_start[w], rows.line_start[w + 1]):
                        joint_row = make_distance_row(j, w, config, model, state, motion, joints)
                        if not (joint_row.gap - joint_row.gap == 0.0):
                            state.flags[w] = NONFINITE
                        if ti.static(own):
                            joint_row.direction_a = joint_row.normal
                            joint_row.most = INFINITY
                            joint_row.held = 1.0
                        rows.joint_slot[j] = place(w, joints.joint_color[j], jacobi, joint_row, rows)
                        scale += joint_row.square
                if ti.static(own):
                    for k in range(rows.row_start[w], rows.row_start[w + 1]):
                        rows.row_slot[k] = -1
                        if rows.row_lower[k] != 0.0 or rows.row_upper[k] != 0.0:
                            own_row = make_jacobian_row(k, model, motion, rows)
                            rows.row_slot[k] = place(w, rows.row_color[k], jacobi, own_row, rows)
                            scale += own_row.square
                rows.scale[w] = ti.sqrt(scale)
                rows.deepest[w] = least
                stats.colors[w] = used

    @kernel
    def unpack_impulses(
        tid,
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        rows: t.Rows,
    ):
        """Solved impulses back to contacts and joints."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            start = contacts.contact_start[w]
            for c in range(start, start + contacts.contact_count[w]):
                i = rows.slot[c]
                k = i >> LANE_BITS
                lane = i & LAST_LANE
                contacts.impulse[c] = vec2(rows.impulse[k][lane], rows.impulse[k + 1][lane])
            if ti.static(jointed):
                for j in range(rows.line_start[w], rows.line_start[w + 1]):
                    i = rows.joint_slot[j]
                    joints.joint_impulse[j] = rows.impulse[i // LANES][i % LANES]
            if ti.static(own):
                for k in range(rows.row_start[w], rows.row_start[w + 1]):
                    i = rows.row_slot[k]
                    if i < 0:
                        rows.row_impulse[k] = 0.0
                    elif rows.row_held[k] >= 0.0:
                        rows.row_impulse[k] = rows.impulse[i // LANES][i % LANES]

    return {"pack_rows": pack_rows, "unpack_impulses": unpack_impulses}
