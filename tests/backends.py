"""Backends that tests are run for: Taichi's where it, or Quadrants, is installed."""

import importlib.util

import pytest

NEEDS_TAICHI = pytest.mark.skipif(
    not any(importlib.util.find_spec(name) for name in ("taichi", "quadrants")),
    reason="neither taichi nor quadrants is installed",
)
TAICHI = pytest.param("taichi", marks=NEEDS_TAICHI)
COMPILED = ("warp", TAICHI)
ALL = ("warp", "numpy", TAICHI)
