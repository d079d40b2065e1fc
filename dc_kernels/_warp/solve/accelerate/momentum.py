"""Nesterov's momentum with restart, without projection between sweeps, which project anyway.

The velocities follow the impulses by linearity, without a pass over the contacts, so that a sweep with momentum costs a
fifth more than a plain one. t and beta are FISTA's (Beck and Teboulle 2009), the restart is that of O'Donoghue and
Candes (2015).
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS
from dc_kernels.solve.iteration import PAST

N_PAST = wp.constant(PAST)


@wp.func
def nesterov(t: Any):
    """The next t of FISTA, (1 + sqrt(1 + 4 t^2)) / 2."""
    one = type(t)(1.0)
    return type(t)(0.5) * (one + wp.sqrt(one + type(t)(4.0) * t * t))


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``, for a stretch of the adaptive acceleration."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    ranges = range_functions(dtype)
    along, onward, onward_bodies = ranges.along, ranges.onward, ranges.onward_bodies
    copy, copy_bodies = ranges.copy, ranges.copy_bodies
    one = real(1.0)

    @wp.func(module=module)
    def reset(
        span: t.Span,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Begin at the present impulses and velocities, at rest."""
        w = span.world
        iteration[w].momentum = one
        length = span.high - span.low
        copy(rows.impulse, span.low, rows.past, span.past_at, rows.color_block, w * ENDS, span.team)
        copy_bodies(
            motion.solved, rows.past, span.past_at + N_PAST * length, span.first_body, span.last_body, span.team
        )

    @wp.func(module=module)
    def after_sweep(
        span: t.Span,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Move impulses and velocities on by beta times their last move; begin anew where the sweep goes against it."""
        w = span.world
        before = iteration[w].momentum
        if along(
            rows.change,
            rows.impulse,
            rows.past,
            span.past_at,
            rows.color_block,
            w * ENDS,
            span.team,
        ) < real(0.0):
            before = one
        after = nesterov(before)
        beta = (before - one) / after
        iteration[w].momentum = after
        onward(
            rows.impulse,
            rows.past,
            span.past_at,
            beta,
            rows.color_block,
            w * ENDS,
            span.team,
        )
        h = span.past_at + N_PAST * (span.high - span.low)
        onward_bodies(motion.solved, rows.past, h, span.first_body, span.last_body, beta, span.team)

    return SimpleNamespace(reset=reset, after_sweep=after_sweep)
