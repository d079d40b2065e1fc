"""Particles to grid and back: splat, gather, images."""
