"""Layout of solver rows: contacts and joints of a world, packed colour by colour into blocks of LANES.

A row is a contact's normal and tangent, or a joint. Value of column k, lane l, block b:
``rows.column[(b * len(columns) + k) * LANES + l]``; bodies A and B: ``rows.body[(2 b) * LANES + l]`` and
``rows.body[(2 b + 1) * LANES + l]``; normal and tangential impulse in the same way in ``rows.impulse``.
"""

from __future__ import annotations

import numpy as np

# contacts solved, nodes or neighbours weighed, side by side; 16 contacts gained under 5 % and pad small worlds far more
LANES = 8
COLORS = 64  # colours of the contact graph: bits of a mask; the last one is the serial overflow colour
SERIAL_COLOR = COLORS - 1
GENERAL = ("nx", "ny", "rAn", "rBn", "rAt", "rBt", "iA", "iB", "en", "et", "bias", "mu", "gap")
"""normal; arms crossed with normal and tangent [m]; inverse inertias; effective masses of both directions [kg]
(inverse of (2.25)); bias velocity [m/s]; friction; gap plus slop [m]"""
COLUMNS = {
    "discs": ("nx", "ny", "dA", "dB", "kA", "kB", "en", "et", "bias", "mu", "gap"),
    "general": GENERAL,
    "joints": (*GENERAL, "lo"),
}
"""Columns by variant. "discs": no normal arm; dA, dB lever arms of the surfaces [m], k = arm / inertia. "joints": lo is
the least normal impulse, 0 for contacts and -inf for joints."""


def read_column(column: np.ndarray, variant: str, name: str, slot: np.ndarray) -> np.ndarray:
    """One column of packed rows.

    Args:
        column: ``rows.column``.
        variant: of the rows, a key of ``COLUMNS``.
        name: of the column.
        slot: where the rows' normal impulses lie in ``rows.impulse``, (n,).

    Returns:
        Its values, (n,).
    """
    columns = COLUMNS[variant]
    block, lane = np.divmod(slot, 2 * LANES)
    return column[(block * len(columns) + columns.index(name)) * LANES + lane]
