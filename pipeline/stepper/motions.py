"""Recorded motions: whole worlds of a data set, from the first state to the one after the last step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.hdf5 import dataset
from pipeline.data.dataset import Split, States
from pipeline.data.folders import Paths
from pipeline.data.layout import MOTION, described

SPECS = described()


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Where the bodies of a world are at each of its T states, the last one after its last step."""

    seed: int
    """Of the world."""
    dt: float
    """Time from one state to the next [s]."""
    mass: np.ndarray
    """Of the bodies, (N,) [kg]."""
    arrays: dict[str, np.ndarray]
    """Fields of ``MOTION`` by name, (T, N, ...)."""
    busy: np.ndarray
    """Times of states with contacts, but for the last state, (n,) int64."""

    @property
    def states(self) -> int:
        """Number of states, T, up to the first step that the world did not make."""
        return len(self.arrays["position"])


def read_motions(path: Paths, split: Split, validation: float, seed: int) -> list[Motion]:
    """Read the motions of the worlds of a split.

    Args:
        path: folder of the data set, or several.
        split: of ``data.dataset.States``.
        validation: share of the worlds that validate.
        seed: of the draw of these worlds.

    Raises:
        ValueError, OSError: see ``States``; or values out of range, naming the dataset.
    """
    states = States(path, split, validation=validation, split_seed=seed, min_contacts=0)
    found, first = [], states.folders.first_world
    for number in range(len(states.folders.parts)):
        own = states.worlds[(states.worlds >= first[number]) & (states.worlds < first[number + 1])]
        if len(own):
            with states.folders.shard(number) as file:
                found += [_read(file, int(world - first[number])) for world in own]
    return found


def _read(file: Any, row: int) -> Motion:
    """Read a world of an open shard that is checked.

    Raises:
        ValueError: naming the dataset: states of other bodies than the world has, or values of a state out of range.
    """

    def part(name: str, first: int, last: int) -> np.ndarray:
        return dataset(file, name)[first:last]

    body, step = (tuple(int(n) for n in part(f"world/{name}_start", row, row + 2)) for name in ("body", "step"))
    motion = part("step/motion_start", step[0], step[1] + 1)
    count = body[1] - body[0]
    if (np.diff(motion) != count).any():
        raise ValueError(f"step/motion_start must rise by the {count} bodies of world {row} with each of its states")
    stopped = np.flatnonzero(part("step/flags", *step))
    states = int(stopped[0]) + 1 if len(stopped) else step[1] - step[0] + 1
    arrays = {}
    for name in MOTION:
        before = part(f"motion/{name}", int(motion[0]), int(motion[-1]))
        ends = part(f"end/{name}", *body)
        values = np.concatenate([before, ends]).reshape(step[1] - step[0] + 1, count, *ends.shape[1:])[:states]
        rule = SPECS[f"motion/{name}"].rule
        if rule is not None:
            check_rule(f"motion/{name}", values, rule)
        arrays[name] = values
    seed, dt = part("world/seed", row, row + 1)[0], part("world/dt", row, row + 1)
    check_rule("world/dt", dt, SPECS["world/dt"].rule)  # type: ignore[arg-type]
    busy = np.flatnonzero(np.diff(part("step/contact_start", step[0], step[1] + 1))[: states - 1])
    return Motion(seed=int(seed), dt=float(dt[0]), mass=part("body/mass", *body), arrays=arrays, busy=busy)
