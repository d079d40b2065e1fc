"""Layout of solver rows: contacts and joints of a world, packed colour by colour into blocks of LANES.

A row is a contact's normal and tangent, or a joint. Value of column k, lane l, block b:
``rows[(b * len(columns) + k) * LANES + l]``; bodies A and B: ``row_body[(2 b) * LANES + l]`` and
``row_body[(2 b + 1) * LANES + l]``; normal and tangential impulse in the same way in ``row_impulse``.
"""

from __future__ import annotations

import numpy as np

from dc_kernels.model.arrays import Fielded, Model
from dc_kernels.model.enums import BodyType, ShapeRole, ShapeType
from dc_kernels.model.fields import COLORS

# contacts solved, nodes or neighbours weighed, side by side; 16 contacts gained under 5 % and pad small worlds far more
LANES = 8
SERIAL_COLOR = COLORS - 1
GENERAL = ("nx", "ny", "rAn", "rBn", "rAt", "rBt", "iA", "iB", "en", "et", "bias", "mu", "gap")
"""normal; arms crossed with normal and tangent [m]; inverse inertias; effective masses of both directions [kg]
(inverse of (2.25)); bias velocity [m/s]; friction; gap plus slop [m]"""
BOUNDED = ("lo", "hi", "ax", "ay", "soft", "held")
COLUMNS = {
    "discs": ("nx", "ny", "dA", "dB", "kA", "kB", "en", "et", "bias", "mu", "gap"),
    "general": GENERAL,
    "joints": (*GENERAL, "lo"),
    "rows": (*GENERAL, *BOUNDED),
    "surfaces": (*GENERAL, *BOUNDED, "slip", "roll"),
}
"""Columns by variant. "discs": no normal arm; dA, dB lever arms of the surfaces [m], k = arm / inertia. "joints": lo is
the least normal impulse, 0 for contacts and -inf for joints. "rows": a caller's own Jacobians too, whose impulses lie
between lo and hi [N s]; (ax, ay) is at body A what (nx, ny) is at body B, soft the velocity for each impulse, held is 1
where position correction moves the row, else 0.
"surfaces": slip is the tangential speed of surfaces that move [m/s]; rows of rolling resistance, behind those of the
contacts, have roll, the share of the contact's normal impulse that bounds theirs, 0 in all other rows."""
JOINTED = ("joints", "rows", "surfaces")
"""Variants in which there may be joints."""
OWN = ("rows", "surfaces")
"""Variants whose rows have two bounds, softness, and directions of their own at each body."""
SURFACED = ("surfaces",)
"""Variants for surfaces that move, or resist rolling."""
TOUCH = 0.01
"""Share of the slop by which shapes must overlap for a soft contact: those that a substep let close are hard."""
SOFT_NUMBERS = 13
"""Numbers that a sweep of soft rows is given (``native/solve/soft.h``)."""
ROLLING_COLOR = 32
"""Colour of the rows of rolling resistance of the contacts of colour 0, where contacts and joints have no more."""


def read_column(columns: np.ndarray, variant: str, name: str, slot: np.ndarray) -> np.ndarray:
    """Read a column of the rows whose normal impulses lie at the given slots, (n,).

    Args:
        columns: ``rows.column`` of a simulation.
        variant: key of ``COLUMNS``.
        name: of the column.
        slot: places in ``rows.impulse``, as ``rows.slot`` and ``rows.joint_slot`` hold them, (n,).
    """
    names = COLUMNS[variant]
    # a block has two numbers a lane in ``rows.impulse``, and as many in each column
    return columns.take((slot // (2 * LANES) * (len(names) - 2) + names.index(name)) * LANES + slot)


def only_centred_discs(model: Fielded) -> bool:
    """Whether all that moves are discs about their centre of mass; sensors do not count, as none has contacts."""
    moving = (model.numpy("body_type") != BodyType.STATIC)[model.numpy("shape_body")]
    if len(role := model.numpy("shape_role")):
        moving &= role != ShapeRole.SENSOR
    centred_disc = (model.numpy("shape_type") == ShapeType.DISC) & ~model.numpy("shape_center").any(axis=1)
    return bool((~moving | centred_disc).all())


def has_traits(model: Model) -> bool:
    """Whether a body has damping, or a gravity of its own."""
    damped = model.numpy("linear_damping").any() or model.numpy("angular_damping").any()
    return bool(damped or (model.numpy("gravity_scale") != 1).any())


def resists_rolling(model: Fielded) -> bool:
    """Whether a shape resists rolling: contacts then have an impulse more, which is kept from step to step."""
    return bool(model.numpy("shape_rolling_resistance").any())


def rolling_kernels(model: Fielded) -> tuple[str, ...]:
    """Kernels that a scene needs beside those of a step (``stages.ROLLED``)."""
    return ("match_rolling", "keep_rolling") if resists_rolling(model) else ()


def variant_of(model: Fielded, only_discs: bool, rods: bool = True) -> str:
    """The variant of rows that a scene needs, a key of ``COLUMNS``.

    Args:
        model: of the scene.
        only_discs: whether all that moves are discs about their centre of mass.
        rods: whether all joints are rods.

    Returns:
        The first of these, or general: surfaces where one moves or resists rolling; joints where all are rods; rows
        with others; discs where there is nothing else.
    """
    if model.numpy("shape_surface_speed").any() or resists_rolling(model):
        return "surfaces"
    if model.numpy("joint_start")[-1]:
        return "joints" if rods else "rows"
    return "discs" if only_discs else "general"
