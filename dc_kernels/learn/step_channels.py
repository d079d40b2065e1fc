"""What a network that makes the velocities of a step reads of a world, and what its rounds keep of bodies and contacts.

Lengths are in the world's own unit, what gravity moves a body by in the step (g dt^2), and velocities in ways that they
go in the step: contacts at rest look alike whatever dt and g are.
"""

from __future__ import annotations

from enum import IntEnum

BINS = 4
"""Parts of the half circle of normal directions that the contacts' channels are kept apart in [1]."""
BODY_CHANNELS = ("mass", "way_x", "way_y", "turn", "force_x", "force_y")
"""Bodies in the image: mass over the world's mean, predicted way and turn, and what forces add to the way [unit]."""
CONTACT_CHANNELS = ("contacts", "gap", "closing", "sliding")
"""Contacts in the image, of each bin of directions: how many, gap, overlap that the way would make, slip [unit]."""
CHANNELS = (*BODY_CHANNELS, *(f"{name}/{b}" for b in range(BINS) for name in CONTACT_CHANNELS), "wall")
"""Channels of the image in order."""
FLOATING = 1e-3
"""Unit of length where there is no gravity [typical diameters]."""
LEAST_GIVE = 1e-12
"""Least relative velocity that an impulse of one is taken to make [1/kg]."""
MOTION = 10
"""Numbers that say how a contact moves and what it carries [1]."""
ANSWER = 4
"""Numbers of an answer: shares of a step that closes the contact and ends its slip, and two free parts [1]."""


class BodyWork(IntEnum):
    """Columns of what stays of a body from round to round."""

    MASS = 0  # inverse mass and inverse inertia, 0 where it is not dynamic
    INERTIA = 1
    WAY = 2  # predicted way and turn
    NOW = 5  # with the impulses of the last round
    SEEN = 8  # what it reads of the image, then what its contacts say, in whole vectors


class ContactWork(IntEnum):
    """Columns of what stays of a contact from round to round."""

    NORMAL = 0  # x and y
    TURN_A = 2  # arms crossed with the normal
    TURN_B = 3
    SPIN_A = 4  # arms crossed with the tangent
    SPIN_B = 5
    GIVE = 6  # relative velocity that an impulse of one makes, along normal and tangent
    GAP = 8
    IMPULSE = 9  # along normal and tangent
    HIDDEN = 11  # what it says to others, in whole vectors
