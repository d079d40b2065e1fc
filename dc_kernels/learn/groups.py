"""Arrays and numbers of a solve in flight, as the kernels take them that show it to a network and correct it."""

from __future__ import annotations

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.fields import field_table

# The worlds that are asked for stand first, in their order; "row" runs over their contacts, one world after the other.
READING = field_table(
    ("active", "world", "int32", "1", "worlds that are asked for"),
    ("packed_start", "world+1", "int32", "1", "first row of each of them"),
    ("answer", "world", "int32", "1", "code of channels.Answer: how each of them is answered"),
    ("least", "world", "real", "N s", "the least that the larger RMS of step and impulses has been in the solve"),
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
    ("share", "launch", "real", "1", "of Aitken's step, that an even answer moves all contacts by"),
)

NETWORK = field_table(
    ("weight", "number", "real", "1", "of all layers, in the order in which they are read (``network.pack``)"),
    ("width", "scale", "int32", "1", "channels of the trunk at each scale"),
    ("hidden", "layer", "int32", "1", "widths of the head's hidden layers"),
    ("scratch", "world,number", "real", "1", "maps of a world at work; a thread uses the row of its first world"),
    ("share", "launch", "real", "1", "of Aitken's step, which is added to the answer"),
    ("spacing", "launch", "real", "m", "of the grid"),
    ("rows", "launch", "int32", "1", "of the grid's nodes"),
    ("columns", "launch", "int32", "1", "of the grid's nodes"),
)

STEP_NETWORK = field_table(
    ("weight", "number", "real", "1", "of all layers, in the order in which they are read (``step_layers.pack``)"),
    ("width", "scale", "int32", "1", "channels of the trunk at each scale"),
    ("scratch", "shard,number", "real", "1", "maps of a world at work, for each thread"),
    ("near", "launch", "int32", "1", "channels that a body reads of the trunk"),
    ("kept", "launch", "int32", "1", "numbers that a contact keeps from round to round"),
    ("wide", "launch", "int32", "1", "width of the layer of a round"),
    ("rounds", "launch", "int32", "1", "rounds along the contacts"),
    ("spacing", "launch", "real", "m", "of the grid"),
    ("origin_x", "launch", "real", "m", "lower left node of the grid"),
    ("origin_y", "launch", "real", "m", "lower left node of the grid"),
    ("rows", "launch", "int32", "1", "of the grid's nodes"),
    ("columns", "launch", "int32", "1", "of the grid's nodes"),
)
ASKING = field_table(
    ("asked", "world", "int32", "1", "1: the network makes its velocities"),
    ("shard", "world", "int32", "1", "row of scratch of the thread that begins with the world"),
    ("wall", "world,grid row,grid column", "real", "1", "1 at the nodes that static shapes cover"),
    ("body_work", "body,body column", "real", "1", "what stays of a body (columns BodyWork)"),
    ("contact_work", "contact,contact column", "real", "1", "what stays of a contact (columns ContactWork)"),
    ("velocity", "body", "vec3", "m/s", "velocities and spins [rad/s] that the network makes"),
)

# of each world: where its calls stand in the solve under way, and counts over all solves
CALLS = field_table(
    ("asking", "world", "int32", "1", "1 while calls are made for it"),
    ("waiting", "world", "int32", "1", "1 where a correction was taken that is still to be judged"),
    ("pause", "world", "int32", "1", "calls to leave out"),
    ("made", "world", "int32", "1", "calls in this solve"),
    ("failures", "world", "int32", "1", "corrections of this solve that were refused, or failed"),
    ("before", "world", "real", "(N s)^2", "squared step of the sweep before the correction"),
    ("calls", "world", "int64", "1", "calls"),
    ("asked", "world", "int64", "1", "calls that went to the network"),
    ("refused", "world", "int64", "1", "corrections that were not taken"),
    ("failed", "world", "int64", "1", "corrections after which the step of a sweep had not shrunk"),
    ("undone", "world", "int64", "1", "failed corrections that were taken back"),
)
RULES = field_table(
    ("middle", "launch", "int32", "1", "1: calls are made while solving"),
    ("most", "launch", "int32", "1", "largest number of calls of a world in a solve"),
    ("trust", "launch", "int32", "1", "calls that may fail beyond two in three before a world is left to the solver"),
    ("pays", "launch", "real", "1", "sweeps left from which on the network is asked"),
    ("small", "launch", "int32", "1", "contacts up to which it is always asked"),
    ("harm", "launch", "real", "1", "least ratio of steps from which on a correction is taken back"),
    ("tolerance", "launch", "real", "N s", "of the solve"),
)


class Calls(ArrayGroup):
    """Where the calls of each world stand (``CALLS``)."""

    table = CALLS


class Reading(ArrayGroup):
    """What is read of a solve in flight (``READING``)."""

    table = READING


class Asking(ArrayGroup):
    """The worlds that a network steps, and what it works with (``ASKING``)."""

    table = ASKING
