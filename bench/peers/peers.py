"""The thesis worlds in two other engines, pymunk (Chipmunk) and pybox2d (Box2D 2.3), and the overlap a pile ends with.

Both get the bodies, walls and materials of our own scene and take the same number of steps of the same length, and
both keep their warm start and never sleep, so that each step of every engine solves the whole pile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import dc_kernels as dc
from pipeline import scenes

TOUCHING = 1e-3  # [m]: a thousandth of the thesis discs' diameter


@dataclass(frozen=True)
class DiscWorld:
    """Discs among fixed wall segments: all that the peers have to know of a thesis world.

    ``positions`` (n, 2) m, ``radii`` (n,) m, ``walls`` (m, 2, 2) m: the two ends of each segment.
    """

    positions: np.ndarray
    radii: np.ndarray
    walls: np.ndarray
    gravity: tuple[float, float] = (0.0, -9.8)
    density: float = 1.0
    friction: float = 0.5

    def builder(self) -> dc.ModelBuilder:
        """The world as ours: body 0 is the ground, body i + 1 is disc i."""
        builder = dc.ModelBuilder()
        builder.add_world(gravity=self.gravity)
        ground = builder.add_body(type=dc.BodyType.STATIC)
        for wall in self.walls:
            builder.add_chain(ground, wall, friction=self.friction)
        builder.add_discs(self.positions, self.radii, density=self.density, friction=self.friction)
        return builder


Runner = Callable[[DiscWorld, int, float], np.ndarray]
"""Build a world, take a number of steps of dt [s], return the final positions (n, 2) [m]."""


def run_pymunk(world: DiscWorld, steps: int, dt: float, iterations: int) -> np.ndarray:
    """One world in pymunk (see ``scenes.to_pymunk``)."""
    space, bodies = scenes.to_pymunk(world.builder())
    space.iterations = iterations  # sleep_time_threshold stays infinite: nothing sleeps
    for _ in range(steps):
        space.step(dt)
    return np.array([body.position for body in bodies[1:]], np.float64).reshape(-1, 2)


def build_pybox2d(world: DiscWorld) -> tuple[Any, list[Any]]:
    """One world in Box2D 2.3 and its discs; ``userData`` is 0 of the ground, i + 1 of disc i."""
    space, bodies = scenes.to_box2d(world.builder())
    return space, bodies[1:]


def run_pybox2d(world: DiscWorld, steps: int, dt: float, velocity_iterations: int, position_iterations: int):
    """One world in Box2D 2.3 (see ``scenes.to_box2d``)."""
    space, bodies = build_pybox2d(world)
    for _ in range(steps):
        space.Step(dt, velocity_iterations, position_iterations)
    return np.array([tuple(body.position) for body in bodies], np.float64).reshape(-1, 2)


# name: how it is run. pybox2d takes 10 and 20 position iterations at most; they end early where nothing overlaps.
PEERS: dict[str, Runner] = {
    "pymunk_10": lambda world, steps, dt: run_pymunk(world, steps, dt, 10),
    "pymunk_50": lambda world, steps, dt: run_pymunk(world, steps, dt, 50),
    "pybox2d_10": lambda world, steps, dt: run_pybox2d(world, steps, dt, 10, 10),
    "pybox2d_50": lambda world, steps, dt: run_pybox2d(world, steps, dt, 50, 20),
}
PEER_TEXT = {
    "pymunk_10": "pymunk, 10 iterations",
    "pymunk_50": "pymunk, 50 iterations",
    "pybox2d_10": "pybox2d, 10 velocity / 10 position iterations",
    "pybox2d_50": "pybox2d, 50 velocity / 20 position iterations",
}


def overlaps(positions: np.ndarray, radii: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Overlap [m] of every pair (disc-disc or disc-wall) that touches, from positions alone; 0 where a gap is left.

    Pairs touch whose gap is below ``TOUCHING``. Computed in float64 by all pairs, which suits worlds of some hundred
    discs. A disc whose centre has passed a wall counts with the distance to the segment, as one outside it would.
    """
    positions = np.asarray(positions, np.float64)
    radii = np.asarray(radii, np.float64)
    first, second = np.triu_indices(len(positions), 1)
    distance = np.linalg.norm(positions[second] - positions[first], axis=1)
    between = radii[first] + radii[second] - distance
    start = walls[:, 0].astype(np.float64)
    along = walls[:, 1].astype(np.float64) - start
    to_disc = positions[:, None] - start  # (n, m, 2)
    share = np.clip((to_disc * along).sum(-1) / (along * along).sum(-1), 0.0, 1.0)
    walled = radii[:, None] - np.linalg.norm(to_disc - share[..., None] * along, axis=-1)
    both = np.concatenate([between, walled.ravel()])
    return np.maximum(both[both > -TOUCHING], 0.0)


def mean_overlap_mm(values: np.ndarray) -> float:
    """Mean of overlaps [m] in mm; 0 where nothing touches."""
    return 1e3 * float(values.mean()) if len(values) else 0.0
