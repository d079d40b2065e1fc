"""Starts of the contact solver: what it begins a solve with. ``registry`` makes them by name."""
