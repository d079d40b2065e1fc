"""The oracle of bodies that sleep."""
