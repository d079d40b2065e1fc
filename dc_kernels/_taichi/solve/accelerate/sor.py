"""Successive over-relaxation: each row moves omega times as far as by plain Gauss-Seidel; nothing follows a sweep."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.config import ACCELERATIONS

SOR = ACCELERATIONS["sor"]


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``relaxation``, what the sweeps of every acceleration ask for."""
    t = group_types(dtype)

    @ti.func
    def relaxation(config: t.Config):
        """The relaxation factor of a sweep: omega, or 1 for all other accelerations."""
        omega = 1.0
        if config.acceleration == SOR:
            omega = config.omega
        return omega

    return SimpleNamespace(relaxation=relaxation)
