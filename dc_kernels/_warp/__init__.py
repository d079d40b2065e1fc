"""Warp kernels. A file reads func -> kernel; the host module at its path below ``dc_kernels`` launches it."""
