"""Kernels as differentiable torch operators."""
