"""Taichi kernels of ``dc_kernels.neighbors``."""
