"""Accelerations of the sweeps: a file each, with ``reset`` before the first sweep and ``after_sweep`` behind each.

What ``after_sweep`` returns says what the velocities are to ``follow`` (``world.Follow``), or POSTPONED. It is given
``now``, the squared step of the sweep, where it needs that.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.accelerate import adaptive, aitken, nncg, sor
from dc_kernels._taichi.solve.accelerate.aitken import POSTPONED
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels.model.config import ACCELERATIONS

__all__ = ["POSTPONED", "accelerate_functions"]
AITKEN = ACCELERATIONS["aitken"]
NNCG = ACCELERATIONS["nncg"]
ADAPTIVE = ACCELERATIONS["adaptive"]


@cache
def accelerate_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep`` of the acceleration that the settings name, and ``relaxation`` of the sweeps."""
    t = group_types(dtype)
    squares = range_functions(dtype).squares
    of_aitken, of_nncg, of_adaptive = (file.functions(dtype, variant) for file in (aitken, nncg, adaptive))
    reset_aitken, after_aitken = of_aitken.reset, of_aitken.after_sweep
    reset_nncg, after_nncg = of_nncg.reset, of_nncg.after_sweep
    reset_adaptive, after_adaptive = of_adaptive.reset, of_adaptive.after_sweep
    measured_by_aitken, measured_by_adaptive = of_aitken.measures, of_adaptive.measures

    @ti.func
    def reset(config: t.Config, it: ti.template()):
        """Before the first sweep of a world's solve."""
        if config.acceleration == AITKEN:
            reset_aitken(config, it)
        elif config.acceleration == NNCG:
            reset_nncg(it)
        elif config.acceleration == ADAPTIVE:
            reset_adaptive(config, it)

    @ti.func
    def after_sweep(span, config: t.Config, motion: t.Motion, rows: t.Rows, it: ti.template()):
        """After a sweep that did not end the solve: what is to ``follow``, or POSTPONED."""
        follow = 0
        measures = config.acceleration == NNCG
        if config.acceleration == AITKEN:
            measures = measured_by_aitken(it)
        elif config.acceleration == ADAPTIVE:
            measures = measured_by_adaptive(it)
        now = 0.0
        if measures:
            now = squares(rows, span.low, span.high)
        if config.acceleration == AITKEN:
            follow = after_aitken(span, now, config, rows, it)
        elif config.acceleration == NNCG:
            follow = after_nncg(span, now, rows, it)
        elif config.acceleration == ADAPTIVE:
            follow = after_adaptive(span, now, config, motion, rows, it)
        return follow

    return SimpleNamespace(reset=reset, after_sweep=after_sweep, relaxation=sor.functions(dtype, variant).relaxation)
