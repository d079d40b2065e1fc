"""Kernels of sensors and of contact events."""
