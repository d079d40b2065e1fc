"""Kernels that look at the arrays of a scene."""
