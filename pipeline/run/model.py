"""The model in the file of a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.fields import JOINTS, MODEL
from dc_kernels.model.validate.scene import check_joints, check_model


def read_model(file: Any) -> dict[str, np.ndarray]:
    """Read the arrays of the model and its joints from an open trajectory, by name.

    Raises:
        ValueError: naming dataset, place, value and limit: of another type or shape, or a value that no model may have.
        KeyError: for a dataset that is missing.
    """
    real = file["model/mass"].dtype
    if real not in (np.float32, np.float64):
        raise ValueError(f"model/mass is {real}; it must be float32 or float64")
    model, joints = ({name: file[f"model/{name}"] for name in table} for table in (MODEL, JOINTS))
    rows: dict[str, int] = {}
    for arrays, table in ((model, MODEL), (joints, JOINTS)):
        for name, field in table.items():
            dtype, shape = numpy_spec(field, real)
            count = rows.setdefault(field.per, arrays[name].shape[0] if arrays[name].shape else -1)
            if (arrays[name].dtype, arrays[name].shape) != (dtype, (count, *shape)):
                found = f"{arrays[name].dtype} {arrays[name].shape}"
                raise ValueError(f"model/{name} is {found}; it must be {dtype} {(count, *shape)}")
            arrays[name] = arrays[name][...]
    for offsets in [axis for axis in rows if axis.endswith("+1")]:
        axis = offsets.removesuffix("+1")
        if rows[offsets] != rows[axis] + 1:
            raise ValueError(f"model/ has {rows[offsets]} offsets of {rows[axis]} elements of the axis {axis}")
    check_model(model, "model/")
    check_joints(joints, model, "model/")
    return {**model, **joints}
