"""Taichi kernels of ``dc_kernels.grid``."""
