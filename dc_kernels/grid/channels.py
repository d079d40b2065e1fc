"""What an image can show of bodies and contacts: channels by name, and how kernels know them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np


class Channel(NamedTuple):
    """One channel: its code in the kernels, unit and meaning."""

    code: int
    unit: str
    meaning: str


# A body of several points gives each the product of its value and the point's weight. The weights of a body sum to 1,
# so whatever the channel, the body adds its value once.
BODY_CHANNELS = {
    "mass": Channel(0, "kg", "mass"),
    "velocity_x": Channel(1, "m/s", "velocity of the centre of mass"),
    "velocity_y": Channel(2, "m/s", "velocity of the centre of mass"),
    "omega": Channel(3, "rad/s", "angular velocity, counter-clockwise"),
    "inertia": Channel(4, "kg m^2", "moment of inertia about the centre of mass"),
    "angle_cos": Channel(5, "1", "cosine of the rotation"),
    "angle_sin": Channel(6, "1", "sine of the rotation"),
    "speed": Channel(7, "m/s", "magnitude of the velocity"),
}

CONTACT_CHANNELS = {
    "normal_x": Channel(0, "1", "normal from A to B"),
    "normal_y": Channel(1, "1", "normal from A to B"),
    "gap": Channel(2, "m", "distance of the surfaces, negative where they overlap"),
    "impulse_n": Channel(3, "N s", "normal impulse"),
    "impulse_t": Channel(4, "N s", "tangential impulse"),
    "closing_speed": Channel(5, "m/s", "speed at which B approaches A along the normal, of the state's velocities"),
    "sliding_speed": Channel(6, "m/s", "speed of B against A along the tangent, of the state's velocities"),
    "friction": Channel(7, "1", "Coulomb coefficient of the pair"),
    "new": Channel(8, "1", "1 where the contact is new in this step, 0 where it was there before"),
}
IMPULSES = ("impulse_n", "impulse_t")


def channel_codes(what: str, names: Sequence[str], table: Mapping[str, Channel]) -> np.ndarray:
    """Return the codes of channels in the kernels, (channels,) int32.

    Args:
        what: how the error calls ``names``.
        names: of the channels.
        table: ``BODY_CHANNELS`` or ``CONTACT_CHANNELS``.

    Raises:
        ValueError: for an unknown or repeated name.
    """
    if isinstance(names, str):
        raise ValueError(f"{what} is {names!r}; it must be a sequence of names")
    for i, name in enumerate(names):
        if name not in table:
            raise ValueError(f"{what}[{i}] is {name!r}; it must be one of {tuple(table)}")
        if name in names[:i]:
            raise ValueError(f"{what}[{i}] is {name!r}, which is there already")
    return np.array([table[name].code for name in names], np.int32)
