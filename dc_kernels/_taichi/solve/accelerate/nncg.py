"""Nonsmooth nonlinear conjugate gradients (Silcowitz, Niebe and Erleben 2010): Fletcher and Reeves over the sweeps."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels._taichi.solve.world import CHANGE


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``."""
    t = group_types(dtype)
    conjugate = range_functions(dtype).conjugate

    @ti.func
    def reset(it: ti.template()):
        """Begin with the steepest direction: no squared step is known, or the impulses are not those it belongs to."""
        it.at_end = 0.0

    @ti.func
    def after_sweep(span, now, rows: t.Rows, it: ti.template()):
        """Move on along the conjugate direction; start anew where the step has grown. It never pauses."""
        follow = 0
        beta = 0.0
        if it.sweeps > 1 and now <= it.at_end and it.at_end > 0.0:
            beta = now / it.at_end
        it.at_end = now
        conjugate(rows, span.low, span.high, beta)
        if beta > 0.0:
            follow = CHANGE
        return follow

    return SimpleNamespace(reset=reset, after_sweep=after_sweep)
