"""Data sets: recipe, shards, generation, reading."""
