"""NumPy oracle of ``dc_kernels.learn``."""
