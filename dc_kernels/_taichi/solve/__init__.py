"""Taichi kernels of ``dc_kernels.solve``."""
