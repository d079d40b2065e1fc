"""Groups of arrays as the oracle takes them: the group itself, and numbers by name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from dc_kernels.model.arrays import ArrayGroup


def array_group(group: ArrayGroup, name: str) -> ArrayGroup:
    """The arrays of a group as kernels take them."""
    return group


def scalars(name: str, dtype: str, values: dict[str, Any]) -> Any:
    """Numbers by name, "config" or "launch"."""
    return SimpleNamespace(**values)
