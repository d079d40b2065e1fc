"""Scenes by name."""

from pipeline.scenes.scenes import scene as scene
