"""Scenes that break solvers."""
