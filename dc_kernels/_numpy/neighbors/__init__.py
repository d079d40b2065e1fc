"""NumPy oracle of ``dc_kernels.neighbors``."""
