"""The iteration on packed rows: warm start -> sweeps -> stop, whole (``solve_world``) or cut at the colours."""

from __future__ import annotations

from functools import partial

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.solve import iteration
from dc_kernels._numpy.solve.iteration import (
    JACOBI,
    NNCG,
    blocks_of,
    change_bound,
    conclude_sweep,
    end_period,
    load_impulses,
    natural_map,
    prepare_sweep,
    start_world,
)
from dc_kernels._numpy.solve.row import by_lane, jacobi_row, push_row, read_row, sweep_row
from dc_kernels.solve.iteration import COUNTERS, NEVER, NORMS
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR


def kernels(dtype: str, variant: str) -> Kernels:
    """All solver kernels of a row variant; the arrays bring their scalar type."""
    world_rows = partial(iteration.world_rows, variant)

    def solve_world(
        tid: int,
        world_offset: int,
        method: int,
        acceleration: int,
        max_sweeps: int,
        min_sweeps: int,
        tolerance: float,
        relative_tolerance: float,
        stop: int,
        residual_every: int,
        omega: float,
        period_min: int,
        period_max: int,
        cap: float,
        threshold: float,
        patience: int,
        stretch: int,
        history_offset: int,
        history_step: int,
        resume: int,
        pause: int,
        step_dt: Array,
        weight: Array,
        body_start: Array,
        flags: Array,
        joint_start: Array,
        joint_slot: Array,
        joint_impulse: Array,
        contact_start: Array,
        contact_count: Array,
        slot: Array,
        impulse: Array,
        predicted: Array,
        replaced: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        row_scale: Array,
        body_rows: Array,
        summed: Array,
        row_change: Array,
        row_before: Array,
        row_direction: Array,
        row_history: Array,
        counters: Array,
        norms: Array,
        solved: Array,
        row_impulse: Array,
        history: Array,
        sweeps: Array,
        change: Array,
        residual: Array,
    ) -> None:
        """The solve of a world, to its end or to a pause, or on from there."""
        w = tid + world_offset
        history_at = history_offset + tid * history_step
        if flags[w]:
            return
        bound = change_bound(tolerance, relative_tolerance * weight[w] * step_dt[w], stop)
        world = world_rows(w, color_block, rows, row_body, predicted)
        counter = counters[w * COUNTERS : (w + 1) * COUNTERS]
        if not resume:
            start_world(
                w, period_min, period_max, world, body_start, joint_start, joint_slot, joint_impulse, contact_start,
                contact_count, slot, impulse, predicted, color_block, solved, row_impulse, counters, norms,
            )  # fmt: skip
            counter[3] = int(max_sweeps == 0 or not world)
        elif counter[3]:
            return
        else:
            anew = bool(replaced[w])
            replaced[w] = 0
            if anew:
                load_impulses(
                    w, world, body_start, joint_start, joint_slot, joint_impulse, contact_start, contact_count, slot,
                    impulse, predicted, color_block, solved, row_impulse,
                )  # fmt: skip
                if acceleration == NNCG:
                    norms[w * NORMS + 2] = 0.0
            if counter[6]:
                counter[6] = 0
                end_period(
                    w, world, period_min, period_max, cap, threshold, patience, color_block, solved, row_impulse,
                    row_change, counters, norms, not anew,
                )  # fmt: skip
        pause_at = counter[0] + pause if pause < NEVER else NEVER
        paused = pause == 0
        while not (counter[3] or paused):
            prepare_sweep(w, method, body_start, solved, summed)
            by_lane(row_change)[blocks_of(w, color_block)] = 0.0  # of empty lanes too
            if method == JACOBI:
                changes = (jacobi_row(row, solved, body_rows, row_impulse, row_change, summed, omega) for row in world)
            else:
                changes = (sweep_row(row, solved, row_impulse, row_change, omega) for row in world)
            largest = max(changes)
            paused = conclude_sweep(
                w, largest, world, method, acceleration, max_sweeps, min_sweeps, bound, stop, residual_every,
                period_min, period_max, cap, threshold, patience, stretch, history_at, pause_at, body_start,
                color_block, row_scale, predicted, solved, summed, row_impulse, row_change, row_before, row_direction,
                row_history, counters, norms, history,
            )  # fmt: skip
        sweeps[w] = counter[0]
        change[w] = norms[w * NORMS]
        if counter[3]:
            history[w, sweeps[w] :] = 0.0
            residual[w] = natural_map(world, solved, row_impulse, row_scale[w])

    def begin(
        tid: int,
        world_offset: int,
        period_min: int,
        period_max: int,
        max_sweeps: int,
        body_start: Array,
        flags: Array,
        joint_start: Array,
        joint_slot: Array,
        joint_impulse: Array,
        contact_start: Array,
        contact_count: Array,
        slot: Array,
        impulse: Array,
        predicted: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        solved: Array,
        row_impulse: Array,
        counters: Array,
        norms: Array,
    ) -> None:
        """Colour schedule: warm start."""
        w = tid + world_offset
        if flags[w]:
            return
        world = world_rows(w, color_block, rows, row_body, predicted)
        start_world(
            w, period_min, period_max, world, body_start, joint_start, joint_slot, joint_impulse, contact_start,
            contact_count, slot, impulse, predicted, color_block, solved, row_impulse, counters, norms,
        )  # fmt: skip
        if max_sweeps == 0 or not world:
            counters[w * COUNTERS + 3] = 1

    def before_sweep(
        tid: int,
        world_offset: int,
        method: int,
        body_start: Array,
        flags: Array,
        solved: Array,
        summed: Array,
        counters: Array,
        norms: Array,
    ) -> None:
        """Colour schedule: what precedes a sweep."""
        w = tid + world_offset
        if flags[w] or counters[w * COUNTERS + 3]:
            return
        prepare_sweep(w, method, body_start, solved, summed)
        norms[w * NORMS] = 0.0

    def sweep_color(
        tid: tuple[int, int],
        world_offset: int,
        color: int,
        method: int,
        omega: float,
        flags: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        body_rows: Array,
        solved: Array,
        summed: Array,
        row_impulse: Array,
        row_change: Array,
        counters: Array,
        norms: Array,
    ) -> None:
        """Colour schedule: one thread a row of the colour; the serial colour is one thread's."""
        w = tid[0] + world_offset
        if flags[w] or counters[w * COUNTERS + 3]:
            return
        first, last = color_block[w * (COLORS + 1) + color : w * (COLORS + 1) + color + 2]
        there = range((last - first) * LANES)
        mine = there if color == SERIAL_COLOR and tid[1] == 0 else there[tid[1] : tid[1] + 1]
        if color == SERIAL_COLOR and tid[1] > 0:
            return
        for i in mine:
            block, lane = int(first) + i // LANES, i % LANES
            row = read_row(variant, block, lane, rows, row_body, solved)
            if row is None:
                by_lane(row_change)[block, :, lane] = 0.0
                continue
            if method == JACOBI:
                change = jacobi_row(row, solved, body_rows, row_impulse, row_change, summed, omega)
            else:
                change = sweep_row(row, solved, row_impulse, row_change, omega)
            norms[w * NORMS] = max(norms[w * NORMS], change)

    def after_sweep(
        tid: int,
        world_offset: int,
        method: int,
        acceleration: int,
        max_sweeps: int,
        min_sweeps: int,
        tolerance: float,
        relative_tolerance: float,
        stop: int,
        residual_every: int,
        period_min: int,
        period_max: int,
        cap: float,
        threshold: float,
        patience: int,
        stretch: int,
        history_offset: int,
        history_step: int,
        step_dt: Array,
        weight: Array,
        body_start: Array,
        flags: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        row_scale: Array,
        predicted: Array,
        summed: Array,
        row_change: Array,
        row_before: Array,
        row_direction: Array,
        row_history: Array,
        solved: Array,
        row_impulse: Array,
        counters: Array,
        norms: Array,
        history: Array,
    ) -> None:
        """Colour schedule: stop or accelerate."""
        w = tid + world_offset
        history_at = history_offset + tid * history_step
        if flags[w] or counters[w * COUNTERS + 3]:
            return
        bound = change_bound(tolerance, relative_tolerance * weight[w] * step_dt[w], stop)
        world = world_rows(w, color_block, rows, row_body, solved)
        conclude_sweep(
            w, norms[w * NORMS], world, method, acceleration, max_sweeps, min_sweeps, bound, stop, residual_every,
            period_min, period_max, cap, threshold, patience, stretch, history_at, NEVER, body_start, color_block,
            row_scale, predicted, solved, summed, row_impulse, row_change, row_before, row_direction, row_history,
            counters, norms, history,
        )  # fmt: skip

    def finish(
        tid: int,
        world_offset: int,
        flags: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        row_scale: Array,
        solved: Array,
        row_impulse: Array,
        counters: Array,
        norms: Array,
        history: Array,
        sweeps: Array,
        change: Array,
        residual: Array,
    ) -> None:
        """Colour schedule: what the solve reports."""
        w = tid + world_offset
        if flags[w]:
            return
        sweeps[w] = counters[w * COUNTERS]
        history[w, sweeps[w] :] = 0.0
        change[w] = norms[w * NORMS]
        world = world_rows(w, color_block, rows, row_body, solved)
        residual[w] = natural_map(world, solved, row_impulse, row_scale[w])

    def correct_positions(
        tid: int,
        world_offset: int,
        iterations: int,
        factor: float,
        max_correction: float,
        slop_factor: float,
        length_scale: Array,
        flags: Array,
        deepest: Array,
        color_block: Array,
        rows: Array,
        row_body: Array,
        displacement: Array,
    ) -> None:
        """Position phase after the velocities (nonlinear projection, Box2D 2.3): displacements that undo overlap.

        Without joints it is skipped where the step began with no overlap beyond the slop.
        """
        w = tid + world_offset
        if flags[w]:
            return
        if variant != "joints" and deepest[w] >= -slop_factor * length_scale[w]:
            return
        limit = max_correction * length_scale[w]
        world = world_rows(w, color_block, rows, row_body, displacement)
        for _ in range(iterations):
            if not max((push_row(row, displacement, factor, limit) for row in world), default=0.0) > 0.0:
                break

    return {
        "solve_world": solve_world,
        "begin": begin,
        "before_sweep": before_sweep,
        "sweep_color": sweep_color,
        "after_sweep": after_sweep,
        "finish": finish,
        "correct_positions": correct_positions,
    }
