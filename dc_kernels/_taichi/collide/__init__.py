"""Taichi kernels of ``dc_kernels.collide``."""
