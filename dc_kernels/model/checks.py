"""Checks of numbers that users give; what is wrong is named with its field, index and limit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

ALL_BITS = 0xFFFFFFFF
# field: (low, low itself allowed, high)
LIMITS = {
    "mass": (0.0, False, math.inf),
    "inertia": (0.0, True, math.inf),
    "radius": (0.0, False, math.inf),
    "rounding": (0.0, True, math.inf),
    "half_width": (0.0, False, math.inf),
    "half_height": (0.0, False, math.inf),
    "density": (0.0, True, math.inf),
    "friction": (0.0, True, math.inf),
    "restitution": (0.0, True, 1.0),
    "category": (0, True, ALL_BITS),
    "mask": (0, True, ALL_BITS),
    "length": (0.0, False, math.inf),
    "length_scale": (0.0, False, math.inf),
}
_ANY = (-math.inf, True, math.inf)
_LABELS = {"rounding": "radius"}


def number(name: str, value: Any, where: str) -> float:
    """One number within the limits of its field.

    Raises:
        ValueError: "radius of shape 3 is -1; it must be finite and > 0", where ``where`` is "shape 3".
    """
    label = _LABELS.get(name, name)
    try:
        result = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{label} of {where} is {value!r}; it must be a number") from error
    low, closed, high = LIMITS.get(name, _ANY)
    if not (math.isfinite(result) and low <= result <= high and (closed or result > low)):
        raise ValueError(f"{label} of {where} is {result!r}; it must be {limit(name)}")
    if isinstance(low, int) and result != int(result):
        raise ValueError(f"{label} of {where} is {result!r}; it must be {limit(name)}")
    return result


def limit(name: str) -> str:
    """The limits of a field in words."""
    low, closed, high = LIMITS.get(name, _ANY)
    if isinstance(low, int):
        return f"an integer in [{low}, {high:#x}]"
    if high < math.inf:
        return f"in [{low:g}, {high:g}]"
    return "finite" if low == -math.inf else f"finite and {'>=' if closed else '>'} {low:g}"


def fill(column: np.ndarray, name: str, values: Any) -> None:
    """Numbers within the limits of their field into a column; a single one fills it.

    Raises:
        ValueError: naming field, index and limit.
    """
    if isinstance(values, (int, float)):
        column[:] = number(name, values, "the discs")
        return
    array = np.asarray(values)
    if array.shape not in ((), column.shape) or array.dtype.kind not in "buif":
        raise ValueError(f"{name} has shape {array.shape}, dtype {array.dtype}; it must be a number or {column.shape}")
    column[:] = array
    low, closed, high = LIMITS.get(name, _ANY)
    good = np.isfinite(column) & (column >= low if closed else column > low) & (column <= high)
    if isinstance(low, int):
        good &= column == np.floor(column)
    if not good.all():
        i = int(good.argmin())
        raise ValueError(f"{name}[{i}] is {float(column[i])!r}; it must be {limit(name)}")


def pair(name: str, value: Any, where: str) -> tuple[float, float]:
    """Two finite numbers.

    Raises:
        ValueError: naming field and ``where``.
    """
    try:
        x, y = value
        x, y = float(x), float(y)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} of {where} is {value!r}; it must be two numbers") from error
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"{name} of {where} is ({x}, {y}); it must be finite")
    return x, y
