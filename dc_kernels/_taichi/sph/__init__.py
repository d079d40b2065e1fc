"""Taichi kernels of ``dc_kernels.sph``."""
