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
