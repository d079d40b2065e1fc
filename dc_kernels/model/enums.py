"""Integers that mean something in the arrays of a simulation."""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any


class BodyType(IntEnum):
    """How a body moves."""

    STATIC = 0  # never moves, infinite mass
    KINEMATIC = 1  # moves with the velocity it is given, infinite mass
    DYNAMIC = 2  # moves by forces and contacts


class ShapeType(IntEnum):
    """What a shape's vertices mean; every shape is the sum of its vertices' hull and a disc of ``shape_radius``."""

    DISC = 0  # one vertex, radius > 0
    POLYGON = 1  # 2 vertices (capsule, radius > 0) or 3-8 vertices counter-clockwise, radius >= 0
    SEGMENT = 2  # vertices v1, v2 and the chain's neighbours: one before v1, one after v2 (v1, v2 again if none)


class ShapeRole(IntEnum):
    """What a shape does to those that it meets."""

    SOLID = 0  # its contacts carry impulses
    SENSOR = 1  # it detects what overlaps it, and carries no impulse
    ONE_WAY = 2  # its contacts hold what came to it from the side of its direction, and nothing else
    ONE_SIDED = 3  # a segment of a chain whose contacts hold what is on the side of its normal


class JointKind(IntEnum):
    """What a joint keeps, and what its numbers mean (docs/joints.md)."""

    DISTANCE = 0  # two points at a distance: a rod, a spring, a rope
    REVOLUTE = 1  # two points together, while both bodies turn
    PRISMATIC = 2  # body B on a line of body A, without turning against it
    WELD = 3  # two points together, and the angle between the bodies
    WHEEL = 4  # a point of B on a line of A, along which a spring holds it
    TARGET = 5  # a point of B drawn to one of A by a spring of limited force
    GEAR = 6  # the angle of B at a ratio to that of A
    GENERAL = 7  # a row of the caller's own Jacobians


class JointPart(IntFlag):
    """What a joint has, each part with rows of its own; bits of ``Joints.joint_parts``."""

    NONE = 0
    HOLD = 1  # what its kind keeps, rigid or by a spring
    MOTOR = 2  # a speed that a limited torque or force drives at
    LIMIT = 4  # a range of its angle, length or way
    ACROSS = 8  # of a rod, for heavy loads: inertia that keeps it from swinging within a step


class Flag(IntFlag):
    """Why a world does not advance; bits of ``State.flags``."""

    NONE = 0
    PAIR_OVERFLOW = 1  # more candidate pairs than reserved
    CONTACT_OVERFLOW = 2  # more contact points than reserved
    ROW_OVERFLOW = 4  # more blocks of solver rows than reserved
    NONFINITE = 8  # a velocity or position became NaN or inf: the world keeps its last finite state
    INVALID = 16  # arrays from outside that a stage was given are out of range: it did nothing
    ASLEEP = 32  # within a phase only: its stages pass over the world, as all in it sleeps


class Rest(IntEnum):
    """Whether a body sleeps (``fields.SLEEPERS``); bodies that are not dynamic do not."""

    AWAKE = 0
    ASLEEP = 1  # no stage moves it
    ROUSED = 2  # wakes in the next step, with all that it touches; or it is not dynamic and was put elsewhere
    FALLING = 3  # falls asleep: no step is begun with it


class Activity(IntFlag):
    """What is in a shard of worlds that may sleep; bits that its launches need to have anything to do."""

    ASLEEP = 1  # a world in which a body sleeps
    AWAKE = 2  # a world that is not dormant
    RESTED = 4  # a world in which islands are to be looked for


class Element(IntEnum):
    """What the elements of an array are that is held to limits."""

    NUMBERS = 0  # of the scalar type
    INTEGERS = 1  # int32
    UNITS = 2  # vectors of two numbers, the squares of whose lengths have the limits


def flag_names(flags: Any) -> str:
    """Name the bits of ``State.flags`` of a world, as "PAIR_OVERFLOW, NONFINITE"; empty without any."""
    return ", ".join(str(flag.name) for flag in Flag if flag and flag & int(flags))


CAPACITY_FLAGS = Flag.PAIR_OVERFLOW | Flag.CONTACT_OVERFLOW | Flag.ROW_OVERFLOW
