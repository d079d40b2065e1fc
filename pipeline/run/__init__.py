"""One run and its files."""
