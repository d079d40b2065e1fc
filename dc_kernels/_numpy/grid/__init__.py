"""NumPy oracle of ``dc_kernels.grid``."""
