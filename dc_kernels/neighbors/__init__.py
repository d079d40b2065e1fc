"""Pairs and lists of points within a radius."""
