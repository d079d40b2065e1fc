"""The oracle: every kernel again in plain NumPy, one thread index after the other. Clear, never fast."""
