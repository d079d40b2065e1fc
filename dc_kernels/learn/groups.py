"""Arrays and numbers of a solve in flight, as the kernels take them that show it to a network and correct it."""

from __future__ import annotations

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.fields import field_table

# The worlds that are asked for stand first, in their order; "row" runs over their contacts, one world after the other.
READING = field_table(
    ("active", "world", "int32", "1", "worlds that are asked for"),
    ("packed_start", "world+1", "int32", "1", "first row of each of them"),
    ("grid_origin", "world", "vec2", "m", "lower left node of the grid"),
    ("scale", "world", "vec4", "N s", "RMS of the step and of the impulses, A [1], RMS expected of the correction"),
    ("squares", "world,sweep,grid row,grid column", "real", "(N s)^2", "of the last step and the one before, splatted"),
    ("body_sum", "body", "vec4", "N s", "sum of the steps that act on the body, and their number [1]"),
    ("known", "contact", "vec2", "N s", "impulses after the last correction"),
    ("before", "contact", "vec2", "N s", "impulses before it"),
    ("local", "row,feature", "real", "1", "columns of Feature"),
    ("image_value", "row,channel", "real", "1", "columns of Channel, which are splatted"),
    ("place", "row", "vec2", "m", "the contact point"),
    ("place_a", "row", "vec2", "m", "centre of body A; the contact point where it does not move"),
    ("place_b", "row", "vec2", "m", "centre of body B; the contact point where it does not move"),
    ("step", "row", "vec2", "N s", "step of the last sweep; before the first, that of the contact alone"),
    ("rate", "row", "real", "1", "extrapolation A = r / (1 - r) of the steps near the contact"),
)

SETTINGS = field_table(
    ("begin", "launch", "int32", "1", "1 before the first sweep"),
    ("accelerated", "launch", "int32", "1", "1 where the solver extrapolates by itself"),
    ("tolerance", "launch", "real", "N s", "of the solve"),
    ("cap", "launch", "real", "1", "largest extrapolation A"),
    ("rate_spacing", "launch", "real", "m", "between the nodes that rates are taken at"),
    ("limit", "launch", "real", "1", "largest RMS of a correction that is taken, over that expected"),
)


class Reading(ArrayGroup):
    """What is read of a solve in flight (``READING``)."""

    table = READING
