"""The oracle of sensors and of contact events."""
