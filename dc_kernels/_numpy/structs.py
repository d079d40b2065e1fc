"""Groups of arrays and numbers as the oracle takes them: attributes of one object."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.fields import Field


def group(name: str, dtype: str, table: Mapping[str, Field], values: Mapping[str, Any]) -> SimpleNamespace:
    """Return an object with the values by name; arrays are the numpy ones."""
    return SimpleNamespace(**{key: to_numpy(v) if table[key].per != "launch" else v for key, v in values.items()})
