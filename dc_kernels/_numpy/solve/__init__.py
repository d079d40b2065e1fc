"""NumPy oracle of ``dc_kernels.solve``."""
