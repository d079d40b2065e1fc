"""What the stability scenes share: the simulation, drift over a run, what fell, mechanical energy.

Scenes run in float32 with the default settings and dt = 0.01 s unless their docstring says otherwise, and why.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import pose
from bench.cases import DT
from bench.verdicts import Check
from dc_kernels import measure

EXACT: dict[str, Any] = {"dtype": "float64", "tolerance": 1e-8, "max_sweeps": 5000}
"""For tall structures, whose slowest modes sum up what single contacts leave unsolved."""


def simulate(builder: dc.ModelBuilder, dtype: str = "float32", **settings: Any) -> dc.Simulation:
    """A simulation on one thread; ``settings``: of ``SolverConfig``."""
    return dc.Simulation(*builder.finalize(dtype), config=dc.SolverConfig(**settings))


def named(settings: dict[str, Any]) -> str:
    """Settings for a criterion."""
    return ", ".join(f"{name} {value}" for name, value in settings.items()) or "default settings"


def watch(
    sim: dc.Simulation, seconds: float, read: Callable[[dc.Simulation], Any], *, dt: float = DT, every: float = 0.1
) -> np.ndarray:
    """What ``read`` gives every so many seconds of a run, (samples, ...)."""
    steps = max(round(every / dt), 1)
    values = []
    for _ in range(max(round(seconds / (steps * dt)), 1)):
        sim.run(steps, dt)
        values.append(np.array(read(sim), float))
    return np.array(values)


def drift(sim: dc.Simulation, seconds: float, *, dt: float = DT) -> np.ndarray:
    """Largest move of any body from where it began, horizontally and vertically, over a run (2,) [m]."""
    start = pose(sim)[:, :2]
    return np.asarray(watch(sim, seconds, lambda s: np.abs(pose(s)[:, :2] - start).max(axis=0), dt=dt).max(axis=0))


def energy(sim: dc.Simulation) -> float:
    """Kinetic and potential energy of all worlds [J]."""
    return float((measure.kinetic_energy(sim) + measure.potential_energy(sim)).sum())


def carried(sim: dc.Simulation) -> np.ndarray:
    """Sum of the normal impulses from below, of each body as body B (bodies,) [N s]."""
    slots, _ = measure.contact_slots(sim.contacts)
    impulse = sim.contacts.numpy("impulse")[slots, 0].astype(float)
    return np.bincount(sim.contacts.numpy("body_b")[slots], impulse, sim.model.body_count)


def speed(sim: dc.Simulation) -> float:
    """Largest speed of a body [m/s]; inf where something is not finite."""
    velocity = velocities(sim)
    return float(np.hypot(velocity[:, 0], velocity[:, 1]).max()) if np.isfinite(velocity).all() else np.inf


def velocities(sim: dc.Simulation) -> np.ndarray:
    """Velocities of the dynamic bodies, (n, 2)."""
    return np.asarray(sim.state.numpy("velocity")[sim.model.numpy("body_type") == dc.BodyType.DYNAMIC], float)


def depth(sim: dc.Simulation) -> float:
    """Deepest overlap of any two shapes as they lie now [m]."""
    return float(measure.overlap(sim, recollide=DT).max.max())


def finite(sim: dc.Simulation) -> Check:
    """Whether no world stopped and every number is one."""
    bad = int((sim.state.numpy("flags") != 0).sum())
    for name in ("position", "angle", "velocity", "angular_velocity"):
        bad += int((~np.isfinite(sim.state.numpy(name))).sum())
    return Check("worlds stopped and numbers not finite", float(bad), 0.0, sim)
