"""Joints of all kinds: their arrays, and how many rows each has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypedDict

import numpy as np

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.enums import JointKind, JointPart
from dc_kernels.model.fields import JOINTS, UNBOUNDED
from dc_kernels.model.rules import refuse

HELD = {
    JointKind.DISTANCE: 1,
    JointKind.REVOLUTE: 2,
    JointKind.PRISMATIC: 2,
    JointKind.WELD: 3,
    JointKind.WHEEL: 2,
    JointKind.TARGET: 2,
    JointKind.GEAR: 1,
    JointKind.GENERAL: 1,
}
"""Rows of the part ``HOLD`` of each kind; each other part is a row."""
FREE = JointPart.MOTOR | JointPart.LIMIT
OPTIONAL = {
    JointKind.DISTANCE: JointPart.HOLD | JointPart.LIMIT | JointPart.ACROSS,
    JointKind.REVOLUTE: FREE,
    JointKind.PRISMATIC: FREE,
    JointKind.WHEEL: FREE,
}
"""Parts that a joint of each kind may have or lack; any other kind has ``HOLD`` alone."""
COLUMNS = {
    "joint_body_a": slice(0, 1),
    "joint_body_b": slice(1, 2),
    "joint_anchor_a": slice(2, 4),
    "joint_anchor_b": slice(4, 6),
    "joint_length": slice(6, 7),
    "joint_kind": slice(7, 8),
    "joint_parts": slice(8, 9),
    "joint_axis": slice(9, 11),
    "joint_reference": slice(11, 12),
    "joint_ratio": slice(12, 13),
    "joint_lower": slice(13, 14),
    "joint_upper": slice(14, 15),
    "joint_speed": slice(15, 16),
    "joint_strength": slice(16, 17),
    "joint_frequency": slice(17, 18),
    "joint_damping_ratio": slice(18, 19),
    "joint_jacobian_a": slice(19, 22),
    "joint_jacobian_b": slice(22, 25),
    "joint_break_force": slice(25, 26),
    "joint_collides": slice(26, 27),
}
"""Columns of a builder's table of joints, by the field of ``fields.JOINTS`` that they become."""
WIDTH = 27
EXTENTS = ("joint_length", "joint_lower", "joint_upper")
"""Fields that are held to others, too (``check_extents``)."""


def count_rows(kind: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Rows of joints of some kinds (``JointKind``) with some parts (``JointPart``), (n,) int64."""
    held = np.array([HELD[one] for one in JointKind], np.int64)[np.asarray(kind, np.int64)]
    parts = np.asarray(parts, np.int64)
    single = sum((parts & int(part) != 0).astype(np.int64) for part in JointPart if part != JointPart.HOLD)
    return np.asarray(held * (parts & int(JointPart.HOLD) != 0) + single, np.int64)


def check_extents(joints: Mapping[str, np.ndarray], label: str = "") -> None:
    """Hold the lengths and limits of joints to what they are.

    Args:
        joints: arrays by name; those of ``EXTENTS``, and what kinds and parts they have.
        label: stands before the names in an error.

    Raises:
        BrokenRule: for a rod of length 0 or less, or a lower limit above the upper one.
    """
    kind, parts = joints["joint_kind"], joints["joint_parts"]
    held = parts & ~int(JointPart.ACROSS) == JointPart.HOLD
    rod = (kind == JointKind.DISTANCE) & held & (joints["joint_frequency"] == 0)
    length = joints["joint_length"]
    refuse(f"{label}joint_length", length, rod & (length <= 0), "finite and > 0, for the joint is rigid")
    lower, upper = joints["joint_lower"], joints["joint_upper"]
    bounded = (parts & int(JointPart.LIMIT) != 0) | (kind == JointKind.GENERAL)
    refuse(f"{label}joint_lower", lower, bounded & (lower > upper), "at most joint_upper")


class JointOptions(TypedDict, total=False):
    """Keywords that every joint takes."""

    collide_connected: bool  # whether its bodies collide; default False, but True for distance, rope and target joints
    break_force: float | None  # force > 0 [N] above which the joint breaks for good; default None: never


class Joints(ArrayGroup):
    """Joints of all kinds (``model.fields.JOINTS``), rods unless other values are written; docs/joints.md.

    Their properties may be written between steps, except ``joint_kind`` and ``joint_parts``, which determine their
    rows.
    """

    table = JOINTS
    live = (
        *("joint_anchor_a", "joint_anchor_b", "joint_length", "joint_axis", "joint_reference", "joint_ratio"),
        *("joint_lower", "joint_upper", "joint_speed", "joint_strength", "joint_damping_ratio"),
        *("joint_jacobian_a", "joint_jacobian_b", "joint_impulse"),
    )
    changeable = tuple(
        name for name in JOINTS if name not in ("joint_row_start", "joint_kind", "joint_parts", "joint_color")
    )

    def __init__(self, sizes: Mapping[str, int], dtype: Any, device: str = "cpu", backend: str = "warp") -> None:
        """Allocate rods of length 0 between body 0 and itself, which hold for ever.

        Args:
            sizes: "joint", and "joint row" where they have other rows than one each.
            dtype: see ``ArrayGroup``, as for what follows.
            device: of the arrays.
            backend: of the arrays.
        """
        count = sizes["joint"]
        rows = sizes.get("joint row", count)
        super().__init__({**sizes, "joint+1": count + 1, "joint row": rows}, dtype, device, backend)
        if count:
            self.fill("joint_parts", np.full(count, int(JointPart.HOLD), np.int32))
            self.fill("joint_axis", np.tile(np.array([1.0, 0.0], self.dtype), (count, 1)))
            for name, value in (("joint_break_force", UNBOUNDED), ("joint_upper", UNBOUNDED)):
                self.fill(name, np.full(count, value, self.dtype))
            self.fill("joint_collides", np.ones(count, np.int32))
            if rows == count:
                self.fill("joint_row_start", np.arange(count + 1, dtype=np.int32))

    def assign(self, name: str, values: Any) -> None:
        """Copy values into a field; see ``ArrayGroup.assign``.

        Raises:
            ValueError: as there; for impulses between the steps of a simulation, which would ignore them; in joints
                that a simulation goes by for a rod of length 0 and a lower limit above the upper one; where both limits
                move beyond each other, write the one first that moves away.
        """
        if name == "joint_impulse" and {user.phase for user in self.users} == {"advance"}:
            raise ValueError(
                "joint_impulse is a result between two steps; sim.change_model(joint_impulse=values) sets what the next"
                " step starts from, and assign what a solve starts from, between sim.collide and sim.solve"
            )
        if not (self.fixed and name in EXTENTS):
            super().assign(name, values)
            return
        before = self.numpy(name).copy()
        super().assign(name, values)
        try:
            check_extents({one: self.numpy(one) for one in (*EXTENTS, "joint_kind", "joint_parts", "joint_frequency")})
        except ValueError:
            self.fill(name, before)
            raise
