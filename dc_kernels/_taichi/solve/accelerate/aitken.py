"""Aitken's extrapolation: every few sweeps the impulses move on along their last step, to where it would end.

The steps of two successive sweeps shrink by a ratio r, so that all that would follow sum up to r / (1 - r) times the
last one. Where a period gained little the next is twice as long; where extrapolation cycles, plain sweeps follow.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.lanes import lane_functions
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels._taichi.solve.world import CHANGE

HUGE = 3e38
POSTPONED = 3  # beside Follow: the end of a period waits until the solve goes on


@ti.func
def series_limit(ratio, cap):
    """Sum of the geometric series r + r^2 + ... = r / (1 - r), which multiplies the last step; at most ``cap``."""
    limit = cap
    if ratio < cap * (1.0 - ratio):
        limit = ratio / (1.0 - ratio)
    return limit


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset``, ``after_sweep`` and ``end_period``; the adaptive acceleration calls the first and the last."""
    t = group_types(dtype)
    extrapolate, copy = lane_functions(dtype, variant).extrapolate, range_functions(dtype).copy

    @ti.func
    def reset(config: t.Config, it: ti.template()):
        """A first period of the shortest length; no squared step is known."""
        it.period = config.aitken_period
        it.inside = 0
        it.stalled = 0
        it.plain_sweeps = 2 * config.aitken_period_max
        it.postponed = 0
        it.before_end = HUGE
        it.at_end = HUGE
        it.least_step = HUGE

    @ti.func
    def end_period(span, now, patience, move, config: t.Config, rows: t.Rows, it: ti.template()):
        """The end of a period: extrapolate and choose the length of the next; what is to follow.

        ``patience`` is the number of periods without a smaller step after which plain sweeps follow. ``move`` is 1, or
        0 to leave out the extrapolation, where the impulses were replaced in the pause before it.
        """
        follow = 0
        # squared steps: before_end is that of the period's last sweep but one, at_end that of the period before's last
        if now < it.before_end and move == 1:
            alpha = series_limit(ti.sqrt(now / it.before_end), config.aitken_cap)
            extrapolate(rows, span.first, span.last, alpha)
            follow = CHANGE
        if now > config.aitken_threshold * config.aitken_threshold * it.at_end:
            it.period = ti.min(2 * it.period, config.aitken_period_max)
        else:
            it.period = ti.max(config.aitken_period, it.period // 2)
        it.at_end = now
        it.inside = 0
        it.stalled += 1
        if now < it.least_step:
            it.least_step = now
            it.stalled = 0
        if it.stalled >= patience:
            it.inside = -it.plain_sweeps  # below 0 it counts plain sweeps, up to the next period
            it.plain_sweeps = 2 * it.plain_sweeps
            it.stalled = 0
        return follow

    @ti.func
    def measures(it):
        """Whether ``after_sweep`` asks for the squared step of this sweep: the last two of a period."""
        return it.inside + 1 >= it.period - 1

    @ti.func
    def after_sweep(span, now, config: t.Config, rows: t.Rows, it: ti.template()):
        """Count the sweep into its period, and end that; POSTPONED where the solve pauses before the extrapolation."""
        follow = 0
        it.inside += 1
        if it.inside == it.period - 1:
            it.before_end = now
            if it.sweeps >= span.pause_at - 1:
                copy(rows.change, rows.before, span.low, span.low, span.high)
        if it.inside >= it.period:
            if it.sweeps >= span.pause_at:  # the extrapolation waits: it is made when the solve goes on
                it.postponed = 1
                it.step_before = it.before_end
                it.step_last = now
                follow = POSTPONED
            else:
                follow = end_period(span, now, config.aitken_patience, 1, config, rows, it)
        return follow

    return SimpleNamespace(reset=reset, measures=measures, after_sweep=after_sweep, end_period=end_period)
