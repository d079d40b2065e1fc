"""Groups of arrays as the oracle takes them: the group itself, and numbers by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_kernels.model.arrays import FLOATS, ArrayGroup, aligned_zeros, struct_dtype
from dc_kernels.model.fields import Field


def array_group(group: ArrayGroup, name: str) -> ArrayGroup:
    """The arrays of a group as kernels take them."""
    return group


def scalars(name: str, dtype: str, values: Mapping[str, Any], table: Mapping[str, Field]) -> Any:
    """Numbers by name."""
    return SimpleNamespace(**values)


def struct_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[np.ndarray, np.ndarray]:
    """An array of one struct, as kernels take it, with its fields as attributes, and as NumPy sees it."""
    values = aligned_zeros((1,), struct_dtype(table, FLOATS[dtype]))
    return values.view(np.recarray), values


def no_arrays(name: str, dtype: str, table: Mapping[str, Field]) -> None:
    """A group without arrays, for kernels that do not touch it."""
    return None
