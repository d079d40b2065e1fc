"""Energy, momentum and overlap of each world, in float64 numpy.

All functions take any object with the attributes ``model`` and ``state`` (``overlap`` also ``contacts``).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.room import used_slots, world_of
from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.inputs import check_positive, check_simulation


class Momentum(NamedTuple):
    """Momentum of each world's dynamic bodies."""

    linear: np.ndarray  # (W, 2) [N s]
    angular: np.ndarray  # (W,) [N m s], about the world's origin


class Overlap(NamedTuple):
    """Overlaps of each world's contacts; 0 without contacts."""

    mean: np.ndarray  # (W,) [m]
    max: np.ndarray  # (W,) [m]


def kinetic_energy(sim: Any) -> np.ndarray:
    """Return the kinetic energy of each world's dynamic bodies, including rotation, (W,) [J]."""
    check_simulation("sim", sim, ("model", "state"))
    mass, inertia, velocity, spin = _motion(sim)
    return _per_world(sim, (mass * (velocity * velocity).sum(axis=1) + inertia * spin**2) / 2)


def potential_energy(sim: Any) -> np.ndarray:
    """Return the potential energy of each world's dynamic bodies in its gravity, 0 at the world's origin, (W,) [J]."""
    check_simulation("sim", sim, ("model", "state"))
    gravity = _float64(sim.model, "gravity")[_worlds(sim)]
    return _per_world(sim, -_float64(sim.model, "mass") * (gravity * _float64(sim.state, "position")).sum(axis=1))


def momentum(sim: Any) -> Momentum:
    """Return linear momentum, and angular momentum about the world's origin, of each world's dynamic bodies."""
    check_simulation("sim", sim, ("model", "state"))
    mass, inertia, velocity, spin = _motion(sim)
    linear = mass[:, None] * velocity
    position = _float64(sim.state, "position")
    angular = position[:, 0] * linear[:, 1] - position[:, 1] * linear[:, 0] + inertia * spin
    return Momentum(np.stack([_per_world(sim, linear[:, k]) for k in (0, 1)], axis=1), _per_world(sim, angular))


def overlap(sim: Any, recollide: float | None = None) -> Overlap:
    """Return the overlaps of surfaces, over the contacts that have an impulse or overlap.

    A contact counts if its normal impulse is not zero or its gap is negative; a contact that only touches, or closes
    within the step, counts with overlap 0. Inactive contacts do not count.

    Args:
        sim: the simulation.
        recollide: time step [s] of a preceding call of ``sim.collide``, which finds the contacts of the present
            positions (their impulses are then the start of the next solve) without changing the state. None:
            the gaps are those at the beginning of the last step.
    """
    check_simulation("sim", sim, ("contacts",))
    if recollide is not None:
        sim.collide(check_positive("recollide", recollide))
    slots, world = contact_slots(sim.contacts)
    acting = ~are_off(sim.contacts, slots)
    slots, world = slots[acting], world[acting]
    gap = _float64(sim.contacts, "gap")[slots]
    counts = (gap < 0) | (sim.contacts.numpy("impulse")[slots, 0] != 0)
    depth, world = np.maximum(-gap, 0.0)[counts], world[counts]
    worlds = sim.model.world_count
    number = np.bincount(world, minlength=worlds)
    largest = np.zeros(worlds)
    np.maximum.at(largest, world, depth)
    return Overlap(np.bincount(world, depth, worlds) / np.maximum(number, 1), largest)


def contact_slots(contacts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the slots in use, world after world, and the world of each: two arrays (n,) of integers.

    Raises:
        TypeError: ``contacts`` are not those of a simulation.
    """
    if isinstance(contacts, type) or not hasattr(contacts, "contact_count"):
        raise WrongType(f"contacts is {shown(contacts)}; it must be the contacts of a Simulation")
    count = contacts.numpy("contact_count")
    return used_slots(contacts.numpy("contact_start"), count), np.repeat(np.arange(len(count)), count)


def are_off(contacts: Any, slots: np.ndarray) -> np.ndarray:
    """Return which contacts were inactive in the last step (``collide/switches.py``), without colour and impulse."""
    return np.asarray((contacts.numpy("color")[slots] < 0) & (contacts.numpy("impulse")[slots, 0] == 0))


def _float64(group: Any, name: str) -> np.ndarray:
    return group.numpy(name).astype(np.float64)


def _motion(sim: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return (
        _float64(sim.model, "mass"),
        _float64(sim.model, "inertia"),
        _float64(sim.state, "velocity"),
        _float64(sim.state, "angular_velocity"),
    )


def _worlds(sim: Any) -> np.ndarray:
    """Return the world of each body."""
    return world_of(sim.model.numpy("body_start"))


def _per_world(sim: Any, values: np.ndarray) -> np.ndarray:
    return np.bincount(_worlds(sim), values, sim.model.world_count)
