"""Checks of options, whose errors name the option and its limit."""

from __future__ import annotations

import math
from typing import Any


def check_least(options: Any, prefix: str = "", **least: float) -> None:
    """Raise a ``ValueError`` unless options are at least so large; None is let through.

    Args:
        options: their owner.
        prefix: stands before the name in the error.
        least: limit of each option, by name.
    """
    for name, low in least.items():
        value = getattr(options, name)
        if value is not None and not value >= low:
            raise ValueError(f"{prefix}{name} is {value}; it must be >= {low}")


def check_finite(options: Any, *names: str, above: bool = True) -> None:
    """Raise a ``ValueError`` unless options are finite and > 0, or >= 0 if not ``above``."""
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and (value > 0.0 or (value == 0.0 and not above))):
            raise ValueError(f"{name} is {value!r}; it must be finite and {'>' if above else '>='} 0")
