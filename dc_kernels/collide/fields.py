"""The arrays that the kernels of stages for anybody's arrays take in groups, beside those of a simulation."""

from __future__ import annotations

from dc_kernels.model.fields import field_table

BOXES = field_table(
    ("lower", "shape", "vec2", "m", "lower corner of each box"),
    ("upper", "shape", "vec2", "m", "upper corner"),
    ("margin", "launch", "real", "m", "by which boxes are larger on each side while pairs are kept"),
    ("filters", "world", "int64", "1", "what the filters were mixed to when pairs were found"),
)
