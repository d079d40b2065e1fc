"""Rows by Jacobian (seed, 2.2.1), packed into blocks colour by colour.

J = [-n, -r_A x n, n, r_B x n] (2.21), the tangent alike (2.22), a distance joint along its line (2.20);
effective mass 1 / (J M^-1 J^T) (2.24-2.25). Velocities are V = (v_A, w_A, v_B, w_B), (6,).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, cross, dot, rotate, rotation, tangent
from dc_kernels._numpy.solve.row import by_lane
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import Flag
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES

OPEN = 1e6  # a row that lets this many times the gap close within the step never acts


def kernels(dtype: str, variant: str) -> Kernels:
    """``pack_rows`` and ``unpack_impulses``; the arrays bring their scalar type."""
    columns = COLUMNS[variant]

    def pack_rows(
        tid: int,
        world_offset: int,
        slop_factor: float,
        baumgarte: float,
        max_correction: float,
        restitution_threshold: float,
        method: int,
        body_start: Array,
        length_scale: Array,
        body_type: Array,
        inv_inertia: Array,
        padding_body: int,
        position: Array,
        angle: Array,
        velocity: Array,
        angular_velocity: Array,
        step_dt: Array,
        predicted: Array,
        joint_start: Array,
        joint_body_a: Array,
        joint_body_b: Array,
        joint_anchor_a: Array,
        joint_anchor_b: Array,
        joint_length: Array,
        joint_color: Array,
        contact_start: Array,
        contact_count: Array,
        body_a: Array,
        body_b: Array,
        normal: Array,
        arm_a: Array,
        arm_b: Array,
        gap: Array,
        friction: Array,
        restitution: Array,
        color: Array,
        flags: Array,
        block_start: Array,
        block_needed: Array,
        color_block: Array,
        color_fill: Array,
        slot: Array,
        joint_slot: Array,
        rows: Array,
        row_body: Array,
        row_scale: Array,
        deepest: Array,
        colors: Array,
        body_rows: Array,
    ) -> None:
        """Rows of a world's contacts and joints, in blocks of LANES colour by colour."""
        w = tid + world_offset
        if flags[w]:
            return
        dt = step_dt[w]
        slop = slop_factor * length_scale[w]
        limit = max_correction * length_scale[w]
        contacts = np.arange(contact_start[w], contact_start[w] + contact_count[w])
        joints = np.arange(joint_start[w], joint_start[w + 1])
        fill = color_fill[w * COLORS : (w + 1) * COLORS]
        fill[:] = np.bincount(np.concatenate([color[contacts], joint_color[joints]]), minlength=COLORS)
        ends = color_block[w * (COLORS + 1) : (w + 1) * (COLORS + 1)]
        ends[:] = block_start[w] + np.concatenate([[0], np.cumsum(-(-fill // LANES))])
        block_needed[w] = ends[-1] - ends[0]
        if ends[-1] > block_start[w + 1]:
            flags[w] |= Flag.ROW_OVERFLOW
            return
        used = slice(ends[0], ends[-1])
        by_lane(rows, len(columns))[used] = 0.0
        by_lane(row_body)[used] = padding_body
        jacobi = method == METHODS["jacobi"]
        if jacobi:
            body_rows[body_start[w] : body_start[w + 1]] = 0
        fill[:] = 0
        squares = rows.dtype.type(0)

        def place(k: int, a: int, b: int) -> tuple[int, int]:
            """Block and lane of the next row of a colour."""
            block, lane = ends[k] + fill[k] // LANES, fill[k] % LANES
            fill[k] += 1
            by_lane(row_body)[block, :, lane] = a, b
            if jacobi:
                body_rows[a] += 1
                body_rows[b] += 1
            return block, lane

        def effective_mass(j: Array, a: int, b: int) -> Any:
            """1 / (J M^-1 J^T), 0 if nothing can move."""
            ma, mb = predicted[a, 3], predicted[b, 3]
            k = (j * j) @ np.array([ma, ma, inv_inertia[a], mb, mb, inv_inertia[b]])
            return 1.0 / k if k > 0 else k

        def direction(d: Array, ra: Array, rb: Array) -> Array:
            """J of a direction at two arms."""
            return np.array([*-d, -cross(ra, d), *d, cross(rb, d)])

        def write(block: int, lane: int, n: Array, jn: Array, jt: Array, a: int, b: int, **values: Any) -> None:
            """All columns of a row, whichever the variant has."""
            values |= {"nx": n[0], "ny": n[1], "rAn": -jn[2], "rBn": jn[5], "rAt": -jt[2], "rBt": jt[5]}
            values |= {"iA": inv_inertia[a], "iB": inv_inertia[b], "dA": jt[2], "dB": jt[5]}
            values |= {"kA": inv_inertia[a] * jt[2], "kB": inv_inertia[b] * jt[5]}
            by_lane(rows, len(columns))[block, :, lane] = [values[name] for name in columns]

        for c in contacts:
            a, b, n = body_a[c], body_b[c], normal[c]
            block, lane = place(color[c], a, b)
            slot[c] = block * 2 * LANES + lane
            jn = direction(n, arm_a[c], arm_b[c])
            jt = direction(tangent(n), arm_a[c], arm_b[c])
            if variant == "discs":
                jn[[2, 5]] = 0.0  # the normal of a disc points at its centre
            v = np.concatenate([predicted[a, :3], predicted[b, :3]])
            un, ut = jn @ v, jt @ v
            en, et = effective_mass(jn, a, b), effective_mass(jt, a, b)
            g, e = gap[c], restitution[c]
            bias = g.dtype.type(0)
            if g > slop:
                bias = g / dt  # the gap may close within the step; a smaller one counts as closed
            elif baumgarte > 0 and g < -slop:
                bias = max(baumgarte * (g + slop), -limit) / dt
            counted = True
            if e > 0 and g > slop and g + un * dt >= 0:
                bias, counted = OPEN * g / dt, False  # what another impact pushes across it bounces in the next step
            elif e > 0:
                before = jn @ np.concatenate([velocity[a], [angular_velocity[a]], velocity[b], [angular_velocity[b]]])
                if before > 0:
                    # Moreau (1988): a separating contact may be left approaching with e times its speed at most
                    bias = max(bias, e * before)
                elif before < -restitution_threshold:
                    bias = min(bias, e * before)  # Newton's impact law, of the speed before the step's forces
            write(
                block, lane, n, jn, jt, a, b, en=en, et=et, bias=bias, mu=friction[c], gap=g + slop, lo=0.0
            )  # fmt: skip
            if counted:
                squares += (en * (un + bias)) ** 2 + (en * ut) ** 2

        for j in joints:
            a, b = joint_body_a[j], joint_body_b[j]
            block, lane = place(joint_color[j], a, b)
            joint_slot[j] = block * 2 * LANES + lane
            ra = rotate(rotation(angle[a]), joint_anchor_a[j])
            rb = rotate(rotation(angle[b]), joint_anchor_b[j])
            d = (position[b] + rb) - (position[a] + ra)
            length = np.sqrt(dot(d, d))
            n = d / length if length > 0 else np.array([1.0, 0.0], d.dtype)
            jn = direction(n, ra, rb)
            en = effective_mass(jn, a, b)
            un = jn @ np.concatenate([predicted[a, :3], predicted[b, :3]])
            # acceleration of the distance as line and arms turn, and what it lengthens the joint by
            wa, wb = angular_velocity[a], angular_velocity[b]
            ut = direction(tangent(n), ra, rb) @ np.array([*velocity[a], wa, *velocity[b], wb])
            bend = wa**2 * dot(n, ra) - wb**2 * dot(n, rb) + (ut**2 / length if length > 0 else 0.0)
            grow = min(max(0.5 * dt * dt * bend, -limit), limit)
            off = length - joint_length[j]
            bias = (min(max(baumgarte * off, -limit), limit) + grow) / dt
            write(
                block, lane, n, jn, np.zeros(6), a, b, en=en, et=0.0, bias=bias, mu=0.0, gap=off + grow, lo=-np.inf
            )  # fmt: skip
            squares += (en * (un + bias)) ** 2
        row_scale[w] = np.sqrt(squares)
        deepest[w] = gap[contacts].min(initial=0.0)
        colors[w] = max(color[contacts].max(initial=-1), joint_color[joints].max(initial=-1)) + 1

    def unpack_impulses(
        tid: int,
        world_offset: int,
        flags: Array,
        joint_start: Array,
        joint_slot: Array,
        contact_start: Array,
        contact_count: Array,
        slot: Array,
        row_impulse: Array,
        impulse: Array,
        joint_impulse: Array,
    ) -> None:
        """Solved impulses back to contacts and joints."""
        w = tid + world_offset
        if flags[w]:
            return
        contacts = slice(contact_start[w], contact_start[w] + contact_count[w])
        impulse[contacts, 0] = row_impulse[slot[contacts]]
        impulse[contacts, 1] = row_impulse[slot[contacts] + LANES]
        joints = slice(joint_start[w], joint_start[w + 1])
        joint_impulse[joints] = row_impulse[joint_slot[joints]]

    return {"pack_rows": pack_rows, "unpack_impulses": unpack_impulses}
