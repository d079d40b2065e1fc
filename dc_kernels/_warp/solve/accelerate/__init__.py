"""Accelerations of the sweeps: a file each, with ``reset`` before the first sweep and ``after_sweep`` behind each.

A new one is a new file, a number in ``model.config.ACCELERATIONS``, a choice more in ``SolverConfig`` and in the
options of the command line, and a line in each function below; the oracle has a file with the same name.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.accelerate import adaptive, aitken, nncg, sor
from dc_kernels.model.config import ACCELERATIONS

AITKEN = wp.constant(ACCELERATIONS["aitken"])
NNCG = wp.constant(ACCELERATIONS["nncg"])
ADAPTIVE = wp.constant(ACCELERATIONS["adaptive"])


@cache
def accelerate_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep`` of the acceleration that the settings name, and ``relaxation`` of the sweeps."""
    t = group_types(dtype)
    module = kernel_module("solver", dtype, variant)
    of_aitken, of_nncg, of_adaptive = (file.functions(dtype, variant) for file in (aitken, nncg, adaptive))
    reset_aitken, after_aitken = of_aitken.reset, of_aitken.after_sweep
    reset_nncg, after_nncg = of_nncg.reset, of_nncg.after_sweep
    reset_adaptive, after_adaptive = of_adaptive.reset, of_adaptive.after_sweep

    @wp.func(module=module)
    def reset(w: int, config: t.Config, iteration: wp.array(dtype=t.Iteration)):
        """Before the first sweep of a world's solve."""
        if config.acceleration == AITKEN:
            reset_aitken(w, config, iteration)
        elif config.acceleration == NNCG:
            reset_nncg(w, config, iteration)
        elif config.acceleration == ADAPTIVE:
            reset_adaptive(w, config, iteration)

    @wp.func(module=module)
    def after_sweep(
        span: t.Span,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """After a sweep that did not end the solve; 1 where the solve pauses here."""
        if config.acceleration == AITKEN:
            return after_aitken(span, config, motion, rows, iteration)
        if config.acceleration == NNCG:
            return after_nncg(span, config, motion, rows, iteration)
        if config.acceleration == ADAPTIVE:
            return after_adaptive(span, config, motion, rows, iteration)
        return 0

    return SimpleNamespace(reset=reset, after_sweep=after_sweep, relaxation=sor.functions(dtype, variant).relaxation)
