"""Which rods carry much more than what they hang between weighs: sweeps would let them stretch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dc_kernels.model.enums import BodyType, JointKind, JointPart

HEAVY = 12.0
"""Mass of bodies that joints hold together over that of their lightest, above which rods are solved with their tree:
of 20 discs that weigh alike sweeps let a rope stretch by 3 % at 1/60 s, of 50 by 9 % [1]."""

LOOP_SHARE = 10
"""Joints that a component has at least for each that closes a loop in it, for the others to be solved as a tree [1]."""

IF_HEAVY = 16
"""Bit of a builder's column of parts: a rod that has a row across if what it is joined to is heavy."""


class Together:
    """Groups of bodies that joints hold together (union-find)."""

    def __init__(self) -> None:
        """Begin with each body by itself."""
        self._next: dict[int, int] = {}  # from a body towards the one that its group is named by

    def group_of(self, body: int) -> int:
        """The body that a group is named by."""
        while (after := self._next.get(body, body)) != body:
            self._next[body] = self._next.get(after, after)
            body = self._next[body]
        return body

    def join(self, a: int, b: int) -> bool:
        """Put two bodies into one group, named as that of a; False where they are in one already."""
        a, b = self.group_of(a), self.group_of(b)
        self._next[b] = a
        return a != b


def with_rows_across(fields: Mapping[str, np.ndarray], body_type: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Parts of joints, with ``JointPart.ACROSS`` for rods that ask for it in trees under a heavy load, (j,).

    Args:
        fields: ``joint_kind``, ``joint_parts``, ``joint_frequency``, ``joint_body_a`` and ``joint_body_b``.
        body_type: of the bodies, (n,).
        mass: of the bodies, (n,) [kg].
    """
    kind, given = fields["joint_kind"], fields["joint_parts"]
    parts = given & ~IF_HEAVY
    soft = (kind == JointKind.DISTANCE) & (fields["joint_frequency"] > 0)
    rods = (kind == JointKind.DISTANCE) & (given == JointPart.HOLD | IF_HEAVY) & ~soft
    if not rods.any():
        return parts
    holds = (parts & int(JointPart.HOLD) != 0) & ~soft & ~np.isin(kind, (JointKind.TARGET, JointKind.GENERAL))
    dynamic = body_type == BodyType.DYNAMIC
    a, b = fields["joint_body_a"][holds], fields["joint_body_b"][holds]
    inner = dynamic[a] & dynamic[b]
    together, group = Together(), np.arange(len(mass))
    for pair in zip(a[inner].tolist(), b[inner].tolist(), strict=True):
        together.join(*pair)
    for body in np.unique([a[inner], b[inner]]).tolist():
        group[body] = together.group_of(body)
    of_joint = group[np.where(dynamic[a], a, b)]
    count = len(mass)
    total = np.bincount(group[dynamic], mass[dynamic], count)
    least = np.full(count, np.inf)
    np.minimum.at(least, group[dynamic], mass[dynamic])
    joints = np.bincount(of_joint, minlength=count)
    loops = np.bincount(of_joint[inner], minlength=count) - (np.bincount(group[dynamic], minlength=count) - 1)
    chosen = (joints > 1) & (total > HEAVY * least) & (LOOP_SHARE * loops <= joints - loops)
    heavy = np.zeros(len(kind), bool)
    heavy[holds] = chosen[of_joint]
    return np.where(rods & heavy, parts | int(JointPart.ACROSS), parts)
