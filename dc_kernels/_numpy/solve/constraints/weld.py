"""The rows of a weld: two points together, and the angle between the bodies, or a spring that turns it back."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.solve.constraints.ends import Ends, X, Y


def make_weld_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    for n in (X, Y):
        ends.hold(ends.point(n))
    about, frequency = ends.turn(joints.joint_reference[j]), joints.joint_frequency[j]
    if frequency > 0:
        ends.spring(about, frequency, joints.joint_damping_ratio[j])
    else:
        ends.hold(about)
