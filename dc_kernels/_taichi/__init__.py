"""Taichi kernels, with the bits of Warp's where elementary functions agree; files as in ``dc_kernels._warp``."""
