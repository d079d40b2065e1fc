"""Acceleration "adaptive": Aitken extrapolation, momentum or Anderson's update, whichever has paid most.

A solve is cut into stretches. The step of the first sweep after a stretch tells by how much a sweep of it shrank the
error; the next stretch goes to the method with the best rate, and one that rests gains on it, so that it is tried again
when the active set has changed. The first stretch is Aitken's: most solves end in it and cost no more than with Aitken.

Momentum is Nesterov's with restart, as in FISTA, but without projection between sweeps, which project anyway: so the
velocities follow by linearity, without a pass over the contacts, and a sweep with it costs a fifth more. Anderson's
update looks back on two periods of three sweeps; where the next step grew it rests, and Aitken's stands in.

Tried on 460 states of piles of discs (100 and 1 000), mixed bodies, mass ratios of 1e4, a stack and a pyramid; sweeps
to a natural map of 1e-4, geometric mean of the scenes' means, of which this takes 203 and Aitken 299:

- Momentum, Aitken in between where it stalls: 202, by the stack (5 times fewer than Aitken); on discs no fewer sweeps,
  each dearer. Anderson alone, safeguarded: 243, by the stack; mixed bodies and mass ratios take more than with Aitken.
- Anderson without a safeguard (3, 5 or 8 back, every 3 to 5 sweeps): up to a sixth of the states hit the cap.
- SOR with a factor chosen by the rate (Young): between fixed factors. 1.7 stalls on 13 of 71 states of 100 discs, 1.9
  on 54: with friction a pile's active set cycles.
- The methods in turns without a choice: 218, and twice as many states at the cap. Stretches of 30: 227, of 80 to 240:
  203-221. One iterate to look back on: 219; three: 202; five: 209.
- Newton's method on the states that hit a cap: see ``newton``; worth its factorisations for 1e-6 and less only.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.solve.lanes import range_functions
from dc_kernels.solve.iteration import (
    ADAPT_AITKEN,
    ADAPT_ANDERSON,
    ADAPT_MOMENTUM,
    ANDERSON_PERIOD,
    ANDERSON_REST,
    ANDERSON_REST_MAX,
    COUNTERS,
    HISTORY,
    NEVER,
    NORMS,
)
from dc_kernels.solve.rows import COLORS, LANES

ENDS = wp.constant(COLORS + 1)
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
N_HISTORY = wp.constant(HISTORY)
N_COUNTERS = wp.constant(COUNTERS)
N_NORMS = wp.constant(NORMS)
AITKEN = wp.constant(ADAPT_AITKEN)
MOMENTUM = wp.constant(ADAPT_MOMENTUM)
ANDERSON = wp.constant(ADAPT_ANDERSON)
PERIOD = wp.constant(ANDERSON_PERIOD)
REST = wp.constant(ANDERSON_REST)
REST_MAX = wp.constant(ANDERSON_REST_MAX)
ALWAYS = wp.constant(NEVER)


@cache
def adaptive_functions(dtype: str, variant: str, apply_world, end_period, extrapolate) -> SimpleNamespace:
    """``adapt``, what follows a sweep, ``refresh`` and ``reset_adaptive``.

    Args:
        dtype: "float32" or "float64".
        variant: of the rows.
        apply_world: velocities follow impulses.
        end_period: of Aitken's extrapolation.
        extrapolate: x <- clamp(x + alpha change).
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    module = kernel_module("solver", dtype, variant)
    ranges = range_functions(dtype)
    squares, along = ranges["squares"], ranges["along"]
    onward, onward_bodies = ranges["onward"], ranges["onward_bodies"]
    products, combine, remember = ranges["products"], ranges["combine"], ranges["remember"]
    untried = real(1e9)
    half = real(0.5)
    one = real(1.0)
    zero = real(0.0)
    # of the best rate, gained by a method with each stretch of another: it is tried again after some
    optimism = real(0.15)
    least_rate = real(1e-4)
    damping = real(1e-5)  # of the normal equations, relative to their trace: what float32 resolves

    @wp.func(module=module)
    def reset_adaptive(w: int, counters: wp.array(dtype=wp.int32), norms: wp.array(dtype=real)):
        """Nothing tried yet."""
        q = w * N_COUNTERS
        for i in range(8, N_COUNTERS):
            counters[q + i] = 0
        counters[q + 12] = REST
        p = w * N_NORMS
        for i in range(3):
            norms[p + 6 + i] = untried

    @wp.func(module=module)
    def refresh(
        w: int,
        body_start: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        predicted: wp.array(dtype=vec4),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
    ):
        """Velocities anew from the impulses: momentum adds up their round-off."""
        for b in range(body_start[w], body_start[w + 1]):
            solved[b] = predicted[b]
        apply_world(w, color_block, rows, row_body, solved, row_impulse)

    @wp.func(module=module)
    def begin_stretch(
        w: int,
        now: real,
        body_start: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        history_at: int,
        i0: int,
        i1: int,
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """Judge the stretch before by ``now``, the squared step of the sweep after it, and choose the next method."""
        q = w * N_COUNTERS
        p = w * N_NORMS
        length = counters[q + 10]
        chosen = counters[q + 9]
        if length > 0:
            rate = zero
            if now > zero:
                rate = wp.min(half * wp.log(norms[p + 9] / now) / real(length), half * untried)
            norms[p + 6 + chosen] = rate
            best = least_rate
            for i in range(3):
                if norms[p + 6 + i] < untried:
                    best = wp.max(best, norms[p + 6 + i])
            for i in range(3):
                if i != chosen and norms[p + 6 + i] < untried:
                    norms[p + 6 + i] = wp.min(norms[p + 6 + i] + optimism * best, half * untried)
        chosen = int(0)
        for i in range(1, 3):
            if norms[p + 6 + i] > norms[p + 6 + chosen]:
                chosen = i
        counters[q + 9] = chosen
        counters[q + 1] = 0
        norms[p + 9] = now
        if chosen == MOMENTUM:
            norms[p + 10] = one
            for i in range(i0, i1):
                row_history[history_at + i - i0] = row_impulse[i]
            h = history_at + N_HISTORY * (i1 - i0)
            for b in range(body_start[w], body_start[w + 1]):
                for k in range(4):
                    row_history[h + k] = solved[b][k]
                h += 4
        if chosen == ANDERSON:
            counters[q + 11] = 0  # periods without it to come
            counters[q + 13] = 0  # points remembered
            counters[q + 14] = 0  # whether the last period began with its update

    @wp.func(module=module)
    def anderson_period(
        w: int,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        history_at: int,
        i0: int,
        i1: int,
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """The end of a period: Anderson's update from this and two remembered iterates; Aitken's while that rests."""
        q = w * N_COUNTERS
        p = w * N_NORMS
        now = squares(row_change, i0, i1)
        if counters[q + 14] == 1 and now > norms[p + 11]:  # the update did harm
            counters[q + 13] = 0
            counters[q + 11] = counters[q + 12]
            counters[q + 12] = wp.min(2 * counters[q + 12], REST_MAX)
        elif now < real(0.25) * norms[p + 2]:
            counters[q + 12] = wp.max(REST, counters[q + 12] / 2)
        counters[q + 14] = 0
        kept = counters[q + 13]
        counters[q + 13] = wp.min(kept + 1, 2)
        rest = counters[q + 11]
        counters[q + 11] = wp.max(rest - 1, 0)
        if rest == 0 and kept > 0:
            # least squares: || change - a (change - change_1) - b (change - change_2) || -> min
            products(row_impulse, row_change, row_history, history_at, i0, i1, kept, norms, p + 12)
            a = zero
            b = zero
            trace = norms[p + 12]
            if kept > 1:
                trace += norms[p + 14]
            if trace > zero:
                # relative to the trace: products of squares of small impulses would underflow
                g11 = norms[p + 12] / trace + damping
                r1 = norms[p + 15] / trace
                if kept == 1:
                    a = r1 / g11
                else:
                    g12 = norms[p + 13] / trace
                    g22 = norms[p + 14] / trace + damping
                    r2 = norms[p + 16] / trace
                    det = g11 * g22 - g12 * g12
                    a = (r1 * g22 - r2 * g12) / det
                    b = (r2 * g11 - r1 * g12) / det
            length = a * a * norms[p + 17] + (a * b + a * b) * norms[p + 18] + b * b * norms[p + 19]
            scale = one
            if length > (cap * cap) * now:
                scale = cap * wp.sqrt(now / length)
            combine(row_impulse, row_change, row_history, history_at, i0, i1, kept, a * scale, b * scale)
            norms[p + 11] = now
            counters[q + 14] = 1
            extrapolate(rows, row_impulse, row_change, color_block[w * ENDS], color_block[w * ENDS + N_COLORS], one)
            apply_world(w, color_block, rows, row_body, solved, row_change)
            counters[q + 2] = wp.max(PERIOD, period_min)
            norms[p + 2] = now
            counters[q + 1] = 0
        else:
            remember(row_impulse, row_change, row_history, history_at, i0, i1)
            end_period(
                w, period_min, period_max, cap, threshold, ALWAYS, color_block, rows, row_body, solved, row_impulse,
                row_change, counters, norms, 1,
            )  # fmt: skip

    @wp.func(module=module)
    def adapt(
        w: int,
        stretch: int,
        history_at: int,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        body_start: wp.array(dtype=wp.int32),
        color_block: wp.array(dtype=wp.int32),
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        predicted: wp.array(dtype=vec4),
        solved: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        row_history: wp.array(dtype=real),
        counters: wp.array(dtype=wp.int32),
        norms: wp.array(dtype=real),
    ):
        """What follows a sweep that did not end the solve."""
        q = w * N_COUNTERS
        p = w * N_NORMS
        i0 = color_block[w * ENDS] * 2 * N_LANES
        i1 = color_block[w * ENDS + N_COLORS] * 2 * N_LANES
        done = counters[q + 8] + 1
        counters[q + 8] = done
        if done == 1:
            begin_stretch(
                w, squares(row_change, i0, i1), body_start, solved, row_impulse, row_history, history_at,
                i0, i1, counters, norms,
            )  # fmt: skip
        chosen = counters[q + 9]
        if chosen == MOMENTUM:
            ended = done >= stretch
            if ended:
                refresh(w, body_start, color_block, rows, row_body, predicted, solved, row_impulse)
            else:
                before = norms[p + 10]
                if along(row_change, row_impulse, row_history, history_at, i0, i1) < zero:
                    before = one  # the sweep goes against the momentum: begin anew (O'Donoghue and Candes 2015)
                after = half * (one + wp.sqrt(one + real(4.0) * before * before))
                beta = (before - one) / after
                norms[p + 10] = after
                onward(row_impulse, row_history, history_at, i0, i1, beta)
                h = history_at + N_HISTORY * (i1 - i0)
                onward_bodies(solved, row_history, h, body_start[w], body_start[w + 1], beta)
        else:
            inside = counters[q + 1] + 1
            counters[q + 1] = inside
            period = counters[q + 2]
            if inside == period - 1:
                norms[p + 1] = squares(row_change, i0, i1)
            if inside >= period:
                if chosen == AITKEN:
                    end_period(
                        w, period_min, period_max, cap, threshold, ALWAYS, color_block, rows, row_body, solved,
                        row_impulse, row_change, counters, norms, 1,
                    )  # fmt: skip
                else:
                    anderson_period(
                        w, period_min, period_max, cap, threshold, color_block, rows, row_body, solved, row_impulse,
                        row_change, row_history, history_at, i0, i1, counters, norms,
                    )  # fmt: skip
            ended = done >= stretch and counters[q + 1] == 0
        if ended:
            counters[q + 10] = done
            counters[q + 8] = 0

    return SimpleNamespace(reset_adaptive=reset_adaptive, refresh=refresh, adapt=adapt)
