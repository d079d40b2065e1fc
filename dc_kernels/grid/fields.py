"""The arrays and numbers that the kernels of splat, gather and images take in groups."""

from __future__ import annotations

from dc_kernels.model.fields import field_table

STENCIL = field_table(
    ("kernel", "launch", "int32", "1", "code of the stencil (``sph.smoothing.STENCILS``)"),
    ("normalize", "launch", "int32", "1", "Normalize"),
    ("nearest", "launch", "int32", "1", "1: a point that reaches no node goes to the nearest one"),
    ("spacing", "launch", "real", "m", "distance of neighbouring nodes"),
    ("h", "launch", "real", "m", "support radius of a radial kernel"),
)

POINTS = field_table(
    ("origin", "world", "vec2", "m", "place of the grid's first node in each world"),
    ("start", "world", "int32", "1", "first point of each world"),
    ("count", "world", "int32", "1", "points of each world"),
    ("place", "point", "vec2", "m", "where the points are, relative to the world's origin"),
    ("bin", "point", "int32", "1", "part of the image that a point belongs to; any array where there is one"),
)

TILES = field_table(
    ("slot", "chunk,tile", "int32", "1", "points of each chunk in a tile; then where the next is listed"),
    ("start", "tile+1", "int32", "1", "first entry of each tile in order"),
    ("order", "entry", "int32", "1", "points by tile"),
    ("lost", "tile", "int32", "1", "points nearest to each tile that reach no node"),
    ("touched", "tile", "int32", "1", "1: the tile holds values"),
    ("scratch", "slot,number", "real", "1", "where the tile in work of each slot is added up"),
)

AREA = field_table(
    ("spread", "launch", "int32", "1", "1: bodies are spread over points; 0: each is one at its centre of mass"),
    ("start", "world+1", "int32", "1", "first point of each world"),
    ("body", "point", "int32", "1", "body of each point"),
    ("place", "point", "vec2", "m", "in the body's frame, relative to its centre of mass"),
    ("weight", "point", "real", "1", "share of the body, sums to 1 over its points"),
)

WALLS = field_table(
    ("value", "launch", "real", "kg", "what is added to the walls' nodes"),
    ("channel", "launch", "int32", "1", "channel that it is added to"),
    ("start", "world+1", "int32", "1", "first node of each world"),
    ("row", "node", "int32", "1", "row of each node"),
    ("column", "node", "int32", "1", "column of each node"),
)
