"""The rows of a general joint: the Jacobians that its user gives."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.solve.constraints.ends import Along, Ends


def make_general_rows(j: int, joints: Any, ends: Ends) -> None:
    """The rows of joint j between its ends."""
    along = Along(np.concatenate([joints.joint_jacobian_a[j], joints.joint_jacobian_b[j]]), 0.0)
    ends.bounded(along, joints.joint_speed[j], joints.joint_lower[j], joints.joint_upper[j])
