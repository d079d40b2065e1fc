"""What is called with bad arguments, and what each argument may be: for ``calls``."""
