"""Benches of run time."""
