"""What a network reads of a solve in flight, and what its answer means: names in the order of the kernels' columns.

With s the step of the last sweep (before the first: that of each contact alone), sigma its RMS over a world's contacts,
r = |s| / |step before| and A = r / (1 - r) what a geometric series would still add (Aitken), x the impulses carried.
"Squashed" is asinh, of values relative to sigma.
"""

from __future__ import annotations

from enum import IntEnum

LOCAL = (
    "step_n",  # squashed step of the last sweep
    "step_t",
    "local_n",  # squashed projected step of the contact alone
    "local_t",
    "since_n",  # squashed change since the last call
    "since_t",
    "impulse_n",  # squashed impulse
    "impulse_t",
    "cone",  # tangential impulse over its limit
    "closed",  # 1 where it presses
    "sliding",  # 1 on the cone
    "new",  # 1 where it is new in this step
    "normal_cos",  # of twice the normal's angle: the same from either side
    "normal_sin",
    "free_n",  # squashed step of the contact alone, unprojected: how open it is, how fast it slides
    "free_t",
    "body_a_n",  # squashed sum of the steps that act on body A, 0 where it does not move
    "body_a_t",
    "body_b_n",
    "body_b_t",
    "degree_a",  # contacts of body A
    "degree_b",
    "share_a",  # inverse mass of A over the sum of both
    "rate",  # log(1 + A), of the world like all that follow
    "begin",  # 1 before the first sweep
    "sweeps",  # log(1 + sweeps done)
    "size",  # log of sigma over the RMS of the impulses
    "left",  # log of sigma over the tolerance
    "accelerated",  # 1 where the solver extrapolates by itself
    "contacts",  # log of the number of contacts
    "rate_near",  # log(1 + A) of the steps near the contact: squares to a coarse grid and back, both bilinearly
)
IMAGE = (
    *(f"{name}_{a}{b}" for name in ("step", "since", "impulse") for a in "xy" for b in "xy"),
    "contacts",
    "normal_cos",
    "normal_sin",
    "new",
    "closed",
    "sliding",
)
"""Splatted channels. step_ab is p_a n_b of p, the step in world axes: it does not depend on which body is A."""

OUTPUT = ("step_n", "step_t", "free_n", "free_t", "carried_n", "carried_t")
"""Correction: multiples of the step times 1 + A, with the A near the contact; and, times sigma and 1 + A of the world,
parts that are the same for all contacts and parts of the impulse carried over its RMS."""


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
