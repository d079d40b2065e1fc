"""Simulations in the middle of a solve."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.in_flight import SolveReader
from pipeline.options import RunOptions
from pipeline.scenes import Scene, Thesis

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

DT = 0.01


def simulation(scene: Scene, dtype: str = "float64", worlds: int = 3, run: dict | None = None, **config) -> Any:
    options = RunOptions(worlds=worlds, seed=3, dtype=dtype, **(run or {}))
    return options.simulation(scene, dc.SolverConfig.preset("accurate", **config))


def colliding(scene: Scene | None = None, dtype: str = "float64", steps: int = 100, **options) -> dc.Simulation:
    """Worlds in which things have fallen onto each other, their solve begun."""
    sim = simulation(scene or Thesis(bodies=30), dtype, **options)
    sim.run(steps, DT)
    sim.collide(DT)
    sim.solve(pause=0)
    return sim


def grid_over(sim: dc.Simulation, spacing: float = 1.0) -> dc.Grid:
    position = sim.state.numpy("position").astype(float)
    return dc.Grid.from_box(position.min(axis=0) - spacing, position.max(axis=0) + 2.0 * spacing, spacing)


def reader_of(sim: dc.Simulation, **options) -> SolveReader:
    return SolveReader(sim, grid_over(sim), **options)


def contact_slots(reader: SolveReader) -> np.ndarray:
    """Slots of the contacts last read, in the order of ``local``."""
    first, worlds = reader.sim.contacts.numpy("contact_start"), reader.active[: reader.asked]
    counts = np.diff(reader.packed_start[: reader.asked + 1])
    return np.concatenate([first[w] + np.arange(n) for w, n in zip(worlds, counts)])
