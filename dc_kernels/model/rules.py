"""What the values of a field must satisfy, in the terms that the field tables use, and the error where they do not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np


@dataclass(frozen=True)
class Number:
    """A finite number from ``low`` to ``high``; ``low`` itself is left out where the rule is ``open``."""

    low: float = -math.inf
    high: float = math.inf
    open: bool = False
    zero: bool = False
    """Whether 0 keeps to the rule as well."""

    @property
    def limits(self) -> str:
        """The range in words."""
        if self.zero:
            return f"0, or {replace(self, zero=False).limits}"
        if math.isfinite(self.high):
            return f"in {'(' if self.open else '['}{self.low:.16g}, {self.high:.16g}]"
        return f"finite and {'>' if self.open else '>='} {self.low:.16g}" if math.isfinite(self.low) else "finite"


@dataclass(frozen=True)
class Code:
    """A number of an enumeration."""

    values: type[IntEnum]


@dataclass(frozen=True)
class Start:
    """Offsets into an axis: they begin with 0, never fall, and end with the length of the axis."""

    axis: str
    spare: bool = False
    """Whether elements may lie behind the last one that belongs to somebody."""


@dataclass(frozen=True)
class Index:
    """The index of an element of an axis, one of the world that the field's element belongs to."""

    axis: str


@dataclass(frozen=True)
class Unit:
    """A vector of length 1, to rounding."""


@dataclass(frozen=True)
class Ascending:
    """Numbers >= 0 that rise from one element of a world to the next, so that none comes twice."""


Rule = Number | Code | Start | Index | Unit | Ascending

FINITE = Number()
POSITIVE = Number(0.0, open=True)
NOT_NEGATIVE = Number(0.0)
INVERSE = Number(0.0, 8e37)
"""An inverse mass: those of two bodies and of their turns add up within float32."""
SHARE = Number(0.0, 1.0)
COUNT = Number(0, 2**31 - 1)
TIME_STEP = Number(1e-18, 1e18)  # [s]; the ratio of two, and the square of one, are normal numbers of float32
UNIT_TOLERANCE = 2e-3  # of the squared length of a unit vector: far above rounding, far below what moves a contact
INVERSE_TOLERANCE = 1e-3  # of mass times inverse mass: inverses of large float32 numbers have few digits


class BrokenRule(ValueError):
    """An array holds what its field must not.

    Attributes:
        place: the array, with the index of the value where one value is to blame.
        text: what is there, and what must be.
    """

    def __init__(self, place: str, text: str) -> None:
        super().__init__(f"{place} {text}")
        self.place, self.text = place, text


def refuse(label: str, values: np.ndarray, bad: np.ndarray, limit: str, first: int = 0) -> None:
    """Refuse an array of which some values are bad.

    Args:
        label: what the error calls the array.
        values: the array, or a part of it.
        bad: which of its values, or of its rows, are bad.
        limit: what they must be, in words.
        first: row of the array at which the part begins.

    Raises:
        BrokenRule: "model.shape_radius[3] is -1.0; it must be finite and >= 0".
    """
    if not bad.any():
        return
    index = np.unravel_index(int(bad.argmax()), bad.shape)
    found = values[index]
    shown = tuple(float(part) for part in found) if np.ndim(found) else found
    place = (int(index[0]) + first, *(int(i) for i in index[1:]))
    raise BrokenRule(f"{label}[{', '.join(map(str, place))}]", f"is {shown}; it must be {limit}")
