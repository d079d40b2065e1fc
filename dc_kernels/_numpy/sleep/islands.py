"""What the kernels of sleep share: islands as sets of bodies, and what was last seen of bodies and joints."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from dc_kernels.model.enums import BodyType, Rest
from dc_kernels.model.fields import CONTACTS, PER_CONTACT

JOINT_SEEN = {"anchor_a": "joint_anchor_a", "anchor_b": "joint_anchor_b", "length": "joint_length"}
"""What is remembered of a joint, and its name there."""


def fields_of(contacts: Any) -> list[str]:
    """Fields of a contact that is kept; its rolling resistance has an impulse only in some scenes."""
    return [name for name, field in CONTACTS.items() if field.per in PER_CONTACT and len(getattr(contacts, name))]


def bodies_of(w: int, model: Any) -> range:
    """Bodies of a world."""
    return range(model.body_start[w], model.body_start[w + 1])


def joints_of(w: int, model: Any) -> range:
    """Joints of a world."""
    return range(model.joint_start[w], model.joint_start[w + 1])


def sleeps(body: int, model: Any, sleepers: Any) -> bool:
    """Whether a body sleeps, or has been roused and wakes in this step."""
    return bool(model.body_type[body] == BodyType.DYNAMIC and sleepers.asleep[body] != Rest.AWAKE)


def moves(body: int, model: Any, state: Any) -> bool:
    """Whether a kinematic body has a velocity."""
    moving = state.velocity[body].any() or state.angular_velocity[body] != 0
    return bool(model.body_type[body] == BodyType.KINEMATIC and moving)


def islands(bodies: Iterable[int], links: Iterable[tuple[int, int]]) -> list[set[int]]:
    """Sets of bodies that links connect."""
    island = {body: {body} for body in bodies}
    for a, b in links:
        if island[a] is not island[b]:
            island[a] |= island[b]
            for body in island[b]:
                island[body] = island[a]
    return list({id(members): members for members in island.values()}.values())


def see_body(body: int, state: Any, sleepers: Any) -> None:
    """Remember where a body is and what acts on it."""
    for name in ("position", "angle", "force", "torque"):
        getattr(sleepers, name)[body] = getattr(state, name)[body]


def is_other(body: int, names: Iterable[str], state: Any, sleepers: Any) -> bool:
    """Whether a body is otherwise than was last seen."""
    return any((getattr(sleepers, name)[body] != getattr(state, name)[body]).any() for name in names)


def see_joint(j: int, joints: Any, sleepers: Any) -> None:
    """Remember what a joint is like."""
    for seen, name in JOINT_SEEN.items():
        getattr(sleepers, seen)[j] = getattr(joints, name)[j]


def is_other_joint(j: int, joints: Any, sleepers: Any) -> bool:
    """Whether a joint is another than was last seen."""
    return any((getattr(sleepers, seen)[j] != getattr(joints, name)[j]).any() for seen, name in JOINT_SEEN.items())
