"""Kernels that launch kernels, on the CPU."""
