"""Nesterov's momentum with restart, without projection between sweeps, which project anyway.

The velocities follow the impulses by linearity, without a pass over the contacts, so that a sweep with momentum costs a
fifth more than a plain one. t and beta are FISTA's (Beck and Teboulle 2009), the restart is that of O'Donoghue and
Candes (2015).
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels.solve.iteration import PAST


@ti.func
def nesterov(t):
    """The next t of FISTA, (1 + sqrt(1 + 4 t^2)) / 2."""
    return 0.5 * (1.0 + ti.sqrt(1.0 + 4.0 * t * t))


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``, for a stretch of the adaptive acceleration."""
    t = group_types(dtype)
    ranges = range_functions(dtype)
    copy, along, onward = ranges.copy, ranges.along, ranges.onward
    keep_bodies, onward_bodies = ranges.keep_bodies, ranges.onward_bodies

    @ti.func
    def reset(span, motion: t.Motion, rows: t.Rows, it: ti.template()):
        """Begin at the present impulses and velocities, at rest."""
        it.momentum = 1.0
        copy(rows.impulse, rows.past, span.past_at, span.low, span.high)
        h = span.past_at + PAST * (span.high - span.low)
        keep_bodies(rows, motion.solved, h, span.first_body, span.last_body)

    @ti.func
    def after_sweep(span, motion: t.Motion, rows: t.Rows, it: ti.template()):
        """Move impulses and velocities on by beta times their last move; begin anew where the sweep goes against it."""
        before = it.momentum
        if along(rows, span.past_at, span.low, span.high) < 0.0:
            before = 1.0
        after = nesterov(before)
        beta = (before - 1.0) / after
        it.momentum = after
        onward(rows, span.past_at, span.low, span.high, beta)
        h = span.past_at + PAST * (span.high - span.low)
        onward_bodies(rows, motion.solved, h, span.first_body, span.last_body, beta)

    return SimpleNamespace(reset=reset, after_sweep=after_sweep)
