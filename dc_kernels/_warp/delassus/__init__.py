"""Warp kernels of ``dc_kernels.delassus``."""
