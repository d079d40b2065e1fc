"""The rows of a gear: the angle of B at a ratio to that of A."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.solve.constraints.ends import Ends


def make_gear_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    ends.hold(ends.turn(joints.joint_reference[j], joints.joint_ratio[j]))
