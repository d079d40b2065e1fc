"""Sizes of the pieces that images are worked on in."""

from __future__ import annotations

BAND = 8  # rows of an image that are cleared and marked together
CHUNK = 4096  # points that one thread index gathers
TILE_ROWS, TILE_COLUMNS = 64, 64  # nodes of a tile that a large image is splatted by: 80 KB for 4 channels
