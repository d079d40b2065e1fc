"""Warp kernels of ``dc_kernels.sph``."""
