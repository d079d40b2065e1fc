"""Scenes of any shapes in pymunk and pybox2d: built from a model and state of ours, stepped, and read back."""

from __future__ import annotations

from typing import Protocol

import numpy as np

import dc_kernels as dc
from pipeline import scenes


class World(Protocol):
    """One engine's copy of the first world, or of some more."""

    def run(self, steps: int, dt: float) -> None:
        """Take steps of dt [s]."""

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (bodies, 2) [m] and angles (bodies,) [rad] of all bodies, the static ones too, in our order."""


class Pymunk:
    """Chipmunk (see ``scenes.to_pymunk``)."""

    def __init__(
        self, model: dc.Model, state: dc.State, joints: dc.Joints, iterations: int, *, worlds: int = 1
    ) -> None:
        """Copy so many worlds, from the first on; each takes all its steps before the next does."""
        import pymunk

        self.spaces, self.apart = [], pymunk.ShapeFilter(mask=0)
        made = [scenes.to_pymunk((model, state, joints), world) for world in range(worlds)]
        self.spaces = [world.space for world in made]
        self.bodies = [body for world in made for body in world.bodies]
        for space in self.spaces:
            space.iterations = iterations

    def __del__(self) -> None:
        """Let contacts expire: each shape that a space frees is looked for in all contacts that the space remembers."""
        for space in self.spaces:
            for shape in space.shapes:
                shape.filter = self.apart
            for _ in range(space.collision_persistence + 2):
                space.step(1e-3)

    def run(self, steps: int, dt: float) -> None:
        for space in self.spaces:
            for _ in range(steps):
                space.step(dt)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([tuple(b.position) for b in self.bodies]), np.array([b.angle for b in self.bodies])


class Pybox2d:
    """Box2D 2.3 (see ``scenes.to_box2d``)."""

    def __init__(
        self,
        model: dc.Model,
        state: dc.State,
        joints: dc.Joints,
        velocity_iterations: int,
        position_iterations: int,
        *,
        worlds: int = 1,
    ) -> None:
        """Copy so many worlds, from the first on; each takes all its steps before the next does."""
        self.iterations = velocity_iterations, position_iterations
        made = [scenes.to_box2d((model, state, joints), world) for world in range(worlds)]
        self.spaces = [world.space for world in made]
        self.bodies = [body for world in made for body in world.bodies]

    def run(self, steps: int, dt: float) -> None:
        for space in self.spaces:
            for _ in range(steps):
                space.Step(dt, *self.iterations)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        places = np.array([tuple(body.position) for body in self.bodies], np.float64)
        return places.reshape(-1, 2), np.array([body.angle for body in self.bodies], np.float64)


ENGINES: dict[str, tuple[type, tuple[tuple[int, ...], ...]]] = {
    "pymunk": (Pymunk, ((5,), (10,), (20,), (50,), (100,))),
    "pybox2d": (Pybox2d, ((4, 2), (10, 3), (10, 10), (20, 10), (50, 20), (100, 40))),
}
"""What makes a world, and its numbers of iterations: of pybox2d velocity and position iterations."""
