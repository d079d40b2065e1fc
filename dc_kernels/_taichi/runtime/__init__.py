"""What kernels for Taichi are made and launched with."""
