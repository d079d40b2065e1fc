"""Kernels that hold arrays to their rules."""
