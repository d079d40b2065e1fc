"""Constants of a solve in flight; its state is ``stats.iteration``, with the fields of ``model.fields.ITERATION``."""

from __future__ import annotations

from enum import IntEnum

NEVER = 2**30  # sweeps until a pause, where there is none
# arrays of row impulses that an accelerated solve looks back on: two iterates and their steps, the iterate of the least
# change
PAST = 5
BEST = 4
RETREAT = 4.0  # times the least change: a solve that hits its cap beyond goes back to where that was
# times the first change, or what would stop each row alone where that is more: an accelerated sweep that changes more
# was led astray, by steps along which rows are nearly singular
GROWTH = 100.0
# stop "motion" (``SolverConfig.stop``): a sweep may still move one row in MOVING, one in SCARCE by FAR times as much as
# counts, and none by FARTHEST times, or by FAR if one of its bodies is more than ALIKE times as heavy as the other. Of
# the rows of a large pile some are always the last: of 196 000 at rest up to 35 moved by 50 to 130 times after 10
# sweeps, for which all were swept 15 to 45 times. A heavy box on them sank further where its own rows might be far.
# Where ``motion_mean`` is 0 no row may be. FALL: what gravity gives a body in a step, times this, is no impact. ASTRAY
# stands for more rows than there are
MOVING, SCARCE = 10, 5000
FAR, FARTHEST, ALIKE = 50.0, 200.0, 10.0
# no solve ends by motion with a larger residual. Impulses that have run off give the bodies such velocities that any
# change counts as little beside them; with a friction of 1 or less it is .05 at most there (measured)
ASKEW = 0.25
RISE = 2.0  # what impulses gave a body counts up to this times the fastest speed before them: an elastic hit gives that
APART = 5.0  # times as much a sweep may move a row that holds a joint together: a tenth of the slop a step
FALL = 1.5
ASTRAY = 2**30

# numbers that are summed up in one go, and pieces of longer ranges: these depend on the length alone, so that a sum has
# the same bits whatever threads share it
SUMMED, MOST_SUMS = 8192, 64


class Stretch(IntEnum):
    """Methods that the adaptive acceleration chooses between."""

    AITKEN = 0
    MOMENTUM = 1
    ANDERSON = 2


ANDERSON_PERIOD = 3  # sweeps between two updates
ANDERSON_REST, ANDERSON_REST_MAX = 4, 64  # periods without it after one that did harm
