"""NumPy oracle of ``dc_kernels.queries``."""
