"""Kernels of bodies that sleep."""
