"""Worlds back to the state that they were built in, or to a given one, while the others keep their bits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model, State, to_numpy
from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import STATE
from dc_kernels.model.room import rows_of
from dc_kernels.model.settings import WrongType, numeric, shown
from dc_kernels.runtime.interop import host_view

EVOLVES = tuple(name for name in STATE if name != "flags")
"""Fields of a state that a world may be reset to."""


EMPTIED = {
    "joints": ("joint_impulse", "joint_broken"),
    "contacts": ("contact_count", "contact_dt"),
    "cache": ("count", "joint_impulse"),
    "pairs": ("count", "valid"),
    "state": ("flags",),
    "sleepers": ("asleep", "rest_time", "sleeping", "dormant", "waited", "count"),
    "overlaps": ("count", "before_count", "begun_count", "ended_count", "part"),
    "switches": ("count",),
    "touches": ("count", "before_count", "begun_count", "ended_count", "hit_count", "part"),
}
"""Fields that are zero before the first step, by group."""


class _Rows(NamedTuple):
    """A field of a group."""

    group: ArrayGroup
    name: str
    array: np.ndarray
    """Its array as numpy: the same memory on the CPU."""
    axis: str
    rows: np.ndarray
    """That, with an axis of worlds where all have as many elements."""


class Reset:
    """Rows of the arrays of a simulation that hold the state, and what its next step starts from."""

    def __init__(self, model: Model, built: State, groups: Mapping[str, ArrayGroup]) -> None:
        """Look at the arrays once: on a CPU a view of one takes longer than its rows.

        Args:
            model: of the simulation.
            built: the state that worlds go back to.
            groups: those of ``EMPTIED`` by name.
        """
        self._start = {axis: model.numpy(f"{axis}_start") for axis in ("body", "joint")}
        self._start["joint row"] = groups["joints"].numpy("joint_row_start")[self._start["joint"]]
        # worlds of one size are rows of an array of worlds
        self._alike = {axis: np.ptp(np.diff(start)) == 0 for axis, start in self._start.items()}
        self._alike["world"] = True
        self._worlds = model.world_count
        state = groups["state"]
        self._copied = [(self._rows(state, name), self._rows(built, name)) for name in EVOLVES]
        # of bodies that have become static after they were built
        static = model.numpy("body_type") == BodyType.STATIC
        moved = built.numpy("velocity").any(axis=1) | (built.numpy("angular_velocity") != 0)
        self._frozen = np.flatnonzero(static & moved)
        self._emptied = [
            self._rows(groups[group], name)
            for group, names in EMPTIED.items()
            for name in names
            if groups[group].sizes.get("world", 1)  # no sleepers where none may sleep, no lists without events
        ]

    def _rows(self, group: ArrayGroup, name: str) -> _Rows:
        array, axis = to_numpy(group.array(name)), group.table[name].per
        rows = array
        if self._alike[axis]:
            rows = array.reshape((self._worlds, len(array) // self._worlds, *array.shape[1:]))
        return _Rows(group, name, array, axis, rows)

    def __call__(self, worlds: np.ndarray | None) -> None:
        """Reset worlds by their indices; None: all."""
        at: dict[str, Any] = dict.fromkeys(self._alike, slice(None) if worlds is None else worlds)
        if worlds is not None:
            at |= {axis: rows_of(start, worlds) for axis, start in self._start.items() if not self._alike[axis]}
        for to, source in self._copied:
            to.rows[at[to.axis]] = source.rows[at[to.axis]]
        for to in self._emptied:
            to.rows[at[to.axis]] = 0
        if len(self._frozen):
            for to, _ in self._copied:
                if to.name in ("velocity", "angular_velocity"):
                    to.array[self._frozen] = 0
        for to in (*(to for to, _ in self._copied), *self._emptied):
            if to.group.device != "cpu":
                to.group.fill(to.name, to.array)


def check_rows(model: Model, worlds: np.ndarray | None, state: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Values of a state for some worlds: name of the field, rows of it, and what they are to hold.

    Args:
        model: of the simulation.
        worlds: their indices, (k,); None: all.
        state: a ``State``, whose rows of these worlds are taken; or values by name of a field, for these worlds in this
            order: (rows, ...), or (k, n, ...) where each has n.

    Raises:
        TypeError, ValueError: naming field, index and limit.
    """
    rows = {}
    for axis in ("body", "world"):
        start = model.numpy("body_start") if axis == "body" else np.arange(model.world_count + 1)
        rows[axis] = np.arange(start[-1]) if worlds is None else rows_of(start, worlds)
    if isinstance(state, State):
        for axis in rows:
            if state.sizes[axis] != model.sizes[axis]:
                raise ValueError(
                    f"state has {state.sizes[axis]} on axis {axis!r}; it must be the model's {model.sizes[axis]}"
                )
        values = {name: state.numpy(name)[rows[STATE[name].per]] for name in EVOLVES}
    elif isinstance(state, Mapping):
        values = dict(state)
    else:
        raise WrongType(f"state is {shown(state)}; it must be a State, or values by name of a field")
    found = []
    for name, given in values.items():
        if name not in EVOLVES:
            raise ValueError(f"state has {name!r}; it may have {', '.join(EVOLVES)}")
        scalar, inner = numpy_spec(STATE[name], model.dtype)
        chosen = rows[STATE[name].per]
        array = numeric(f"state[{name!r}]", host_view(f"state[{name!r}]", given), "numbers", "buif")
        count = model.world_count if worlds is None else len(worlds)
        flat, alike = (len(chosen), *inner), (count, len(chosen) // max(count, 1), *inner)
        if count * alike[1] != len(chosen):
            alike = flat
        if not count and array.shape[:1] == (0,):
            array = np.zeros(flat)  # of no world, however many bodies each would have
        if array.shape not in (flat, alike):
            either = " or ".join(str(shape) for shape in dict.fromkeys((flat, alike)))
            raise ValueError(f"state[{name!r}] has shape {array.shape}; it must be {either}")
        array = array.reshape(flat)
        found.append((name, chosen, check_values(f"state[{name!r}]", array, flat, scalar)))
    return found


def write_rows(state: State, rows: list[tuple[str, np.ndarray, np.ndarray]]) -> None:
    """Write values that ``check_rows`` has passed."""
    for name, chosen, values in rows:
        array = to_numpy(state.array(name))
        array[chosen] = values
        if state.device != "cpu":
            state.fill(name, array)
