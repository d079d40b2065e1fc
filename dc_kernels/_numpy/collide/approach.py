"""How fast a contact approached before the forces of a step."""

from typing import Any

from dc_kernels._numpy.common import cross, dot


def approach_of(c: int, state: Any, contacts: Any) -> Any:
    """Speed at which a contact approaches before the step's forces [m/s], negative where it parts."""
    a, b, n = contacts.body_a[c], contacts.body_b[c], contacts.normal[c]
    along = dot(n, state.velocity[a] - state.velocity[b])
    turning = cross(contacts.arm_a[c], n) * state.angular_velocity[a]
    return along + turning - cross(contacts.arm_b[c], n) * state.angular_velocity[b]
