"""Aitken's extrapolation: every few sweeps the impulses move on along their last step, to where it would end.

The steps of two successive sweeps shrink by a ratio r, so that all that would follow sum up to r / (1 - r) times the
last one. Where a period gained little the next is twice as long; where extrapolation cycles, plain sweeps follow.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS, world_functions


@wp.func
def series_limit(ratio: Any, cap: Any):
    """Sum of the geometric series r + r^2 + ... = r / (1 - r), which multiplies the last step; at most ``cap``."""
    one = type(ratio)(1.0)
    if ratio < cap * (one - ratio):
        return ratio / (one - ratio)
    return cap


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset``, ``after_sweep`` and ``end_period``; the adaptive acceleration calls the first and the last."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    copy, squares = range_functions(dtype).copy, range_functions(dtype).squares
    extrapolate = world_functions(dtype, variant).extrapolate
    huge = real(3e38)

    @wp.func(module=module)
    def reset(w: int, config: t.Config, iteration: wp.array(dtype=t.Iteration)):
        """A first period of the shortest length; no squared step is known."""
        iteration[w].period = config.aitken_period
        iteration[w].inside = 0
        iteration[w].stalled = 0
        iteration[w].plain_sweeps = 2 * config.aitken_period_max
        iteration[w].postponed = 0
        iteration[w].before_end = huge
        iteration[w].at_end = huge
        iteration[w].least_step = huge

    @wp.func(module=module)
    def end_period(
        span: t.Span,
        patience: int,
        move: int,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """The end of a period: extrapolate and choose the length of the next.

        ``patience`` is the number of periods without a smaller step after which plain sweeps follow. ``move`` is 1, or
        0 to leave out the extrapolation, where the impulses were replaced in the pause before it.
        """
        w = span.world
        # squared steps: before_end is that of the period's last sweep but one, at_end that of the period before's last
        before = iteration[w].before_end
        now = squares(rows.change, rows.color_block, w * ENDS, span.team)
        if now < before and move == 1:
            alpha = series_limit(wp.sqrt(now / before), config.aitken_cap)
            extrapolate(span, alpha, motion, rows)
        period = iteration[w].period
        if now > config.aitken_threshold * config.aitken_threshold * iteration[w].at_end:
            period = wp.min(2 * period, config.aitken_period_max)
        else:
            period = wp.max(config.aitken_period, period / 2)
        iteration[w].at_end = now
        iteration[w].period = period
        inside = int(0)
        stalled = iteration[w].stalled + 1
        if now < iteration[w].least_step:
            iteration[w].least_step = now
            stalled = 0
        if stalled >= patience:
            inside = -iteration[w].plain_sweeps  # below 0 it counts plain sweeps, up to the next period
            iteration[w].plain_sweeps = 2 * iteration[w].plain_sweeps
            stalled = 0
        iteration[w].stalled = stalled
        iteration[w].inside = inside

    @wp.func(module=module)
    def after_sweep(
        span: t.Span,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Count the sweep into its period, and end that; 1 where the solve pauses before the extrapolation."""
        w = span.world
        inside = iteration[w].inside + 1
        sweeps = iteration[w].sweeps
        iteration[w].inside = inside
        period = iteration[w].period
        if inside == period - 1:
            iteration[w].before_end = squares(rows.change, rows.color_block, w * ENDS, span.team)
            if sweeps >= span.pause_at - 1:
                copy(rows.change, span.low, rows.before, span.low, rows.color_block, w * ENDS, span.team)
        if inside >= period:
            if sweeps >= span.pause_at:  # the extrapolation waits: it is made when the solve goes on
                iteration[w].postponed = 1
                iteration[w].step_before = iteration[w].before_end
                iteration[w].step_last = squares(rows.change, rows.color_block, w * ENDS, span.team)
                return 1
            end_period(span, config.aitken_patience, 1, config, motion, rows, iteration)
        return 0

    return SimpleNamespace(reset=reset, after_sweep=after_sweep, end_period=end_period)
