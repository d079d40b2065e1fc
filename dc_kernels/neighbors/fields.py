"""The arrays that the kernels of the neighbour search take in a group."""

from __future__ import annotations

from dc_kernels.model.fields import field_table

# a world's lines begin at start[w], their starts at start[w] + w
CELLS = field_table(
    ("start", "world+1", "int32", "1", "first point of each world"),
    ("place", "axis,point", "real", "m", "coordinates of the points by line, then column, then index"),
    ("number", "point", "int32", "1", "their indices"),
    ("column", "point", "int32", "1", "their columns"),
    ("line_key", "line", "int64", "1", "row, or layer and row, of each line"),
    ("line_start", "line+1", "int32", "1", "first point of each line"),
    ("line_count", "world", "int32", "1", "lines of each world"),
    ("line_stride", "world", "int64", "1", "from the key of a line to that of the next layer; 0 in 2D"),
)
