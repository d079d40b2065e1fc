"""The layout of data sets on disk: HDF5 shards of whole worlds, and an index that shows them as one.

A folder holds ``shard-00000.h5``, ``shard-00001.h5``, ... and, once all are there, ``index.h5``. The unit of data is a
*state*: one world at one step, its bodies before the step and the contacts of the step. Arrays are flat: worlds one
after the other, the steps of a world one after the other, the bodies or contacts of a step one after the other.

=============  ====================================================================================================
axis           rows
=============  ====================================================================================================
world          one for each world; its rows in ``body``, ``shape`` and ``step`` are ``world/body_start[w]`` up to
               ``world/body_start[w + 1]``, and so on
drawn          one for each world, with ranges only: what was drawn for it from its own seed
body, shape    what does not change; indices of bodies count from the world's first one
vertex         of shape k: ``shape/vertex_start[k]`` up to ``shape/vertex_start[k + 1]``
step           one for each state; its rows in ``motion`` and ``contact`` are ``step/motion_start[s]`` up to
               ``step/motion_start[s + 1]``, and ``step/contact_start[s]`` up to ``step/contact_start[s + 1]``
motion         one for each body at each step: where it is before the step
contact        one for each contact at each step, sorted by key
grid           one for each state, with ``grids``: what ``dc.Images`` shows of it
=============  ====================================================================================================

``contact/impulse`` is (3, contacts, 2): the start of the solve (the impulse of the step before, 0 where ``age`` is 0),
what it ended with at the run's tolerance, and the label, solved on from there to the label's tolerance. The three
stand in one dataset because a start repeats the solution of the step before: compression then stores it once.

Every dataset has ``unit`` and ``meaning``, gzip, shuffle and a Fletcher checksum. Attributes of a file: ``schema``
(``deep-contact.dataset``), ``version`` (1), ``kind`` (shard or index), ``config`` and ``versions`` (JSON), ``seed`` of
the first world, ``worlds``, ``steps``, ``flags`` (all ``step/flags`` or-ed), ``label_reached`` (share of the states).
In the index ``*_start`` count through all shards and the other datasets are virtual: they show those of the shards,
whose names are in ``shard/name``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.fields import CONTACTS, MODEL, STATE, Field

SCHEMA = "deep-contact.dataset"
VERSION = 1
INDEX = "index.h5"
STAGES = ("start", "impulse", "label")
"""What ``contact/impulse`` holds along its first axis."""
_FLOAT32 = np.dtype(np.float32)


class DatasetSpec(NamedTuple):
    """What a dataset holds: its shape is (*lead, rows, *shape)."""

    dtype: np.dtype
    """Type of the values."""
    unit: str
    """SI unit of the values."""
    meaning: str
    """What the values are, in words."""
    shape: tuple[int, ...] = ()
    """Shape of a row."""
    lead: tuple[int, ...] = ()
    """Axes before that of the rows."""


def _field_spec(field: Field, dtype: Any = None) -> DatasetSpec:
    """Make the spec of a field of float32 arrays, of another dtype if given."""
    found, shape = numpy_spec(field, _FLOAT32)
    return DatasetSpec(np.dtype(dtype or found), field.unit, field.meaning, shape)


def _field_specs(table: Mapping[str, Field], *names: str) -> dict[str, DatasetSpec]:
    """Make the specs of some fields of a table, by name."""
    return {name: _field_spec(table[name]) for name in names}


def spec_of(
    dtype: Any, unit: str, meaning: str, shape: tuple[int, ...] = (), lead: tuple[int, ...] = ()
) -> DatasetSpec:
    """Make a spec of a dtype by name."""
    return DatasetSpec(np.dtype(dtype), unit, meaning, shape, lead)


LAYOUT: dict[str, dict[str, DatasetSpec]] = {
    "world": {
        "seed": spec_of("int64", "1", "the world is the scene's world of this seed"),
        "dt": spec_of("float32", "s", "time step"),
        **_field_specs(MODEL, "gravity", "origin", "length_scale"),
        "body_start": spec_of("int64", "1", "first row of each world in body"),
        "shape_start": spec_of("int64", "1", "first row of each world in shape"),
        "step_start": spec_of("int64", "1", "first row of each world in step"),
    },
    "body": _field_specs(MODEL, "body_type", "mass", "inertia"),
    "shape": {
        "shape_body": spec_of("int32", "1", "body of the shape, from the world's first"),
        **_field_specs(MODEL, "shape_type", "shape_radius", "shape_friction", "shape_restitution"),
        "vertex_start": spec_of("int64", "1", "first row of each shape in vertex"),
    },
    "vertex": _field_specs(MODEL, "vertices"),
    "step": {
        "step": spec_of("int32", "1", "steps before this one"),
        "motion_start": spec_of("int64", "1", "first row of each state in motion"),
        "contact_start": spec_of("int64", "1", "first row of each state in contact"),
        "sweeps": spec_of("int32", "1", "sweeps of the solve to the run's tolerance"),
        "change": spec_of("float32", "N s", "largest impulse change of its last sweep"),
        "residual": spec_of("float32", "1", "relative natural map at its end"),
        "label_sweeps": spec_of("int32", "1", "further sweeps to the label"),
        "label_change": spec_of("float32", "N s", "largest impulse change of the last of them"),
        "label_residual": spec_of("float32", "1", "relative natural map of the label"),
        "label_reached": spec_of("uint8", "1", "1 where the label's tolerance was reached"),
        "flags": spec_of("int32", "1", "dc_kernels.Flag bits after the step: not 0, then the state is not valid"),
    },
    "motion": _field_specs(STATE, "position", "angle", "velocity", "angular_velocity"),
    "contact": {
        **_field_specs(CONTACTS, "key"),
        "body_a": spec_of("int32", "1", "body A, from the world's first"),
        "body_b": spec_of("int32", "1", "body B, from the world's first"),
        "point": spec_of("float32", "m", "place of the contact, relative to the world's origin", (2,)),
        **_field_specs(CONTACTS, "normal", "gap", "friction", "restitution", "age"),
        "color": _field_spec(CONTACTS["color"], "uint8"),
        "impulse": spec_of(
            "float32",
            "N s",
            "start, solution at the run's tolerance, label; of each normal and tangential impulse",
            (2,),
            (len(STAGES),),
        ),
    },
}
"""Datasets of each axis, which is a group of the file, by name."""
STARTS = {
    "world/body_start": "body",
    "world/shape_start": "shape",
    "world/step_start": "step",
    "shape/vertex_start": "vertex",
    "step/motion_start": "motion",
    "step/contact_start": "contact",
}
"""Datasets of n + 1 offsets, and the axis of whose rows they tell."""


def shard_path(folder: Path, number: int) -> Path:
    """Return the path of a shard in the folder of its data set."""
    return folder / f"shard-{number:05d}.h5"


def described() -> dict[str, DatasetSpec]:
    """Return the specs of all datasets of ``LAYOUT`` by their path in the file."""
    return {f"{axis}/{name}": column for axis, columns in LAYOUT.items() for name, column in columns.items()}


def offsets(sizes: np.ndarray) -> np.ndarray:
    """Return where each of some parts begins, and where the last one ends, (parts + 1,) int64."""
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
