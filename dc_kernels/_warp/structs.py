"""Groups of arrays and numbers as Warp structs, made from tables of fields: one argument of a kernel for many."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp

from dc_kernels.model.arrays import FLOATS, kernel_array, kernel_vectors, numpy_spec, warp_dtype
from dc_kernels.model.fields import Field
from dc_kernels.runtime.building import building

_made: dict[tuple[str, str, int], Any] = {}  # structs by name, scalar type and table, which are constants


def struct_type(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    """Return the struct of a table's fields: a number where ``per`` is "launch", else an array.

    Args:
        name: of the struct.
        dtype: "float32" or "float64": what "real" is.
        table: fields by name.
    """
    key = (name, dtype, id(table))
    if key not in _made:
        with building():
            if key not in _made:
                _made[key] = _make(name, dtype, table)
    return _made[key]


def _make(name: str, dtype: str, table: Mapping[str, Field]) -> Any:
    annotations = {}
    for field in table.values():
        element = warp_dtype(field, FLOATS[dtype])
        axes = len(field.per.split(","))
        annotations[field.name] = element if field.per == "launch" else wp.array(dtype=element, ndim=axes)
    # in a module of its own, so that all kernels share one type
    module = wp.get_module(f"dc_kernels.structs.{dtype}")
    return wp.struct(type(name, (), {"__annotations__": annotations, "__module__": __name__}), module=module)


def group(name: str, dtype: str, table: Mapping[str, Field], values: Mapping[str, Any]) -> Any:
    """Return a struct that holds values by name, which it keeps alive; what is left out is 0 or no array.

    Args:
        name: of the struct.
        dtype: "float32" or "float64".
        table: its fields.
        values: numbers, numpy arrays, which are used where they lie, or ``wp.array``.
    """
    struct = struct_type(name, dtype, table)()
    for key, value in values.items():
        if isinstance(value, np.ndarray):
            inner = numpy_spec(table[key], FLOATS[dtype])[1]
            value = kernel_vectors(value, "warp") if inner else kernel_array(value, "warp")
        setattr(struct, key, value)
    return struct
