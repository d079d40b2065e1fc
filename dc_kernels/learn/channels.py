"""What a network reads of a solve in flight, and what its answer means: the columns of the kernels by name.

With s the step of the last sweep (before the first: that of each contact alone), sigma its RMS over a world's contacts,
r = |s| / |step before| and A = r / (1 - r) what a geometric series would still add (Aitken), x the impulses carried.
"Squashed" is asinh, of values relative to sigma.
"""

from __future__ import annotations

from enum import IntEnum


class Feature(IntEnum):
    """Columns of what a network reads of a contact."""

    STEP_N = 0  # squashed step of the last sweep
    STEP_T = 1
    LOCAL_N = 2  # squashed projected step of the contact alone
    LOCAL_T = 3
    SINCE_N = 4  # squashed change since the last call
    SINCE_T = 5
    IMPULSE_N = 6  # squashed impulse
    IMPULSE_T = 7
    CONE = 8  # tangential impulse over its limit
    CLOSED = 9  # 1 where it presses
    SLIDING = 10  # 1 on the cone
    NEW = 11  # 1 where it is new in this step
    NORMAL_COS = 12  # of twice the normal's angle: it does not depend on the side
    NORMAL_SIN = 13
    FREE_N = 14  # squashed step of the contact alone, unprojected: how open it is, how fast it slides
    FREE_T = 15
    BODY_A_N = 16  # squashed sum of the steps that act on body A, 0 where it does not move
    BODY_A_T = 17
    BODY_B_N = 18
    BODY_B_T = 19
    DEGREE_A = 20  # contacts of body A
    DEGREE_B = 21
    SHARE_A = 22  # inverse mass of A over the sum of both
    RATE = 23  # log(1 + A), of the world like all up to CONTACTS
    BEGIN = 24  # 1 before the first sweep
    SWEEPS = 25  # log(1 + sweeps done)
    SIZE = 26  # log of sigma over the RMS of the impulses
    LEFT = 27  # log of sigma over the tolerance
    ACCELERATED = 28  # 1 where the solver extrapolates by itself
    CONTACTS = 29  # log of the number of contacts
    RATE_NEAR = 30  # log(1 + A) of the steps near the contact: squares to a coarse grid and back, both bilinearly


class Channel(IntEnum):
    """Splatted channels. STEP_AB is p_a n_b of p, the step in world axes: it does not depend on which body is A."""

    STEP_XX = 0
    STEP_XY = 1
    STEP_YX = 2
    STEP_YY = 3
    SINCE_XX = 4
    SINCE_XY = 5
    SINCE_YX = 6
    SINCE_YY = 7
    IMPULSE_XX = 8
    IMPULSE_XY = 9
    IMPULSE_YX = 10
    IMPULSE_YY = 11
    CONTACTS = 12
    NORMAL_COS = 13
    NORMAL_SIN = 14
    NEW = 15
    CLOSED = 16
    SLIDING = 17


class Output(IntEnum):
    """Columns of a correction.

    They are multiples of the step times 1 + A, with the A near the contact; and, times sigma and 1 + A of the world,
    parts alike for all contacts and parts of the impulse carried over its RMS.
    """

    STEP_N = 0
    STEP_T = 1
    FREE_N = 2
    FREE_T = 3
    CARRIED_N = 4
    CARRIED_T = 5


LOCAL, IMAGE, OUTPUT = (tuple(column.name.lower() for column in table) for table in (Feature, Channel, Output))


class Answer(IntEnum):
    """How a world that is read is answered."""

    NOTHING = 0
    EVEN = 1
    """All contacts move by a share of 1 + A times their step, A that near the contact."""
    NETWORK = 2
    """Contacts move as an output says (``Output``)."""


SHARE = 1.0
"""Share of Aitken's step that an even answer moves all contacts by, and to which a ContactNet adds its own [1]."""
FOREVER = 1e30
"""Sweeps that are left where their steps do not shrink [1]."""
RUNAWAY = 1e4
"""Ratio of a correction to the impulses of a solve that it may not reach, as float32 has 7 digits [1]."""


class Scale(IntEnum):
    """Columns of the scales of a world that ``SolveReader.scale`` holds."""

    STEP = 0
    """RMS of the step of the last sweep, sigma [N s]."""
    IMPULSE = 1
    """RMS of the impulses carried [N s]."""
    RATE = 2
    """A of the world [1]."""
    EXPECTED = 3
    """RMS that is expected of a correction, (1 + A) sigma [N s]."""
