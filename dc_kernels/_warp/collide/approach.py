"""How fast a contact approached before the forces of a step."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.laws import relative_speed


@cache
def approach_function(dtype: str, name: str) -> Any:
    """``approach_of`` in the kernel module of that name."""
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4

    @wp.func(module=kernel_module(name, dtype))
    def approach_of(c: int, state: t.State, contacts: t.Contacts):
        """Speed at which a contact approaches before the step's forces [m/s], negative where it parts."""
        a = contacts.body_a[c]
        b = contacts.body_b[c]
        n = contacts.normal[c]
        va = state.velocity[a]
        vb = state.velocity[b]
        return -relative_speed(
            n,
            vec4(va[0], va[1], state.angular_velocity[a], real(0.0)),
            vec4(vb[0], vb[1], state.angular_velocity[b], real(0.0)),
            cross(contacts.arm_a[c], n),
            cross(contacts.arm_b[c], n),
        )

    return approach_of
