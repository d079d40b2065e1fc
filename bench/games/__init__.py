"""Scenes of games, beside the engines of games."""
