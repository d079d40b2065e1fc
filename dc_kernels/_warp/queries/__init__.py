"""Warp kernels of ``dc_kernels.neighbors``."""
