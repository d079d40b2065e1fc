"""Groups of arrays as the oracle takes them: the group itself, and numbers by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_kernels.model.arrays import FLOATS, ArrayGroup, numpy_spec
from dc_kernels.model.fields import Field


def array_group(group: ArrayGroup, name: str) -> ArrayGroup:
    """The arrays of a group as kernels take them."""
    return group


def scalars(name: str, dtype: str, values: Mapping[str, Any], table: Mapping[str, Field] | None = None) -> Any:
    """Numbers by name: "config", "launch", or those of a table."""
    return SimpleNamespace(**values)


def struct_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[Any, np.ndarray]:
    """One struct of numbers in an array, as kernels write it, and its memory as a structured NumPy array."""
    spec = [(field.name, *numpy_spec(field, FLOATS[dtype])) for field in table.values()]
    memory = np.zeros(1, np.dtype(spec))
    return memory.view(np.recarray), memory


def no_arrays(name: str, dtype: str, table: Mapping[str, Field]) -> None:
    """A group without arrays, for kernels that don't touch it."""
    return None
