"""The row of a caller's own Jacobians: J = [J_A, J_B], of any numbers, with bounds of its impulse and softness.

It makes J_A V_A + J_B V_B + bias + softness impulse = 0 for the velocities V = (x, y, spin), or stays at a bound.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.laws import inverse_or_zero


@cache
def jacobian_row(dtype: str, variant: str) -> Any:
    """The function that makes the row of a caller's own Jacobians."""
    t = group_types(dtype)
    vec2, vec3, Row = t.vec2, t.vec3, t.Row

    @ti.func
    def make_jacobian_row(k, model: t.Model, motion: t.Motion, rows: t.Rows):
        """Row k, whose Jacobian at A counts the other way, as a contact's normal does; zeros change their sign too."""
        a = rows.row_body_a[k]
        b = rows.row_body_b[k]
        ja = vec3(rows.row_jacobian_a[k, 0], rows.row_jacobian_a[k, 1], rows.row_jacobian_a[k, 2])
        jb = vec3(rows.row_jacobian_b[k, 0], rows.row_jacobian_b[k, 1], rows.row_jacobian_b[k, 2])
        va = motion.predicted[a]
        vb = motion.predicted[b]
        ia = model.inv_inertia[a]
        ib = model.inv_inertia[b]
        ia = ia / (1.0 + ia * rows.stiff_inertia[a])
        ib = ib / (1.0 + ib * rows.stiff_inertia[b])
        of_a = va[3] * (ja[0] * ja[0] + ja[1] * ja[1]) + ia * ja[2] * ja[2]
        of_b = vb[3] * (jb[0] * jb[0] + jb[1] * jb[1]) + ib * jb[2] * jb[2]
        speed = (ja[0] * va[0] + ja[1] * va[1] + ja[2] * va[2]) + (jb[0] * vb[0] + jb[1] * vb[1] + jb[2] * vb[2])
        row = Row()
        row.body_a = a
        row.body_b = b
        row.normal = vec2(jb[0], jb[1])
        row.direction_a = vec2(-1.0 * ja[0], -1.0 * ja[1])
        row.normal_arm_a = -1.0 * ja[2]
        row.normal_arm_b = jb[2]
        row.inv_inertia_a = ia
        row.inv_inertia_b = ib
        row.softness = rows.row_softness[k]
        if of_a + of_b > 0.0:
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
