"""Where a solve starts from."""
