"""Warp kernels. A file reads func -> kernel; launchers live in the modules one level up."""
