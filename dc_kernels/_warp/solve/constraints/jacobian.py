"""The row of a caller's own Jacobians: J = [J_A, J_B], of any numbers, with bounds of its impulse and softness.

It makes J_A V_A + J_B V_B + bias + softness impulse = 0 for the velocities V = (x, y, spin), or stays at a bound.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.laws import inverse_or_zero, stiffened


@cache
def jacobian_row(dtype: str, variant: str) -> Any:
    """The function that makes the row of a caller's own Jacobians."""
    t = group_types(dtype)
    real, vec2, Row = t.real, t.vec2, t.Row

    @wp.func(module=kernel_module("rows", dtype, variant))
    def make_jacobian_row(k: int, model: t.Model, motion: t.Motion, rows: t.Rows):
        """Row k, whose Jacobian at A counts the other way, as a contact's normal does."""
        a = rows.row_body_a[k]
        b = rows.row_body_b[k]
        ja = rows.row_jacobian_a[k]
        jb = rows.row_jacobian_b[k]
        va = motion.predicted[a]
        vb = motion.predicted[b]
        ia = stiffened(model.inv_inertia[a], rows.stiff_inertia[a])
        ib = stiffened(model.inv_inertia[b], rows.stiff_inertia[b])
        of_a = va[3] * (ja[0] * ja[0] + ja[1] * ja[1]) + ia * ja[2] * ja[2]
        of_b = vb[3] * (jb[0] * jb[0] + jb[1] * jb[1]) + ib * jb[2] * jb[2]
        speed = (ja[0] * va[0] + ja[1] * va[1] + ja[2] * va[2]) + (jb[0] * vb[0] + jb[1] * vb[1] + jb[2] * vb[2])
        row = Row()
        row.body_a = a
        row.body_b = b
        row.normal = vec2(jb[0], jb[1])
        row.direction_a = vec2(-ja[0], -ja[1])
        row.normal_arm_a = -ja[2]
        row.normal_arm_b = jb[2]
        row.inv_inertia_a = ia
        row.inv_inertia_b = ib
        row.softness = rows.row_softness[k]
        if of_a + of_b > real(0.0):
            row.normal_mass = inverse_or_zero(of_a + of_b + row.softness)
        row.bias = rows.row_bias[k]
        row.gap = rows.row_gap[k]
        row.held = rows.row_held[k]
        row.least = rows.row_lower[k]
        row.most = rows.row_upper[k]
        stop = row.normal_mass * (speed + row.bias)
        row.square = stop * stop
        return row

    return make_jacobian_row
