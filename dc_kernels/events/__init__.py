"""What touches and overlaps, and what each step has changed of it: sensors, and contact events."""
