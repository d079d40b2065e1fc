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
motion         one for each body at each step: where it is before the step, and how far overlap is undone in it
contact        one for each contact at each step, sorted by key
end            one for each body, as in ``body``: where it is after the world's last step
grid           one for each state, with ``grids``: what ``dc.Images`` shows of it
=============  ====================================================================================================

``contact/impulse`` is (3, contacts, 2): the start of the solve (the impulse of the step before, 0 where ``age`` is 0),
what it ended with at the run's tolerance, and the label, solved on from there to the label's tolerance. The three
stand in one dataset because a start repeats the solution of the step before: compression then stores it once. The law
that they satisfy is the attribute ``law`` of this dataset (``LAW``); ``MOTION_LAW``, at ``motion/position``, says how a
state follows from the one before.

Every dataset has ``unit`` and ``meaning``, shuffle, zstd (or gzip, as in the index) and a Fletcher checksum; one of
codes has ``codes``, JSON of their values by name; one of images has ``channels`` and ``units``. Attributes of a file:
``schema`` (``deep-contact.dataset``), ``version`` (2), ``kind`` (shard or index), ``config`` and ``versions`` (JSON),
``seed`` of the first world, ``worlds``, ``steps``, ``flags`` (all ``step/flags`` or-ed), ``label_reached`` (share of
the states). In the index ``*_start`` count through all shards and the other datasets are virtual: they show those of
the shards, whose names are in ``shard/name``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import CONTACTS, MODEL, STATE, Field
from dc_kernels.model.rules import FINITE, NOT_NEGATIVE, POSITIVE, Code, Number, Unit

SCHEMA = "deep-contact.dataset"
VERSION = 2
INDEX = "index.h5"
STAGES = ("start", "impulse", "label")
"""What ``contact/impulse`` holds along its first axis."""
MOTION = ("position", "angle", "velocity", "angular_velocity")
"""Fields of a state that say where its bodies are and how they move."""
LAW = """
An impulse p = r_n n + r_t t acts on body B at the contact's point, and -p on body A; n is the normal, from A to B, and
t = (n_y, -n_x). u = (u_n, u_t) is the velocity of B against A at the point, along n and t, with all impulses of the
state applied to velocity + dt gravity (of dynamic bodies; others keep theirs) and angular_velocity before the step:
  0 <= r_n,  0 <= u_n + bias,  r_n (u_n + bias) = 0      (Signorini)
  |r_t| <= friction r_n,  and r_t = -friction r_n u_t / |u_t| where u_t is not 0      (Coulomb)
The label solves this to label_tolerance where step/label_reached is 1, the impulse to the solver's tolerance.
""".strip()
"""The law of contact/impulse, in words and formulas."""
BIAS_LAW = """
gap / dt where gap > world/slop, as the gap may close within the step; else 0. Where the contact's restitution e is not
0, with w the normal speed before the step, of the velocities in motion:
  max(bias, e w) if w > 0;  min(bias, e w) if w < -world/restitution_threshold, or w < 0 if e is 1;
  1e6 gap / dt, so that it does not act, if gap > world/slop and the speeds with gravity applied leave the gap open.
With position_correction "baumgarte", where gap < -slop, not 0 but
  max(position_factor (gap + slop), -max_correction length_scale) / dt.
""".strip()
"""Where contact/bias comes from."""
MOTION_LAW = """
With velocity and angular_velocity those of the next state (of end, after the last step), which are those that the
impulses (contact/impulse[1]) leave:
  position of the next state = position + dt velocity + position_correction
  angle of the next state = angle + dt angular_velocity + angle_correction
A state whose step/flags is not 0 did not advance.
""".strip()
"""How a state follows from the one before."""
_FLOAT32 = np.dtype(np.float32)


Rule = Number | Code | Unit | None


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
    notes: Mapping[str, Any] = {}
    """Attributes of the dataset beside unit and meaning."""
    rule: Rule = None
    """What values of valid states satisfy."""


CODES: dict[str, type[IntEnum] | type[IntFlag]] = {"body_type": BodyType, "shape_type": ShapeType, "flags": Flag}
"""Enumerations of the fields that hold their values, by name of the field."""


def codes(name: str) -> dict[str, str]:
    """Make the attribute ``codes`` of a field that holds values of an enumeration: JSON of values by name."""
    return {"codes": json.dumps({member: int(value) for member, value in CODES[name].__members__.items()})}


def _field_spec(field: Field, dtype: Any = None) -> DatasetSpec:
    """Make the spec of a field of float32 arrays, of another dtype if given."""
    found, shape = numpy_spec(field, _FLOAT32)
    rule = field.rule if isinstance(field.rule, Number | Code | Unit) else None  # others are of a simulation's axes
    if field.name in CODES:
        meaning = f"{' '.join(str(CODES[field.name].__doc__).split()).rstrip('.')}; see codes"
        return DatasetSpec(np.dtype(dtype or found), field.unit, meaning, shape, notes=codes(field.name), rule=rule)
    return DatasetSpec(np.dtype(dtype or found), field.unit, field.meaning, shape, rule=rule)


def _field_specs(table: Mapping[str, Field], *names: str) -> dict[str, DatasetSpec]:
    """Make the specs of some fields of a table, by name."""
    return {name: _field_spec(table[name]) for name in names}


def spec_of(dtype: Any, unit: str, meaning: str, shape: tuple[int, ...] = (), **more: Any) -> DatasetSpec:
    """Make a spec of a dtype by name; ``more`` are ``lead``, ``notes`` and ``rule``."""
    return DatasetSpec(np.dtype(dtype), unit, meaning, shape, **more)


LAYOUT: dict[str, dict[str, DatasetSpec]] = {
    "world": {
        "seed": spec_of("int64", "1", "the world is the scene's world of this seed"),
        "dt": spec_of("float32", "s", "time step", rule=POSITIVE),
        **_field_specs(MODEL, "gravity", "origin", "length_scale"),
        "slop": spec_of("float32", "m", "overlap that is left alone, and gap that counts as closed", rule=NOT_NEGATIVE),
        "restitution_threshold": spec_of(
            "float32", "m/s", "approach speed below which what is not elastic does not bounce", rule=NOT_NEGATIVE
        ),
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
        "flags": spec_of(
            "int32", "1", "bits of codes after the step: not 0, then the state is not valid", notes=codes("flags")
        ),
    },
    "motion": {
        **_field_specs(STATE, *MOTION),
        "position": _field_spec(STATE["position"])._replace(notes={"law": MOTION_LAW}),
        "position_correction": spec_of(
            "float32",
            "m",
            "what the position phase, and stops of solver.continuous, move the body by in the step",
            (2,),
            rule=FINITE,
        ),
        "angle_correction": spec_of(
            "float32",
            "rad",
            "what the position phase, and stops of solver.continuous, turn the body by in the step",
            rule=FINITE,
        ),
    },
    "end": _field_specs(STATE, *MOTION),
    "contact": {
        **_field_specs(CONTACTS, "key"),
        "body_a": spec_of("int32", "1", "body A, from the world's first"),
        "body_b": spec_of("int32", "1", "body B, from the world's first"),
        "point": spec_of("float32", "m", "place of the contact, relative to the world's origin", (2,), rule=FINITE),
        **_field_specs(CONTACTS, "normal", "gap", "friction", "restitution", "age"),
        "color": _field_spec(CONTACTS["color"], "uint8"),
        "bias": spec_of(
            "float32", "m/s", "added to the normal velocity in the law of impulse", notes={"law": BIAS_LAW}, rule=FINITE
        ),
        "impulse": spec_of(
            "float32",
            "N s",
            "start, solution at the run's tolerance, label; of each normal and tangential impulse",
            (2,),
            lead=(len(STAGES),),
            notes={"stages": STAGES, "law": LAW},
            rule=FINITE,
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
