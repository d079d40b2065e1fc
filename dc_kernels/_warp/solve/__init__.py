"""Warp kernels of ``dc_kernels.solve``."""
