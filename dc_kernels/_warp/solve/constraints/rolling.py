"""The row of rolling resistance: J = [0, -r, 0, r], whose impulse is bounded by a share of a contact's normal impulse.

r is the radius of what rolls, so that the row's speed is that of two surfaces past each other [m/s], its impulse in
N s, and its bound the coefficient of rolling resistance times the normal impulse, as with Coulomb's friction. A disc
stays where it is on a slope whose tangent is below the coefficient.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.laws import inverse_or_zero, stiffened
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

KEY_BITS = {"SHAPE_BITS": KEY_SHAPE_BITS, "FEATURE_BITS": KEY_FEATURE_BITS}


@cache
def rolling_rows(dtype: str, variant: str) -> SimpleNamespace:
    """``resistance_of`` a contact, 0 where it has no such row, and ``make_rolling_row`` of one that has."""
    t = group_types(dtype)
    Row = t.Row

    def code(radius: bool) -> str:
        return native_code("pack/surface.h", "pack/rolling.h", dtype=dtype, RADIUS=radius, **KEY_BITS)

    @wp.func_native(code(radius=False))
    def resistance_of(c: wp.int32, w: wp.int32, model: t.Model, contacts: t.Contacts) -> t.real: ...

    @wp.func_native(code(radius=True))
    def radius_of(c: wp.int32, w: wp.int32, model: t.Model, contacts: t.Contacts) -> t.real: ...

    @wp.func(module=kernel_module("rows", dtype, variant))
    def make_rolling_row(c: int, w: int, resistance: t.real, model: t.Model, contacts: t.Contacts, rows: t.Rows):
        """The row of contact c of world w; its bounds follow the contact's impulse during the solve."""
        radius = radius_of(c, w, model, contacts)
        row = Row()
        row.body_a = contacts.body_a[c]
        row.body_b = contacts.body_b[c]
        row.normal_arm_a = radius
        row.normal_arm_b = radius
        row.inv_inertia_a = stiffened(model.inv_inertia[row.body_a], rows.stiff_inertia[row.body_a])
        row.inv_inertia_b = stiffened(model.inv_inertia[row.body_b], rows.stiff_inertia[row.body_b])
        row.normal_mass = inverse_or_zero((row.inv_inertia_a + row.inv_inertia_b) * radius * radius)
        row.roll = resistance
        return row

    return SimpleNamespace(resistance_of=resistance_of, make_rolling_row=make_rolling_row)
