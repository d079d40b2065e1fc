"""Copies of a simulation, which go on with its bits: by ``clone``, ``copy`` or ``pickle``, between steps or within one.

A copy takes everything over, also what a step leaves in its rows and pairs, so that a step in flight, or a solve that
is paused, goes on as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dc_kernels.driving.ids import Ids
from dc_kernels.model.arrays import ArrayGroup, Model, State
from dc_kernels.model.joints.groups import Joints
from dc_kernels.stages import Phase

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation


class Parts(NamedTuple):
    """What a simulation consists of."""

    model: Model
    state: State
    joints: Joints
    groups: dict[str, ArrayGroup]
    """What its stages hold, by name."""
    slots: dict[str, np.ndarray]
    """Room of each world for pairs, contacts and blocks, (W,) each."""
    built: State
    """What ``reset`` goes back to."""
    options: dict[str, Any]
    """Arguments of the constructor by name."""
    phase: Phase
    """Part of a step that was called last."""
    peak: np.ndarray
    """The most that a world used of each kind of room."""
    ids: Ids | None
    """Ids of bodies, shapes and joints, where they are not their indices."""


def parts_of(sim: Simulation) -> Parts:
    """Return the parts of a simulation themselves; to copy or to pickle them makes a copy of it."""
    options = {
        "config": sim.config,
        "threads": sim.most_threads,
        "schedule": sim.schedule,
        "on_overflow": sim.on_overflow,
        "specialize": sim.specialize,
    }
    storage = sim.storage
    return Parts(
        sim.model,
        sim.state,
        sim.joints,
        storage.groups(),
        storage.reserved(),
        sim.built,
        options,
        sim.phase,
        sim.peak,
        sim.given_ids,
    )


def from_parts(make: Callable[..., Simulation], parts: Parts) -> Simulation:
    """Make a simulation that consists of given parts, which no other one has.

    Args:
        make: the class ``Simulation``, or what makes one of the constructor's arguments.
        parts: copies of those of another simulation.
    """
    state, kept = parts.state, None
    if state.numpy("flags").any():  # the constructor would refuse what froze a world
        kept = state.copy()
        for name in state.table:
            state.fill(name, np.zeros_like(kept.numpy(name)))
    sim = make(parts.model, state, parts.joints, pairs_per_shape=0.0, contacts_per_body=0.0, **parts.options)
    if kept is not None:
        for name in state.table:
            state.fill(name, kept.numpy(name))
    sim.adopt(parts)
    return sim
