"""NumPy oracle of ``dc_kernels.delassus``."""
