"""Worlds of a data set as a simulation, put to any of their recorded states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import dc_kernels as dc
from pipeline.data.layout import MOTION
from pipeline.data.recipe import parse_recipe
from pipeline.data.recorder import build_worlds
from pipeline.stepper.motions import Motion


class Replay:
    """Some recorded worlds in one simulation.

    Attributes:
        motions: of the worlds, in the order of the simulation's.
        sim: the simulation, of the data set's scene and solver.
    """

    def __init__(self, motions: Sequence[Motion], config: Mapping[str, Any]) -> None:
        """Build the worlds.

        Args:
            motions: of the worlds.
            config: of the data set.

        Raises:
            ValueError: the scene does not build the bodies that the data set holds.
        """
        self.motions = list(motions)
        recipe = parse_recipe(config)
        builder, _, _ = build_worlds(recipe, [motion.seed for motion in motions])
        self.sim = dc.Simulation(*builder.finalize("float32"), config=replace(recipe.solver, history=False))
        mass = np.concatenate([motion.mass for motion in motions])
        if not np.array_equal(mass, self.sim.model.numpy("mass")):
            raise ValueError(
                f"the scene {recipe.scene.name} builds other bodies for seed {motions[0].seed} than the data set holds"
            )
        self.dt = np.array([motion.dt for motion in motions])

    def shortest(self) -> int:
        """Return the number of states of the world that has the fewest."""
        return min(motion.states for motion in self.motions)

    def place(self, times: np.ndarray) -> None:
        """Put each world to the state of a time, counted in recorded steps, (W,)."""
        self.sim.state.numpy("flags")[...] = 0
        for name in MOTION:
            self.sim.state.numpy(name)[...] = self.at(name, times)

    def at(self, name: str, times: np.ndarray) -> np.ndarray:
        """Return a recorded field of all bodies, each world's of its own time, (N, ...)."""
        return np.concatenate([motion.arrays[name][t] for motion, t in zip(self.motions, times)])

    def velocities(self, times: np.ndarray) -> np.ndarray:
        """Return recorded velocities and spins of all bodies, (N, 3) [m/s, rad/s]."""
        return np.concatenate([self.at("velocity", times), self.at("angular_velocity", times)[:, None]], axis=1)
