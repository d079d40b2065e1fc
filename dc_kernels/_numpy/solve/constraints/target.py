"""The rows of a target: a point of B drawn to one of A by a spring of limited force."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.solve.constraints.ends import Ends, X, Y


def make_target_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    most = joints.joint_strength[j] * ends.dt
    for n in (X, Y):
        ends.spring(ends.point(n), joints.joint_frequency[j], joints.joint_damping_ratio[j], most)
