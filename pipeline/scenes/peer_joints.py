"""Joints of ours in the engines that ``pipeline.scenes.peers`` copies worlds to, kind by kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.enums import JointKind, JointPart
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.joints import LASTING

FAR = 1e3  # ends of a groove without limits [m]


class PeerJoint(NamedTuple):
    """A joint as other engines are told of it; docs/joints.md says what its numbers mean."""

    number: int
    """Of the model, which errors name."""
    kind: JointKind
    parts: JointPart
    bodies: tuple[int, int]
    """Counted from the first body of the world."""
    anchors: tuple[tuple[float, float], tuple[float, float]]
    collides: bool
    length: float
    axis: tuple[float, float]
    reference: float
    lower: float | None
    """None: there is no such limit."""
    upper: float | None
    speed: float
    strength: float | None
    """None: there is no motor."""
    frequency: float
    damping_ratio: float

    @property
    def is_spring(self) -> bool:
        """Whether what it holds gives way."""
        return self.frequency > 0.0


def peer_joints(joints: Mapping[str, np.ndarray], numbers: range, first_body: int) -> list[PeerJoint]:
    """The joints of a world that are not broken.

    Args:
        joints: fields of ``dc.Joints`` by name.
        numbers: of the world's joints.
        first_body: of the world.

    Raises:
        ValueError: for joints that break, targets, gears and general joints.
    """
    found = []
    for j in numbers:
        if joints["joint_broken"][j]:
            continue
        kind, parts = JointKind(int(joints["joint_kind"][j])), JointPart(int(joints["joint_parts"][j]))
        if kind in (JointKind.TARGET, JointKind.GEAR, JointKind.GENERAL):
            raise ValueError(f"joint_kind[{j}] is {kind.name}; other engines have none as ours")
        if joints["joint_break_force"][j] < LASTING:
            raise ValueError(f"joint_break_force[{j}] is {joints['joint_break_force'][j]:g} N; it must be 1e30, never")
        limits = [float(joints[f"joint_{name}"][j]) for name in ("lower", "upper")]
        free = [JointPart.LIMIT not in parts or abs(limit) >= 0.99 * UNBOUNDED for limit in limits]
        low, high = (None if none else limit for none, limit in zip(free, limits, strict=True))
        ends, anchors = ([joints[f"joint_{what}_{end}"][j].tolist() for end in "ab"] for what in ("body", "anchor"))
        found.append(
            PeerJoint(
                number=j,
                kind=kind,
                parts=parts,
                bodies=(ends[0] - first_body, ends[1] - first_body),
                anchors=(tuple(anchors[0]), tuple(anchors[1])),
                collides=bool(joints["joint_collides"][j]),
                length=float(joints["joint_length"][j]),
                axis=tuple(joints["joint_axis"][j].tolist()),
                reference=float(joints["joint_reference"][j]),
                lower=low,
                upper=high,
                speed=float(joints["joint_speed"][j]),
                strength=float(joints["joint_strength"][j]) if JointPart.MOTOR in parts else None,
                frequency=float(joints["joint_frequency"][j]),
                damping_ratio=float(joints["joint_damping_ratio"][j]),
            )
        )
    return found


def add_to_pymunk(pymunk: Any, space: Any, bodies: list[Any], joint: PeerJoint) -> None:
    """Add the constraints that make up a joint.

    A slider and a wheel go along a groove of finite length. A spring has the stiffness and the damping that ours has
    as it now stands; that of a wheel acts along the line between its ends, which are 1 m apart.

    Raises:
        ValueError: for a slider with a motor, which Chipmunk does not have.
    """
    a, b = (bodies[end] for end in joint.bodies)
    at_a, at_b = joint.anchors
    made: list[Any] = []
    if joint.kind == JointKind.DISTANCE:
        if joint.is_spring:
            line = b.local_to_world(at_b) - a.local_to_world(at_a)
            made.append(pymunk.DampedSpring(a, b, at_a, at_b, joint.length, *_stiffness(joint, a, b, line)))
        elif JointPart.HOLD in joint.parts:
            made.append(pymunk.PinJoint(a, b, at_a, at_b))
            made[0].distance = joint.length
        if JointPart.LIMIT in joint.parts:
            made.append(pymunk.SlideJoint(a, b, at_a, at_b, joint.lower or 0.0, min(joint.upper or FAR, FAR)))
    elif joint.kind in (JointKind.REVOLUTE, JointKind.WELD):
        made.append(pymunk.PivotJoint(a, b, at_a, at_b))
        if joint.kind == JointKind.WELD and joint.is_spring:
            inverse = _inverse(a.moment) + _inverse(b.moment)
            made.append(pymunk.DampedRotarySpring(a, b, -joint.reference, *_constants(joint, inverse)))
        elif joint.kind == JointKind.WELD:
            made.append(pymunk.GearJoint(a, b, joint.reference, 1.0))
    else:
        made += _on_a_line(pymunk, a, b, joint)
    turns = joint.kind in (JointKind.REVOLUTE, JointKind.WHEEL)
    if turns and joint.strength is not None:
        made.append(pymunk.SimpleMotor(a, b, -joint.speed))
        made[-1].max_force = joint.strength
    if joint.kind == JointKind.REVOLUTE and JointPart.LIMIT in joint.parts:
        low, high = -math.inf if joint.lower is None else joint.lower, math.inf if joint.upper is None else joint.upper
        made.append(pymunk.RotaryLimitJoint(a, b, joint.reference + low, joint.reference + high))
    for constraint in made:
        constraint.collide_bodies = joint.collides
    space.add(*made)


def _on_a_line(pymunk: Any, a: Any, b: Any, joint: PeerJoint) -> list[Any]:
    """A slider or a wheel without its motor."""
    if joint.kind == JointKind.PRISMATIC and joint.strength is not None:
        raise ValueError(f"joint {joint.number} is a slider with a motor; pymunk has none")
    (x, y), (along_x, along_y) = joint.anchors[0], joint.axis
    low, high = -FAR if joint.lower is None else joint.lower, FAR if joint.upper is None else joint.upper
    if joint.kind == JointKind.WHEEL and not joint.is_spring:
        return [pymunk.PivotJoint(a, b, *joint.anchors)]
    ends = [(x + way * along_x, y + way * along_y) for way in (low, high)]
    groove = pymunk.GrooveJoint(a, b, *ends, joint.anchors[1])
    if joint.kind == JointKind.PRISMATIC:
        return [groove, pymunk.GearJoint(a, b, joint.reference, 1.0)]
    line = a.local_to_world((along_x, along_y)) - a.local_to_world((0.0, 0.0))
    start = (x + along_x, y + along_y)  # from where the spring pushes back
    return [groove, pymunk.DampedSpring(a, b, start, joint.anchors[1], 1.0, *_stiffness(joint, a, b, line))]


def _inverse(value: float) -> float:
    return 1.0 / value if value > 0.0 else 0.0


def _stiffness(joint: PeerJoint, a: Any, b: Any, line: Any) -> tuple[float, float]:
    """Stiffness [N/m] and damping [N s/m] of a spring along a line of the world."""
    inverse, n = 0.0, line.normalized()
    for body, anchor in zip((a, b), joint.anchors, strict=True):
        if body.body_type == body.DYNAMIC:
            arm = body.local_to_world(anchor) - body.position
            inverse += _inverse(body.mass) + _inverse(body.moment) * arm.cross(n) ** 2
    return _constants(joint, inverse)


def _constants(joint: PeerJoint, inverse: float) -> tuple[float, float]:
    mass, rate = _inverse(inverse), 2.0 * math.pi * joint.frequency
    return mass * rate**2, 2.0 * mass * rate * joint.damping_ratio


def add_to_box2d(space: Any, bodies: list[Any], joint: PeerJoint) -> None:
    """Add the joints that make up one of ours.

    Raises:
        ValueError: for limits of a wheel, and least lengths, which Box2D 2.3 does not have.
    """
    ends: dict[str, Any] = {"bodyA": bodies[joint.bodies[0]], "bodyB": bodies[joint.bodies[1]]}
    ends |= {"localAnchorA": joint.anchors[0], "localAnchorB": joint.anchors[1], "collideConnected": joint.collides}
    low, high = (-FAR if joint.lower is None else joint.lower), (FAR if joint.upper is None else joint.upper)
    limited = JointPart.LIMIT in joint.parts
    driven: dict[str, Any] = {"enableMotor": joint.strength is not None, "motorSpeed": joint.speed}
    spring = {"frequencyHz": joint.frequency, "dampingRatio": joint.damping_ratio}
    if joint.kind == JointKind.DISTANCE:
        if limited and low > 0.0:
            raise ValueError(f"joint_lower[{joint.number}] is {low:g} m; Box2D 2.3 has no least length")
        if JointPart.HOLD in joint.parts:
            space.CreateDistanceJoint(**ends, length=joint.length, **spring)
        if limited and joint.upper is not None:
            space.CreateRopeJoint(**ends, maxLength=high)
    elif joint.kind == JointKind.WELD:
        space.CreateWeldJoint(**ends, referenceAngle=joint.reference, **spring)
    elif joint.kind == JointKind.REVOLUTE:
        driven["maxMotorTorque"] = joint.strength or 0.0
        limits = {"enableLimit": limited, "lowerAngle": low, "upperAngle": high}
        space.CreateRevoluteJoint(**ends, referenceAngle=joint.reference, **limits, **driven)
    elif joint.kind == JointKind.PRISMATIC:
        driven["maxMotorForce"] = joint.strength or 0.0
        limits = {"enableLimit": limited, "lowerTranslation": low, "upperTranslation": high}
        line = {"localAxisA": joint.axis, "referenceAngle": joint.reference}
        space.CreatePrismaticJoint(**ends, **line, **limits, **driven)
    else:
        if limited:
            raise ValueError(f"joint {joint.number} is a wheel with limits; Box2D 2.3 has none")
        driven["maxMotorTorque"] = joint.strength or 0.0
        space.CreateWheelJoint(**ends, localAxisA=joint.axis, **spring, **driven)
