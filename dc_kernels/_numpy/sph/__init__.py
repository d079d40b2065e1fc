"""NumPy oracle of ``dc_kernels.sph``."""
