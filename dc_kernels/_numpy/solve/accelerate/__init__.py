"""Accelerations of the sweeps: a file each, with ``reset`` before the first sweep and ``after_sweep`` behind each."""

from __future__ import annotations

from dc_kernels._numpy.solve.accelerate import adaptive, aitken, nncg
from dc_kernels.model.config import ACCELERATIONS

METHODS = {ACCELERATIONS[name]: module for name, module in (("aitken", aitken), ("nncg", nncg), ("adaptive", adaptive))}
"""Modules by the number that kernels know an acceleration by; "none" and "sor" do nothing after a sweep."""
