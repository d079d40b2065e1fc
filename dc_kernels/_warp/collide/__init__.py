"""Warp kernels of ``dc_kernels.collide``."""
