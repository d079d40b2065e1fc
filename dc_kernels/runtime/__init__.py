"""Backends, launches, threads, memory of other libraries."""
