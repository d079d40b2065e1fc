"""Smoothing kernels and SPH sums."""
