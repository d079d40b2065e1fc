"""NumPy oracle of ``dc_kernels.collide``."""
