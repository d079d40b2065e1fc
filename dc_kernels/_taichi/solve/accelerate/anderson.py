"""Anderson's update (1965) from two remembered iterates, every few sweeps; it rests where it did harm.

The update x - a (x - x1) - b (x - x2) minimises, for linear steps, the step that would follow; a and b come from the
normal equations of the differences of steps, damped by what float32 resolves.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels.solve.iteration import ANDERSON_PERIOD, ANDERSON_REST, ANDERSON_REST_MAX

PERIOD = ANDERSON_PERIOD
REST = ANDERSON_REST
REST_MAX = ANDERSON_REST_MAX
DAMPING = 1e-5  # of the normal equations, relative to their trace: what float32 resolves


@ti.func
def coefficients(s, kept):
    """A and b of the least squares ||change - a (change - change_1) - b (change - change_2)|| -> min."""
    a = 0.0
    b = 0.0
    trace = s[0]
    if kept > 1:
        trace += s[2]
    if trace > 0.0:
        # relative to the trace: products of squares of small impulses would underflow
        g11 = s[0] / trace + DAMPING
        r1 = s[3] / trace
        if kept == 1:
            a = r1 / g11
        else:
            g12 = s[1] / trace
            g22 = s[2] / trace + DAMPING
            r2 = s[4] / trace
            det = g11 * g22 - g12 * g12
            a = (r1 * g22 - r2 * g12) / det
            b = (r2 * g11 - r1 * g12) / det
    return a, b


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``end_period``, for a stretch of the adaptive acceleration; ``forget`` before its first one."""
    t = group_types(dtype)
    ranges = range_functions(dtype)
    products, combine, remember = ranges.products, ranges.combine, ranges.remember

    @ti.func
    def reset(it: ti.template()):
        """Begin a stretch: no iterate is remembered, none is resting."""
        it.rest = 0
        it.remembered = 0
        it.updated = 0

    @ti.func
    def forget(it: ti.template()):
        """Nothing tried: the first rest will be the shortest."""
        reset(it)
        it.next_rest = REST

    @ti.func
    def end_period(span, now, config: t.Config, rows: t.Rows, it: ti.template()):
        """The end of a period: update from this and two remembered iterates, then 1; 0 while that rests.

        The impulses are then to be moved on along ``rows.change``.
        """
        moved = 0
        if it.updated == 1 and now > it.before_update:  # the update did harm
            it.remembered = 0
            it.rest = it.next_rest
            it.next_rest = ti.min(2 * it.next_rest, REST_MAX)
        elif now < 0.25 * it.at_end:
            it.next_rest = ti.max(REST, it.next_rest // 2)
        it.updated = 0
        kept = it.remembered
        it.remembered = ti.min(kept + 1, 2)
        rest = it.rest
        it.rest = ti.max(rest - 1, 0)
        if rest > 0 or kept == 0:
            remember(rows, span.past_at, span.low, span.high)
        else:
            s = products(rows, span.past_at, span.low, span.high, kept)
            it.products = s
            a, b = coefficients(s, kept)
            length = a * a * s[5] + (a * b + a * b) * s[6] + b * b * s[7]
            scale = 1.0
            cap = config.aitken_cap
            if length > (cap * cap) * now:
                scale = cap * ti.sqrt(now / length)
            combine(rows, span.past_at, span.low, span.high, kept, a * scale, b * scale)
            it.before_update = now
            it.updated = 1
            it.period = ti.max(PERIOD, config.aitken_period)
            it.at_end = now
            it.inside = 0
            moved = 1
        return moved

    return SimpleNamespace(forget=forget, reset=reset, end_period=end_period)
