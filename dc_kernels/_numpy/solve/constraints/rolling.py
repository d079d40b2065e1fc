"""The row of rolling resistance: J = [0, -r, 0, r], bounded by a share of a contact's normal impulse."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.solve.row import PackedRow, effective_mass, inverse_inertias
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS


def shapes_of(c: int, w: int, model: Any, contacts: Any) -> tuple[int, int]:
    """Shapes A and B of a contact, as its key names them."""
    pair = int(contacts.key[c]) >> KEY_FEATURE_BITS
    first = int(model.shape_start[w])
    return first + (pair >> KEY_SHAPE_BITS), first + (pair & (2**KEY_SHAPE_BITS - 1))


def slip_of(c: int, w: int, model: Any, contacts: Any, rows: Any) -> Any:
    """Tangential speed of the surface of B against that of A where the bodies rest [m/s]."""
    if len(rows.surface_speed):  # which a user may have changed
        return -rows.surface_speed[c]
    a, b = shapes_of(c, w, model, contacts)
    return -(model.shape_surface_speed[a] + model.shape_surface_speed[b])


def make_rolling_row(c: int, w: int, model: Any, motion: Any, contacts: Any, rows: Any) -> PackedRow | None:
    """The row of contact c of world w; None where nothing resists rolling."""
    shapes = list(shapes_of(c, w, model, contacts))
    resistance, radius = model.shape_rolling_resistance[shapes].max(), model.shape_radius[shapes].max()
    a, b = contacts.body_a[c], contacts.body_b[c]
    none = np.zeros(2, radius.dtype)
    jn = np.array([0, 0, -radius, 0, 0, radius], radius.dtype)
    inverse = inverse_inertias(a, b, model, rows)
    mass = effective_mass(jn, a, b, model, motion, inverse)
    if not (resistance > 0 and mass > 0):
        return None
    zero = radius.dtype.type(0)
    rest = (zero, zero, zero, zero, zero, zero, zero)
    return PackedRow(a, b, none, jn, np.zeros_like(jn), mass, *rest, roll=resistance, held=0.0, inverse=inverse)
