"""Joints as a step sees them: the rows that they have, and the kernels that they need."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from dc_kernels.model.arrays import Fielded, Model
from dc_kernels.model.enums import BodyType, JointKind, JointPart
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.model.joints.groups import HELD, Joints
from dc_kernels.model.joints.heavy import LOOP_SHARE, Together

STIFFNESS = 4.0
"""Rows of joints have at least this times dt^2 r . f of inertia at a body that a force f pulls at by the arm r [1]."""

SMALL_TURN = 0.2
"""Turn in a step from which rows no longer make up for what it adds, to second order, as that misleads [rad]."""

NEAR_LIMIT = 0.25
"""A limit is left out of a step that is further away than this, and than twice what the joint moves in it
[rad, length_scale]."""

BRAKED = 8.0
"""Inertia that the pull at a body asks for, over its own, from which what turns far in a step is braked [1]."""

TREE_JOINT, TREE_MOVES = 44, 12
"""Numbers that a direct solve of trees keeps of each joint, and of each body (``_warp/native/solve/tree.h``)."""

PAIRED = (int(JointKind.REVOLUTE), int(JointKind.PRISMATIC), int(JointKind.WELD))
"""Kinds whose first two rows substeps solve as one block."""

LASTING = 0.99 * UNBOUNDED
"""A break force from which a joint lasts, whatever the scalar type rounds it to [N]."""


def are_rods(joints: Fielded) -> bool:
    """Whether all joints are rods that never break and let their bodies collide, which are packed as they are made."""
    kind, parts = joints.numpy("joint_kind"), joints.numpy("joint_parts")
    if not len(kind):
        return True
    rigid = (kind == JointKind.DISTANCE) & (parts == JointPart.HOLD) & (joints.numpy("joint_frequency") == 0)
    lasting = joints.numpy("joint_break_force") >= LASTING
    plain = lasting & (joints.numpy("joint_broken") == 0) & (joints.numpy("joint_collides") == 1)
    return bool((rigid & plain).all())


def joint_kernels(joints: Fielded, rods: bool) -> tuple[str, ...]:
    """Kernels that the joints of a scene need beside those of a step; none where all are rods.

    Args:
        joints: of the scene.
        rods: whether they are packed as rods (``are_rods``).
    """
    if rods or not len(joints.numpy("joint_kind")):
        return ()
    names = ["make_joint_rows"]
    if joints.numpy("joint_break_force").min() < LASTING:
        names.append("break_joints")
    if not joints.numpy("joint_collides").all():
        names.append("separate_joined")
    return tuple(names)


def rows_of_worlds(model: Model, joints: Joints) -> np.ndarray:
    """Rows of the joints of each world, (W,) int64."""
    return np.diff(joints.numpy("joint_row_start")[model.numpy("joint_start")]).astype(np.int64)


class Forest(NamedTuple):
    """Joints that form trees with their bodies, in the order of elimination: what is further from the root first."""

    start: np.ndarray
    """First tree of each world, and how many there are, (W + 1,)."""
    first: np.ndarray
    """First joint of each tree, and how many there are, (trees + 1,)."""
    row: np.ndarray
    """First row of each, (n,)."""
    size: np.ndarray
    """Rows of each, (n,)."""
    parent: np.ndarray
    """Its body that is nearer to the root, (n,)."""
    child: np.ndarray
    """Its other body, -1 where that is not dynamic, (n,)."""


def plant(model: Model, joints: Joints) -> Forest:
    """The trees of the joints that hold something without bounds; one that closes a loop is in none.

    Rods without ``JointPart.ACROSS`` are left to the sweeps: solved exactly, light bodies between them would swing
    across them within a step.
    """
    kind, parts = joints.numpy("joint_kind"), joints.numpy("joint_parts")
    bounded = np.isin(kind, (JointKind.TARGET, JointKind.GENERAL))
    bounded |= (kind == JointKind.DISTANCE) & (parts & int(JointPart.ACROSS) == 0)
    held = np.flatnonzero((parts & int(JointPart.HOLD) != 0) & ~bounded)
    dynamic = model.numpy("body_type") == BodyType.DYNAMIC
    a, b = joints.numpy("joint_body_a")[held], joints.numpy("joint_body_b")[held]
    links: dict[int, list[tuple[int, int]]] = {}  # of each body: other body, -1 where it is not dynamic, and joint
    together = Together()
    loops: list[int] = []  # a body of each joint that closes one
    for j, p, c in zip(held.tolist(), a.tolist(), b.tolist(), strict=True):
        if dynamic[p] and dynamic[c]:
            if not together.join(p, c):
                loops.append(p)
                continue
            links.setdefault(c, []).append((p, j))
        one, other = (p, c if dynamic[c] else -1) if dynamic[p] else (c, -1)
        links.setdefault(one, []).append((other, j))
    loops_of = Counter(map(together.group_of, loops))
    order: list[tuple[int, int, int, int]] = []  # joint, parent, child, root, from the roots on
    seen: set[int] = set()
    for first in sorted(links):
        if first in seen:
            continue
        bodies = [first]
        seen.add(first)
        for body in bodies:
            for other, _ in links[body]:
                if other >= 0 and other not in seen:
                    seen.add(other)
                    bodies.append(other)
        fixed = sum(other < 0 for body in bodies for other, _ in links[body])
        if LOOP_SHARE * loops_of[together.group_of(first)] > len(bodies) - 1 + fixed:
            continue
        middle = _middle({body: [other for other, _ in links[body] if other >= 0] for body in bodies})
        queue, parent = [middle], {middle: -1}
        for body in queue:
            order += [(j, body, -1, middle) for other, j in reversed(links[body]) if other < 0]
            for other, j in links[body]:
                if other >= 0 and other != parent[body]:
                    parent[other] = body
                    queue.append(other)
                    order.append((j, body, other, middle))
    found = np.array(order[::-1], np.int64).reshape(-1, 4)
    world = np.searchsorted(model.numpy("joint_start"), found[:, 0], "right") - 1
    found, world = found[np.argsort(world, kind="stable")], np.sort(world)
    begins = np.flatnonzero(np.diff(found[:, 3], prepend=-1))
    start = np.searchsorted(world[begins], np.arange(model.world_count + 1)).astype(np.int32)
    first_joint = np.append(begins, len(found)).astype(np.int32)
    size = np.array([HELD[one] for one in JointKind])[kind[found[:, 0]]]
    size += parts[found[:, 0]] & int(JointPart.ACROSS) != 0
    row = joints.numpy("joint_row_start")[found[:, 0]]
    return Forest(start, first_joint, row, *(values.astype(np.int32) for values in (size, found[:, 1], found[:, 2])))


def _middle(near: dict[int, list[int]]) -> int:
    """The body of a tree from which the farthest one is fewest joints away.

    What is done to one half of a chain need not wait for the other then, so that a processor does both at once.

    Args:
        near: its neighbours by body.
    """
    open_ends = {body: len(others) for body, others in near.items()}
    leaves, left = [body for body, count in open_ends.items() if count <= 1], len(near)
    while left > 2:
        left -= len(leaves)
        within = []
        for leaf in leaves:
            for other in near[leaf]:
                open_ends[other] -= 1
                if open_ends[other] == 1:
                    within.append(other)
        leaves = within
    return min(leaves)


class Apart(NamedTuple):
    """Bodies that joints keep from colliding with each other, by each of the two."""

    start: np.ndarray
    """First of each body, and how many there are, (bodies + 1,)."""
    body: np.ndarray
    """The other body, (n,)."""
    joint: np.ndarray
    """The joint, (n,)."""


def apart(model: Model, joints: Joints) -> Apart:
    """The bodies that joints keep from colliding with each other."""
    chosen = np.flatnonzero(joints.numpy("joint_collides") == 0)
    a, b = joints.numpy("joint_body_a")[chosen], joints.numpy("joint_body_b")[chosen]
    one, other, joint = np.concatenate([a, b]), np.concatenate([b, a]), np.concatenate([chosen, chosen])
    order = np.lexsort((other, one))
    start = np.searchsorted(one[order], np.arange(model.body_count + 1))
    return Apart(*(values.astype(np.int32) for values in (start, other[order], joint[order])))
