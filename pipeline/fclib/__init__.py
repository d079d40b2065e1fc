"""Contact problems in FCLIB's files."""
