"""The theses' protocol and comparisons of starts."""
