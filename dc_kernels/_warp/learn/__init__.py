"""Warp kernels of ``dc_kernels.learn``."""
