"""Enumerations of the integer codes in the arrays of a simulation."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any


class BodyType(IntEnum):
    """How a body moves."""

    STATIC = 0  # never moves, infinite mass
    KINEMATIC = 1  # moves with the velocity it is given, infinite mass
    DYNAMIC = 2  # moves by forces and contacts


class ShapeType(IntEnum):
    """Type of a shape: every shape is the Minkowski sum of its vertices' hull and a disc of ``shape_radius``."""

    DISC = 0  # one vertex, radius > 0
    POLYGON = 1  # 2 vertices (capsule, radius > 0) or 3-8 vertices counter-clockwise, radius >= 0
    SEGMENT = 2  # vertices v1, v2 and the chain's neighbours: one before v1, one after v2 (v1, v2 again if none)


class ShapeRole(IntEnum):
    """How a shape acts on other shapes."""

    SOLID = 0  # its contacts carry impulses
    SENSOR = 1  # it detects overlapping shapes, and carries no impulse
    ONE_WAY = 2  # it collides only with bodies that came from the side of its direction
    ONE_SIDED = 3  # a segment of a chain that collides only on the side of its normal


class JointKind(IntEnum):
    """Kind of a joint, which defines its constraint and the meaning of its numbers (docs/joints.md)."""

    DISTANCE = 0  # two points at a distance: a rod, a spring, a rope
    REVOLUTE = 1  # two points together, with free rotation: a hinge
    PRISMATIC = 2  # body B on a line of body A, without relative rotation: a slider
    WELD = 3  # two points together, and the angle between the bodies
    WHEEL = 4  # a point of B on a line of A, along which a spring holds it
    TARGET = 5  # a point of B pulled to one of A by a spring of limited force
    GEAR = 6  # the angle of B at a ratio to that of A
    GENERAL = 7  # a row of the caller's own Jacobians


class JointPart(IntFlag):
    """Parts of a joint, each with its own rows; bits of ``Joints.joint_parts``."""

    NONE = 0
    HOLD = 1  # the constraint of its kind, rigid or by a spring
    MOTOR = 2  # a motor with a target speed and limited torque or force
    LIMIT = 4  # a range of its angle, length or displacement
    ACROSS = 8  # of a rod, for heavy loads: inertia that keeps it from oscillating within a step


class Flag(IntFlag):
    """Reasons why a world does not advance; bits of ``State.flags``."""

    NONE = 0
    PAIR_OVERFLOW = 1  # more candidate pairs than reserved
    CONTACT_OVERFLOW = 2  # more contact points than reserved
    ROW_OVERFLOW = 4  # more blocks of solver rows than reserved
    NONFINITE = 8  # a velocity or position became NaN or inf: the world keeps its last finite state
    INVALID = 16  # arrays given to a stage are out of range: it did nothing
    ASLEEP = 32  # within a phase only: its stages skip the world, as all its bodies sleep


class Rest(IntEnum):
    """Whether a body sleeps (``fields.SLEEPERS``); bodies that are not dynamic do not."""

    AWAKE = 0
    ASLEEP = 1  # no stage moves it
    ROUSED = 2  # wakes in the next step, with the bodies that it touches; or it is not dynamic and was moved
    FALLING = 3  # falls asleep at the end of the step


class Activity(IntFlag):
    """Contents of a shard of worlds that may sleep; bits without which its launches have nothing to do."""

    ASLEEP = 1  # a world in which a body sleeps
    AWAKE = 2  # a world that is not dormant
    RESTED = 4  # a world in which islands must be searched for


class Element(IntEnum):
    """Type of the elements of an array with limits."""

    NUMBERS = 0  # of the scalar type
    INTEGERS = 1  # int32
    UNITS = 2  # vectors of two numbers, the squares of whose lengths have the limits


def flag_names(flags: Any) -> str:
    """Name the bits of ``State.flags`` of a world, as "PAIR_OVERFLOW, NONFINITE"; empty without any."""
    return ", ".join(str(flag.name) for flag in Flag if flag and flag & int(flags))


CAPACITY_FLAGS = Flag.PAIR_OVERFLOW | Flag.CONTACT_OVERFLOW | Flag.ROW_OVERFLOW
