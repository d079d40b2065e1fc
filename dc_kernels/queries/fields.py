"""The arrays that the kernels of queries take in groups."""

from __future__ import annotations

from dc_kernels.model.fields import field_table

LANES = 8  # children of a node of the tree
CHUNK = 256  # queries that a kernel's thread answers
# a world's nodes begin at node_start[w], level by level from the shapes up; the last one is the root
TREE = field_table(
    ("node_start", "world+1", "int32", "1", "first node of each world"),
    ("box", "number", "real", "m", "of each node low x, low y, high x, high y of its LANES children"),
    ("sorted_shape", "child", "int32", "1", "shapes that are the children of each node, where it has shapes"),
    ("place", "body", "vec2", "m", "positions that the tree was made for"),
    ("rotation", "body", "vec2", "1", "cosine and sine of the angles that it was made for"),
)
PROBE = field_table(
    ("corner", "corner", "vec2", "m", "of the shape that is asked with, counter-clockwise, about its position"),
    ("radius", "launch", "real", "m", "by which it is rounded"),
)
# those of no length say: world 0, not turned, not scaled, every category, no body left out
QUERY = field_table(
    ("world", "query", "int32", "1", "which it asks about"),
    ("place", "query", "vec2", "m", "position of the shape that is asked with"),
    ("rotation", "query", "vec2", "1", "cosine and sine of its angle"),
    ("scale", "query", "vec2", "1", "of its corners, along its axes"),
    ("translation", "query", "vec2", "m", "along which it is cast"),
    ("most", "query", "real", "m", "largest distance of what is closest"),
    ("mask", "query", "uint32", "1", "categories that count"),
    ("skip", "query", "int32", "1", "body that does not count"),
)
HIT = field_table(
    ("shape", "query", "int32", "1", "what is met, -1 for nothing"),
    ("fraction", "query", "real", "1", "of the translation up to there; of what is closest the signed distance [m]"),
    ("point", "query", "vec2", "m", "where"),
    ("normal", "query", "vec2", "1", "unit vector out of the shape that is met"),
)
