"""Faults: bad calls, hostile files, kills and threads in processes of their own, so that a crash is counted."""
