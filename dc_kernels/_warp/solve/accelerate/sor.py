"""Successive over-relaxation: each row moves omega times as far as by plain Gauss-Seidel; nothing follows a sweep."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels.model.config import ACCELERATIONS

SOR = wp.constant(ACCELERATIONS["sor"])


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``relaxation``, what the sweeps of every acceleration ask for."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)

    @wp.func(module=module)
    def relaxation(config: t.Config):
        """The relaxation factor of a sweep: omega, or 1 for all other accelerations."""
        omega = real(1.0)
        if config.acceleration == SOR:
            omega = config.omega
        return omega

    return SimpleNamespace(relaxation=relaxation)
