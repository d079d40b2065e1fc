"""The iteration on packed rows: warm start -> sweeps -> stop, in two schedules of one arithmetic.

``solve_world`` runs a world's whole solve in one thread. The other kernels are the same solve cut at the colours:
``begin``, then for each sweep ``before_sweep``, ``sweep_color`` colour by colour, ``after_sweep``, and ``finish``.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.solve.iteration import iteration_functions
from dc_kernels._warp.solve.lanes import has_lanes, lane_functions
from dc_kernels._warp.solve.row import row_functions
from dc_kernels.model.config import ACCELERATIONS, METHODS
from dc_kernels.solve.iteration import COUNTERS, NEVER, NORMS
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, SERIAL_COLOR

ENDS = wp.constant(COLORS + 1)
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
SERIAL = wp.constant(SERIAL_COLOR)
JACOBI = wp.constant(METHODS["jacobi"])
NNCG = wp.constant(ACCELERATIONS["nncg"])
NO_PAUSE = wp.constant(NEVER)
N_COUNTERS = wp.constant(COUNTERS)
N_NORMS = wp.constant(NORMS)


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """All solver kernels of a scalar type and row variant."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("solver", dtype, variant)
    iteration = iteration_functions(dtype, variant)
    load_impulses, start_world, natural_map = iteration.load_impulses, iteration.start_world, iteration.natural_map
    end_period, change_bound = iteration.end_period, iteration.change_bound
    prepare_sweep, sweep_world, conclude_sweep = (
        iteration.prepare_sweep,
        iteration.sweep_world,
        iteration.conclude_sweep,
    )
    row = row_functions(dtype, variant)
    sweep_row, jacobi_row, push_row = row["sweep_row"], row["jacobi_row"], row["push_row"]
    push_lanes = lane_functions(dtype, variant, COLUMNS[variant])["push"]
    joints = variant == "joints"

    @wp.kernel(module=module, enable_backward=False)
    def solve_world(
        world_offset: int,
        method: int,
        acceleration: int,
        max_sweeps: int,
        min_sweeps: int,
        tolerance: real,
        relative_tolerance: real,
        stop: int,
        residual_every: int,
        omega: real,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        patience: int,
        stretch: int,
        history_offset: int,
        history_step: int,
        resume: int,
        pause: int,
        # Model, state, joints, contacts:
        step_dt: wp.array(dtype=real),
        weight: wp.array(dtype=real),
        body_start: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        impulse: wp.array(dtype=vec2),
        predicted: wp.array(dtype=vec4),
        replaced: wp.array(dtype=wp.int32),
        # rows:
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        row_scale: wp.array(dtype=real),
        body_rows: wp.array(dtype=wp.int32),
        # Scratch:
        summed: wp.array(dtype=vec4),
        row_change: wp.array(dtype=real),
        row_before: wp.array(dtype=real),
        row_direction: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        # out:
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        history: wp.array2d(dtype=real),
        sweeps: wp.array(dtype=wp.int32),
        change: wp.array(dtype=real),
        residual: wp.array(dtype=real),
    ):
        """The solve of a world, to its end or to a pause after some ``pause`` sweeps; ``resume`` goes on from there.

        Without ``replaced`` a solve that pauses ends with the bits of one that does not.
        """
        tid = wp.tid()
        w = tid + world_offset
        history_at = history_offset + tid * history_step
        if flags[w] != 0:
            return
        bound = change_bound(tolerance, relative_tolerance * weight[w] * step_dt[w], stop)
        done = int(0)
        if resume == 0:
            start_world(
                w, period_min, period_max, body_start, joint_start, joint_slot, joint_impulse, contact_start,
                contact_count, slot, impulse, predicted, color_block, rows, row_body, solved, row_impulse, counters,
                norms,
            )  # fmt: skip
            if max_sweeps == 0 or color_block[w * ENDS] == color_block[w * ENDS + N_COLORS]:
                counters[w * N_COUNTERS + 3] = 1
                done = 1
        else:
            if counters[w * N_COUNTERS + 3] == 1:
                return
            anew = replaced[w]
            if anew == 1:
                replaced[w] = 0
                load_impulses(
                    w, body_start, joint_start, joint_slot, joint_impulse, contact_start, contact_count, slot, impulse,
                    predicted, color_block, rows, row_body, solved, row_impulse,
                )  # fmt: skip
                if acceleration == NNCG:
                    norms[w * N_NORMS + 2] = real(0.0)  # the direction belongs to the impulses before
            if counters[w * N_COUNTERS + 6] == 1:
                counters[w * N_COUNTERS + 6] = 0
                end_period(
                    w, period_min, period_max, cap, threshold, patience, color_block, rows, row_body, solved,
                    row_impulse, row_change, counters, norms, 1 - anew,
                )  # fmt: skip
        pause_at = NO_PAUSE
        if pause < NO_PAUSE:
            pause_at = counters[w * N_COUNTERS] + pause
            if pause == 0 and done == 0:
                done = 2
        while done == 0:
            prepare_sweep(w, method, body_start, solved, summed)
            largest = sweep_world(
                w, method, omega, color_block, rows, row_body, body_rows, solved, summed, row_impulse, row_change
            )
            done = conclude_sweep(
                w, largest, method, acceleration, max_sweeps, min_sweeps, bound, stop, residual_every, period_min,
                period_max, cap, threshold, patience, stretch, history_at, pause_at, body_start, color_block, rows,
                row_body, row_scale, predicted, solved, summed, row_impulse, row_change, row_before, row_direction,
                row_history, counters, norms, history,
            )  # fmt: skip
        done_sweeps = counters[w * N_COUNTERS]
        sweeps[w] = done_sweeps
        change[w] = norms[w * N_NORMS]
        if done == 1:
            for k in range(done_sweeps, history.shape[1]):
                history[w, k] = real(0.0)
            residual[w] = natural_map(w, color_block, rows, row_body, solved, row_impulse, row_scale[w])

    @wp.kernel(module=module, enable_backward=False)
    def begin(
        world_offset: int,
        period_min: int,
        period_max: int,
        max_sweeps: int,
        body_start: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        impulse: wp.array(dtype=vec2),
        predicted: wp.array(dtype=vec4),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        # out:
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """Colour schedule: warm start."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        start_world(
            w, period_min, period_max, body_start, joint_start, joint_slot, joint_impulse, contact_start, contact_count,
            slot, impulse, predicted, color_block, rows, row_body, solved, row_impulse, counters, norms,
        )  # fmt: skip
        if max_sweeps == 0 or color_block[w * ENDS] == color_block[w * ENDS + N_COLORS]:
            counters[w * N_COUNTERS + 3] = 1

    @wp.kernel(module=module, enable_backward=False)
    def before_sweep(
        world_offset: int,
        method: int,
        body_start: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """Colour schedule: what a sweep needs to know of the state before it."""
        w = wp.tid() + world_offset
        if flags[w] != 0 or counters[w * N_COUNTERS + 3] != 0:
            return
        prepare_sweep(w, method, body_start, solved, summed)
        norms[w * N_NORMS] = real(0.0)

    @wp.kernel(module=module, enable_backward=False)
    def sweep_color(
        world_offset: int,
        color: int,
        method: int,
        omega: real,
        flags: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        body_rows: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """Colour schedule: one thread a row of the colour; the serial colour is one thread's."""
        tid_world, i = wp.tid()
        w = tid_world + world_offset
        if flags[w] != 0 or counters[w * N_COUNTERS + 3] != 0:
            return
        first = color_block[w * ENDS + color]
        rows_here = (color_block[w * ENDS + color + 1] - first) * N_LANES
        last = wp.min(i + 1, rows_here)
        if color == SERIAL:
            if i > 0:
                return
            last = rows_here
        change = real(0.0)
        for k in range(i, last):
            block = first + k / N_LANES
            lane = k % N_LANES
            if method == JACOBI:
                change = wp.max(
                    change,
                    jacobi_row(block, lane, rows, row_body, solved, body_rows, row_impulse, row_change, summed, omega),
                )
            else:
                change = wp.max(change, sweep_row(block, lane, rows, row_body, solved, row_impulse, row_change, omega))
        if change > real(0.0):
            wp.atomic_max(norms, w * N_NORMS, change)

    @wp.kernel(module=module, enable_backward=False)
    def after_sweep(
        world_offset: int,
        method: int,
        acceleration: int,
        max_sweeps: int,
        min_sweeps: int,
        tolerance: real,
        relative_tolerance: real,
        stop: int,
        residual_every: int,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        patience: int,
        stretch: int,
        history_offset: int,
        history_step: int,
        step_dt: wp.array(dtype=real),
        weight: wp.array(dtype=real),
        body_start: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        row_scale: wp.array(dtype=real),
        predicted: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
        row_change: wp.array(dtype=real),
        row_before: wp.array(dtype=real),
        row_direction: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        history: wp.array2d(dtype=real),
    ):
        """Colour schedule: stop or accelerate."""
        tid = wp.tid()
        w = tid + world_offset
        history_at = history_offset + tid * history_step
        if flags[w] != 0 or counters[w * N_COUNTERS + 3] != 0:
            return
        bound = change_bound(tolerance, relative_tolerance * weight[w] * step_dt[w], stop)
        conclude_sweep(
            w, norms[w * N_NORMS], method, acceleration, max_sweeps, min_sweeps, bound, stop, residual_every,
            period_min, period_max, cap, threshold, patience, stretch, history_at, NO_PAUSE, body_start, color_block,
            rows, row_body, row_scale, predicted, solved, summed, row_impulse, row_change, row_before, row_direction,
            row_history, counters, norms, history,
        )  # fmt: skip

    @wp.kernel(module=module, enable_backward=False)
    def finish(
        world_offset: int,
        flags: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        row_scale: wp.array(dtype=real),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        # out:
        history: wp.array2d(dtype=real),
        sweeps: wp.array(dtype=wp.int32),
        change: wp.array(dtype=real),
        residual: wp.array(dtype=real),
    ):
        """Colour schedule: what the solve reports."""
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        done_sweeps = counters[w * N_COUNTERS]
        sweeps[w] = done_sweeps
        for k in range(done_sweeps, history.shape[1]):
            history[w, k] = real(0.0)
        change[w] = norms[w * N_NORMS]
        residual[w] = natural_map(w, color_block, rows, row_body, solved, row_impulse, row_scale[w])

    @wp.kernel(module=module, enable_backward=False)
    def correct_positions(
        world_offset: int,
        iterations: int,
        factor: real,
        max_correction: real,
        slop_factor: real,
        length_scale: wp.array(dtype=real),
        flags: wp.array(dtype=wp.int32),
        deepest: wp.array(dtype=real),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        # in, out:
        displacement: wp.array(dtype=vec4),
    ):
        """Position phase after the velocities (nonlinear projection, Box2D 2.3): displacements that undo overlap.

        Gaps are those of the narrowphase plus what the displacement changes them by to first order; it ends as soon as
        a sweep pushes nothing. Without joints it is skipped where the step began with no overlap beyond the slop: what
        an unconverged solve adds is met in the next step.
        """
        w = wp.tid() + world_offset
        if flags[w] != 0:
            return
        if wp.static(not joints):
            if deepest[w] >= -slop_factor * length_scale[w]:
                return
        limit = max_correction * length_scale[w]
        serial = color_block[w * ENDS + SERIAL]
        last = color_block[w * ENDS + N_COLORS]
        iteration = int(0)
        pushed = real(1.0)
        while iteration < iterations and pushed > real(0.0):
            first = color_block[w * ENDS]
            pushed = real(0.0)
            if has_lanes() == 1:
                pushed = push_lanes(rows, row_body, displacement, first, serial, factor, limit)
                first = serial
            for block in range(first, last):
                for lane in range(N_LANES):
                    pushed = wp.max(pushed, push_row(block, lane, rows, row_body, displacement, factor, limit))
            iteration += 1

    return {
        "solve_world": solve_world,
        "begin": begin,
        "before_sweep": before_sweep,
        "sweep_color": sweep_color,
        "after_sweep": after_sweep,
        "finish": finish,
        "correct_positions": correct_positions,
    }
