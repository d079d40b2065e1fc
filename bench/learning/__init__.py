"""Benches of the theses' protocol, transfer and networks."""
