"""Smoothing kernels of SPH by name."""

from __future__ import annotations

KERNELS = {"poly6": 0, "spiky": 1, "gaussian": 2, "cubic": 3, "wendland": 4}
STENCILS = {**KERNELS, "bilinear": 5, "bspline": 6}
GAUSSIAN_CUT = 4.0  # a Gaussian of support h has sigma = h / GAUSSIAN_CUT
