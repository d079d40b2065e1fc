"""Joints: their arrays, and the calls of a builder that add them."""
