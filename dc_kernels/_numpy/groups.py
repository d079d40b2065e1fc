"""Groups of arrays and numbers as the oracle takes them: attributes of one object."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_kernels.model.dtypes import FLOATS, aligned_zeros, struct_dtype
from dc_kernels.model.fields import Field


def group(name: str, dtype: str, table: Mapping[str, Field], values: Mapping[str, Any]) -> SimpleNamespace:
    """An object with the values by name; arrays of other backends on the CPU are seen as numpy's.

    Args:
        name: of the group.
        dtype: "float32" or "float64".
        table: its fields.
        values: numbers and arrays.
    """
    return SimpleNamespace(**{key: v.numpy() if hasattr(v, "numpy") else v for key, v in values.items()})


def array_group(arrays: Any, name: str) -> Any:
    """The arrays of a ``model.arrays.ArrayGroup`` as kernels take them: that itself."""
    return arrays


def element_array(name: str, dtype: str, table: Mapping[str, Field]) -> tuple[np.ndarray, np.ndarray]:
    """An array of one struct of numbers, as kernels take it, with its fields as attributes, and as NumPy sees it."""
    values = aligned_zeros((1,), struct_dtype(table, FLOATS[dtype]))
    return values.view(np.recarray), values
