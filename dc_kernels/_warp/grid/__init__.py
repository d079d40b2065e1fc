"""Warp kernels of ``dc_kernels.grid``."""
