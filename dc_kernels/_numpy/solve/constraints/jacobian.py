"""The row of a caller's own Jacobians: J_A V_A + J_B V_B + bias + softness impulse = 0, or its impulse at a bound."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.solve.row import PackedRow, effective_mass, inverse_inertias


def make_jacobian_row(k: int, model: Any, motion: Any, rows: Any) -> PackedRow:
    """Row k of those that the caller has given."""
    a, b = rows.row_body_a[k], rows.row_body_b[k]
    j = np.concatenate([rows.row_jacobian_a[k], rows.row_jacobian_b[k]])
    softness = rows.row_softness[k]
    inverse = inverse_inertias(a, b, model, rows)
    alone = effective_mass(j, a, b, model, motion, inverse)
    en = 1.0 / (1.0 / alone + softness) if alone > 0 else alone
    bias = rows.row_bias[k]
    square = (en * (j @ np.concatenate([motion.predicted[a, :3], motion.predicted[b, :3]]) + bias)) ** 2
    lower, upper = rows.row_lower[k], rows.row_upper[k]
    gap, held = rows.row_gap[k], rows.row_held[k]
    more = {"most": upper, "softness": softness, "held": held, "inverse": inverse}
    return PackedRow(a, b, j[3:5], j, np.zeros(6), en, 0.0, bias, 0.0, gap, lower, square, **more)
