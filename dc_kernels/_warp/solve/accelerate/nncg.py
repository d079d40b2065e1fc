"""Nonsmooth nonlinear conjugate gradients (Silcowitz, Niebe and Erleben 2010): Fletcher and Reeves over the sweeps."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS, world_functions


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    ranges = range_functions(dtype)
    squares, conjugate = ranges.squares, ranges.conjugate
    apply = world_functions(dtype, variant).apply

    @wp.func(module=module)
    def reset(w: int, config: t.Config, iteration: wp.array(dtype=t.Iteration)):
        """Begin with the steepest direction: no squared step is known, or the impulses are not those it belongs to."""
        iteration[w].at_end = real(0.0)

    @wp.func(module=module)
    def after_sweep(
        span: t.Span,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Move on along the conjugate direction; start anew where the step has grown. It never pauses: 0."""
        w = span.world
        now = squares(rows.change, rows.color_block, w * ENDS, span.team)
        beta = real(0.0)
        if iteration[w].sweeps > 1 and now <= iteration[w].at_end and iteration[w].at_end > real(0.0):
            beta = now / iteration[w].at_end
        iteration[w].at_end = now
        conjugate(
            rows.impulse,
            rows.change,
            rows.direction,
            beta,
            rows.color_block,
            w * ENDS,
            span.team,
        )
        if beta > real(0.0):
            apply(span, motion, rows, rows.change)
        return 0

    return SimpleNamespace(reset=reset, after_sweep=after_sweep)
