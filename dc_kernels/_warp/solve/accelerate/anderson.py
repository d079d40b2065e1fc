"""Anderson's update (1965) from two remembered iterates, every few sweeps; it rests where it did harm.

The update x - a (x - x1) - b (x - x2) minimises, for linear steps, the step that would follow; a and b come from the
normal equations of the differences of steps, damped by what float32 resolves.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS, world_functions
from dc_kernels.solve.iteration import ANDERSON_PERIOD, ANDERSON_REST, ANDERSON_REST_MAX

PERIOD = wp.constant(ANDERSON_PERIOD)
REST = wp.constant(ANDERSON_REST)
REST_MAX = wp.constant(ANDERSON_REST_MAX)


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``end_period``, for a stretch of the adaptive acceleration; ``forget`` before its first one."""
    t = group_types(dtype)
    real = t.real
    vec2 = t.vec2
    vec8 = wp.types.vector(8, real)
    module = kernel_module("solver", dtype, variant)
    ranges = range_functions(dtype)
    squares, products, combine, remember = ranges.squares, ranges.products, ranges.combine, ranges.remember
    extrapolate = world_functions(dtype, variant).extrapolate
    one = real(1.0)
    zero = real(0.0)
    damping = real(1e-5)  # of the normal equations, relative to their trace: what float32 resolves

    @wp.func(module=module)
    def reset(w: int, iteration: wp.array(dtype=t.Iteration)):
        """Begin a stretch: no iterate is remembered, none is resting."""
        iteration[w].rest = 0
        iteration[w].remembered = 0
        iteration[w].updated = 0

    @wp.func(module=module)
    def forget(w: int, iteration: wp.array(dtype=t.Iteration)):
        """Nothing tried: the first rest will be the shortest."""
        reset(w, iteration)
        iteration[w].next_rest = REST

    @wp.func(module=module)
    def coefficients(s: vec8, kept: int):
        """A and b of the least squares ||change - a (change - change_1) - b (change - change_2)|| -> min."""
        a = zero
        b = zero
        trace = s[0]
        if kept > 1:
            trace += s[2]
        if trace > zero:
            # relative to the trace: products of squares of small impulses would underflow
            g11 = s[0] / trace + damping
            r1 = s[3] / trace
            if kept == 1:
                a = r1 / g11
            else:
                g12 = s[1] / trace
                g22 = s[2] / trace + damping
                r2 = s[4] / trace
                det = g11 * g22 - g12 * g12
                a = (r1 * g22 - r2 * g12) / det
                b = (r2 * g11 - r1 * g12) / det
        return vec2(a, b)

    @wp.func(module=module)
    def end_period(
        span: t.Span,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """The end of a period: update from this and two remembered iterates, then 1; 0 while that rests."""
        w = span.world
        now = squares(rows.change, rows.color_block, w * ENDS, span.team)
        if iteration[w].updated == 1 and now > iteration[w].before_update:  # the update did harm
            iteration[w].remembered = 0
            iteration[w].rest = iteration[w].next_rest
            iteration[w].next_rest = wp.min(2 * iteration[w].next_rest, REST_MAX)
        elif now < real(0.25) * iteration[w].at_end:
            iteration[w].next_rest = wp.max(REST, iteration[w].next_rest / 2)
        iteration[w].updated = 0
        kept = iteration[w].remembered
        iteration[w].remembered = wp.min(kept + 1, 2)
        rest = iteration[w].rest
        iteration[w].rest = wp.max(rest - 1, 0)
        if rest > 0 or kept == 0:
            remember(
                rows.impulse,
                rows.change,
                rows.past,
                span.past_at,
                rows.color_block,
                w * ENDS,
                span.team,
            )
            return 0
        s = products(
            rows.impulse,
            rows.change,
            rows.past,
            span.past_at,
            kept,
            rows.color_block,
            w * ENDS,
            span.team,
        )
        iteration[w].products = s
        ab = coefficients(s, kept)
        a = ab[0]
        b = ab[1]
        length = a * a * s[5] + (a * b + a * b) * s[6] + b * b * s[7]
        scale = one
        cap = config.aitken_cap
        if length > (cap * cap) * now:
            scale = cap * wp.sqrt(now / length)
        combine(
            rows.impulse,
            rows.change,
            rows.past,
            span.past_at,
            kept,
            a * scale,
            b * scale,
            rows.color_block,
            w * ENDS,
            span.team,
        )
        iteration[w].before_update = now
        iteration[w].updated = 1
        extrapolate(span, one, motion, rows)
        iteration[w].period = wp.max(PERIOD, config.aitken_period)
        iteration[w].at_end = now
        iteration[w].inside = 0
        return 1

    return SimpleNamespace(forget=forget, reset=reset, end_period=end_period)
