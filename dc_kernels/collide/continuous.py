"""Continuous detection: what a fast body misses does not deflect it, and it passes through nothing.

Contacts are planes that hold from the beginning of a step. Of what turns, or flies past the end of a face, such a plane
may stop what would have missed; and what an impact sets in motion within a step, or what turns by radians, may meet
what it has no contact with. With ``SolverConfig.continuous`` two kernels follow the motion of pairs by conservative
advancement (Mirtich 1996; Coumans 2005): along the line of least distance no point comes nearer than by the velocity of
its body and by the body's turning times the farthest distance of its shape from its centre.

``drop_missed`` stands behind the narrowphase. It takes out the contacts across open gaps that would act in this step,
where their pair does not come to touch by the velocities with which the step begins. A contact that stays is what it
was, so momentum and angular momentum are kept as without.

``stop_short`` stands before the end of the step. A body that would get deeper into another than ``ALLOWED`` in the
motion which the step has found goes that way up to there, and so does what joints hold to it; it keeps its velocity,
and meets the other in the next step. A stop moves a body along its velocity, so it changes no momentum, nor angular
momentum. Pairs are those whose boxes with margin overlap; what leaves its box is looked at with all shapes.
"""

from __future__ import annotations

from dc_kernels.model.config import SolverConfig

SLOPS = 2.0
"""Gap of open contacts, at least [slop]."""
NEAR = 0.2
"""Distance that counts as touching [slop]: more than that by which axes count as equal."""
DEEP = 4.0
"""Overlap up to which no motion is stopped [slop]."""
ALLOWED = 0.25
"""As much, as a share of the inner radius of the smaller shape [1]."""
HALF = 0.5
"""Of it what is as deep already may get deeper by in a step, so that nothing is held for good [1]."""
ADVANCES = 256
"""Of the time in a step, at most, from one pair: the motion up to the last is free."""
ROUNDS = 16
"""Over the pairs, at most: what is stopped may be in the way of others."""
FOLLOWING = ("drop_missed", "stop_short")
"""Kernels that continuous detection adds to those of a step."""


def continuous_kernels(config: SolverConfig) -> tuple[str, ...]:
    """Kernels that settings need beside those of a step (``stages.FOLLOWED``)."""
    return FOLLOWING if config.continuous else ()
