"""The iteration of a world's solve: warm start, sweep, stop, acceleration. Shared by both schedules."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.solve.adaptive import adaptive_functions
from dc_kernels._warp.solve.lanes import has_lanes, lane_functions, range_functions
from dc_kernels._warp.solve.row import row_functions
from dc_kernels.model.config import ACCELERATIONS, METHODS, STOPS
from dc_kernels.solve.iteration import ADAPT_MOMENTUM, BEST, COUNTERS, NEVER, NORMS, RETREAT
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, SERIAL_COLOR

ENDS = wp.constant(COLORS + 1)
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
SERIAL = wp.constant(SERIAL_COLOR)
JACOBI = wp.constant(METHODS["jacobi"])
AITKEN = wp.constant(ACCELERATIONS["aitken"])
NNCG = wp.constant(ACCELERATIONS["nncg"])
ADAPTIVE = wp.constant(ACCELERATIONS["adaptive"])
PLAIN = wp.constant(ACCELERATIONS["none"])
MOMENTUM = wp.constant(ADAPT_MOMENTUM)
AT_BEST = wp.constant(BEST)
NO_PAUSE = wp.constant(NEVER)
BY_RESIDUAL = wp.constant(STOPS["residual"])
N_COUNTERS = wp.constant(COUNTERS)
N_NORMS = wp.constant(NORMS)


@cache
def iteration_functions(dtype: str, variant: str) -> SimpleNamespace:
    """The parts of a solve: start, sweep, the end of a period and of a sweep, the residual."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("solver", dtype, variant)
    row = row_functions(dtype, variant)
    lanes = lane_functions(dtype, variant, COLUMNS[variant])
    ranges = range_functions(dtype)
    sweep_row, jacobi_row, apply_row = row["sweep_row"], row["jacobi_row"], row["apply_row"]
    natural_map_row = row["natural_map_row"]
    sweep_lanes, apply_lanes = lanes["sweep"], lanes["apply"]
    extrapolate = lanes["extrapolate"]
    squares, conjugate = ranges["squares"], ranges["conjugate"]
    joints = variant == "joints"
    huge = real(3e38)
    zero = real(0.0)
    tiny = real(1e-30)

    @wp.func(module=module)
    def change_bound(tolerance: real, relative: real, stop: int):
        """What a world's stop is compared with: without weight only the tolerance counts."""
        if stop != BY_RESIDUAL and relative > zero:
            return wp.min(tolerance, relative)
        return tolerance

    @wp.func(module=module)
    def sweep_world(
        w: int,
        method: int,
        omega: real,
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        body_rows: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
    ):
        """One sweep over all rows of a world in colour order; the largest impulse change [N s]."""
        first = color_block[w * ENDS]
        serial = color_block[w * ENDS + SERIAL]
        last = color_block[w * ENDS + N_COLORS]
        change = real(0.0)
        if method == JACOBI:
            for block in range(first, last):
                for lane in range(N_LANES):
                    change = wp.max(
                        change,
                        jacobi_row(
                            block, lane, rows, row_body, solved, body_rows, row_impulse, row_change, summed, omega
                        ),
                    )
            return change
        if has_lanes() == 1:
            change = sweep_lanes(rows, row_body, solved, row_impulse, row_change, first, serial, omega)
            first = serial
        for block in range(first, last):
            for lane in range(N_LANES):
                change = wp.max(change, sweep_row(block, lane, rows, row_body, solved, row_impulse, row_change, omega))
        return change

    @wp.func(module=module)
    def apply_world(
        w: int,
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        delta: wp.array(dtype=real),
    ):
        """Velocities follow a change of all row impulses of a world."""
        first = color_block[w * ENDS]
        serial = color_block[w * ENDS + SERIAL]
        last = color_block[w * ENDS + N_COLORS]
        if has_lanes() == 1:
            apply_lanes(rows, row_body, solved, delta, first, serial)
            first = serial
        for block in range(first, last):
            for lane in range(N_LANES):
                apply_row(block, lane, rows, row_body, solved, delta)

    @wp.func(module=module)
    def end_period(
        w: int,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        patience: int,
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        move: int,
    ):
        """The end of an Aitken period: extrapolate, unless ``move`` is 0, and choose the length of the next."""
        q = w * N_COUNTERS
        p = w * N_NORMS
        i0 = color_block[w * ENDS] * 2 * N_LANES
        i1 = color_block[w * ENDS + N_COLORS] * 2 * N_LANES
        before = norms[p + 1]
        now = squares(row_change, i0, i1)
        if now < before and move == 1:
            ratio = wp.sqrt(now / before)
            alpha = cap
            if ratio < cap * (real(1.0) - ratio):
                alpha = ratio / (real(1.0) - ratio)
            extrapolate(rows, row_impulse, row_change, color_block[w * ENDS], color_block[w * ENDS + N_COLORS], alpha)
            apply_world(w, color_block, rows, row_body, solved, row_change)
        period = counters[q + 2]
        if now > threshold * threshold * norms[p + 2]:
            period = wp.min(2 * period, period_max)
        else:
            period = wp.max(period_min, period / 2)
        norms[p + 2] = now
        counters[q + 2] = period
        inside = int(0)
        stalled = counters[q + 4] + 1
        if now < norms[p + 3]:
            norms[p + 3] = now
            stalled = 0
        if stalled >= patience:
            inside = -counters[q + 5]
            counters[q + 5] = 2 * counters[q + 5]
            stalled = 0
        counters[q + 4] = stalled
        counters[q + 1] = inside

    adaptive = adaptive_functions(dtype, variant, apply_world, end_period, extrapolate)
    adapt, refresh, reset_adaptive = adaptive.adapt, adaptive.refresh, adaptive.reset_adaptive

    @wp.func(module=module)
    def natural_map(
        w: int,
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        scale: real,
    ):
        """Relative natural map: its 2-norm over that of the impulses a frictional stop of each row alone would take."""
        total = real(0.0)
        for block in range(color_block[w * ENDS], color_block[w * ENDS + N_COLORS]):
            for lane in range(N_LANES):
                total += natural_map_row(block, lane, rows, row_body, solved, row_impulse)
        total = wp.sqrt(total)
        if scale > tiny:
            total = total / scale
        return total

    @wp.func(module=module)
    def load_impulses(
        w: int,
        # Model, joints, contacts:
        body_start: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        impulse: wp.array(dtype=vec2),
        predicted: wp.array(dtype=vec4),
        # rows:
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        # out:
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
    ):
        """Impulses of contacts and joints to the rows; predicted velocities plus what they add."""
        for i in range(color_block[w * ENDS] * 2 * N_LANES, color_block[w * ENDS + N_COLORS] * 2 * N_LANES):
            row_impulse[i] = real(0.0)
        start = contact_start[w]
        for c in range(start, start + contact_count[w]):
            i = slot[c]
            row_impulse[i] = impulse[c][0]
            row_impulse[i + N_LANES] = impulse[c][1]
        if wp.static(joints):
            for j in range(joint_start[w], joint_start[w + 1]):
                row_impulse[joint_slot[j]] = joint_impulse[j]
        refresh(w, body_start, color_block, rows, row_body, predicted, solved, row_impulse)

    @wp.func(module=module)
    def start_world(
        w: int,
        period: int,
        period_max: int,
        # Model, joints, contacts:
        body_start: wp.array(dtype=wp.int32),
        joint_start: wp.array(dtype=wp.int32),
        joint_slot: wp.array(dtype=wp.int32),
        joint_impulse: wp.array(dtype=real),
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        slot: wp.array(dtype=wp.int32),
        impulse: wp.array(dtype=vec2),
        predicted: wp.array(dtype=vec4),
        # rows:
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        # out:
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """Warm start: the iteration from the beginning."""
        load_impulses(
            w, body_start, joint_start, joint_slot, joint_impulse, contact_start, contact_count, slot, impulse,
            predicted, color_block, rows, row_body, solved, row_impulse,
        )  # fmt: skip
        q = w * N_COUNTERS
        counters[q] = 0
        counters[q + 1] = 0
        counters[q + 2] = period
        counters[q + 3] = 0
        counters[q + 4] = 0
        counters[q + 5] = 2 * period_max
        counters[q + 6] = 0
        counters[q + 7] = -1
        p = w * N_NORMS
        norms[p] = real(0.0)
        for i in range(1, N_NORMS):
            norms[p + i] = huge
        reset_adaptive(w, counters, norms)

    @wp.func(module=module)
    def prepare_sweep(
        w: int,
        method: int,
        body_start: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
    ):
        """A place to sum up Jacobi's changes."""
        if method == JACOBI:
            for b in range(body_start[w], body_start[w + 1]):
                summed[b] = solved[b]

    @wp.func(module=module)
    def conclude_sweep(
        w: int,
        change: real,
        method: int,
        acceleration: int,
        max_sweeps: int,
        min_sweeps: int,
        tolerance: real,
        stop: int,
        residual_every: int,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        patience: int,
        stretch: int,
        history_at: int,
        pause_at: int,
        body_start: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        row_scale: wp.array(dtype=real),
        predicted: wp.array(dtype=vec4),
        solved: wp.array(dtype=vec4),
        summed: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        row_before: wp.array(dtype=real),
        row_direction: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
        history: wp.array2d(dtype=real),
    ):
        """Stop, pause or accelerate; 1 when the world is done, 2 where it pauses.

        A pause is due from ``pause_at`` sweeps on, where the steps of the last two are known: with Aitken at the end of
        a period.
        """
        q = w * N_COUNTERS
        p = w * N_NORMS
        if method == JACOBI:
            for b in range(body_start[w], body_start[w + 1]):
                solved[b] = summed[b]
        sweeps = counters[q]
        if history.shape[1] > sweeps:
            history[w, sweeps] = change
        sweeps += 1
        counters[q] = sweeps
        norms[p] = change
        done = int(0)
        if sweeps < min_sweeps:
            done = 0
        elif stop == BY_RESIDUAL:
            if sweeps % residual_every == 0 or sweeps >= max_sweeps:
                if natural_map(w, color_block, rows, row_body, solved, row_impulse, row_scale[w]) < tolerance:
                    done = 1
        elif change < tolerance:
            done = 1
        if sweeps >= max_sweeps:
            done = 1
        counters[q + 3] = done
        i0 = color_block[w * ENDS] * 2 * N_LANES
        i1 = color_block[w * ENDS + N_COLORS] * 2 * N_LANES
        anew = done == 1 and acceleration == ADAPTIVE and counters[q + 9] == MOMENTUM
        if acceleration != PLAIN and pause_at == NO_PAUSE:
            first = acceleration == ADAPTIVE and counters[q + 8] == 0
            best = history_at + AT_BEST * (i1 - i0)
            if (first or 2 * sweeps > max_sweeps) and change < real(0.9) * norms[p + 20]:
                norms[p + 20] = change
                for i in range(i0, i1):
                    row_history[best + i - i0] = row_impulse[i]
            # where plain sweeps circle, as they may with much friction, extrapolation can lead far off, and to NaN
            if sweeps >= max_sweeps and norms[p + 20] < huge and not (change <= real(RETREAT) * norms[p + 20]):
                for i in range(i0, i1):
                    row_impulse[i] = row_history[best + i - i0]
                norms[p] = norms[p + 20]
                anew = True
        if done == 1:
            if anew:
                refresh(w, body_start, color_block, rows, row_body, predicted, solved, row_impulse)
            return 1
        inside = counters[q + 1] + 1
        if acceleration == AITKEN:
            counters[q + 1] = inside
            period = counters[q + 2]
            if inside == period - 1:
                norms[p + 1] = squares(row_change, i0, i1)
                if sweeps >= pause_at - 1:
                    for i in range(i0, i1):
                        row_before[i] = row_change[i]
            if inside >= period:
                if sweeps >= pause_at:  # the extrapolation waits: it is made when the solve goes on
                    counters[q + 6] = 1
                    norms[p + 4] = norms[p + 1]
                    norms[p + 5] = squares(row_change, i0, i1)
                    return 2
                end_period(
                    w, period_min, period_max, cap, threshold, patience, color_block, rows, row_body, solved,
                    row_impulse, row_change, counters, norms, 1,
                )  # fmt: skip
        if acceleration == ADAPTIVE:
            adapt(
                w, stretch, history_at, period_min, period_max, cap, threshold, body_start, color_block, rows, row_body,
                predicted, solved, row_impulse, row_change, row_history, counters, norms,
            )  # fmt: skip
        if acceleration == NNCG:
            now = squares(row_change, i0, i1)
            beta = real(0.0)
            if sweeps > 1 and now <= norms[p + 2] and norms[p + 2] > real(0.0):
                beta = now / norms[p + 2]
            norms[p + 2] = now
            conjugate(row_impulse, row_change, row_direction, i0, i1, beta)
            if beta > real(0.0):
                apply_world(w, color_block, rows, row_body, solved, row_change)
        if sweeps >= pause_at - 1 and (acceleration != AITKEN or inside < 0):
            norms[p + 4] = norms[p + 5]
            norms[p + 5] = squares(row_change, i0, i1)
            if sweeps >= pause_at and counters[q + 7] == sweeps - 1:
                return 2
            counters[q + 7] = sweeps
            for i in range(i0, i1):
                row_before[i] = row_change[i]
        return 0

    return SimpleNamespace(
        change_bound=change_bound,
        load_impulses=load_impulses,
        start_world=start_world,
        prepare_sweep=prepare_sweep,
        sweep_world=sweep_world,
        end_period=end_period,
        conclude_sweep=conclude_sweep,
        natural_map=natural_map,
    )
