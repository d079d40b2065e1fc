"""Scenes, runs, the thesis protocol and their pictures, on top of ``dc_kernels``."""
