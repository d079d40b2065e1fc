"""The engines side by side: ours by settings, pymunk, pybox2d, and a peer program; all begin with the same bodies."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from bench.games.program import Program, lines_of
from bench.peers import engines as peers
from dc_kernels.model.enums import CAPACITY_FLAGS
from dc_kernels.stages import PHASES, of_phase
from pipeline import scenes

PEERS = {
    "pymunk": (peers.Pymunk, (10,), "pymunk, 10 iterations"),
    "pybox2d": (peers.Pybox2d, (8, 3), "pybox2d, 8 velocity and 3 position iterations"),
}
"""What makes a world of it, its iterations (those that its manual proposes), and its name for people."""


class Engine(Protocol):
    """An engine with a scene's worlds, or the first of them."""

    worlds: int
    """How many of the worlds it has [1]."""

    def restart(self) -> float:
        """Put all bodies back to where they were handed over; the time that it took [s]."""

    def run(self, steps: int) -> float:
        """Take steps in all worlds; their time [s]."""

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (bodies, 2) [m] and angles (bodies,) [rad] of its worlds' bodies, static ones too."""

    def shares(self, steps: int) -> dict[str, float]:
        """Take some more steps, and return the share that each part has of their time; empty where it tells none."""


@dataclass(frozen=True)
class Handed:
    """Bodies as each engine gets them."""

    builder: dc.ModelBuilder
    bodies: Mapping[str, np.ndarray]
    """Fields of the state that are not those of the builder, by name."""
    scene: scenes.Scene | None = None
    """The scene that made them, where making them belongs to what is timed."""

    @cached_property
    def groups(self) -> tuple[dc.Model, dc.State, dc.Joints]:
        """Model, state and joints in float32."""
        return self._finalize("float32")

    @cached_property
    def exact(self) -> tuple[dc.Model, dc.State, dc.Joints]:
        """Model, state and joints in float64."""
        return self._finalize("float64")

    def _finalize(self, dtype: str) -> tuple[dc.Model, dc.State, dc.Joints]:
        model, state, joints = self.builder.finalize(dtype=dtype)
        for name, values in self.bodies.items():
            state.assign(name, values.astype(dtype))
        return model, state, joints

    @property
    def worlds(self) -> int:
        """How many worlds there are."""
        return int(self.groups[0].world_count)

    def fresh(self) -> tuple[dc.Model, dc.State, dc.Joints]:
        """Return the model, and a state and joints for one simulation alone."""
        model, state, joints = self.groups
        return model, state.copy(), joints.copy()


class Ours:
    """A simulation; ``stepwise`` calls ``step`` for each step, as a game does, instead of ``run`` for all."""

    def __init__(
        self, handed: Handed, config: dc.SolverConfig, *, threads: int = 1, stepwise: bool = False, **options: Any
    ) -> None:
        """Make it; other options are those of ``dc.Simulation``."""
        self.handed, self.worlds, self.stepwise = handed, handed.worlds, stepwise
        self.options: Mapping[str, Any] = {"config": config, "threads": threads, **options}
        self.sim = dc.Simulation(*handed.fresh(), **self.options)
        self.sim.warmup()

    def restart(self) -> float:
        """Go back to the beginning; a scene that is given is built anew, from its places on."""
        begin = time.perf_counter()
        if self.handed.scene is None:
            self.sim.reset()
        else:
            self.sim = dc.Simulation(*self.handed.scene.build(self.worlds).finalize(), **self.options)
        return time.perf_counter() - begin

    def run(self, steps: int) -> float:
        if not self.stepwise:
            return timing.seconds(lambda: self.sim.run(steps, DT))
        step = self.sim.step
        begin = time.perf_counter()
        for _ in range(steps):
            step(DT)
        return time.perf_counter() - begin

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return tuple(self.sim.state.numpy(name).astype(np.float64) for name in ("position", "angle"))  # type: ignore[return-value]

    def shares(self, steps: int) -> dict[str, float]:
        """Launch each stage by itself and take medians; a step that outgrows its room is taken by ``run`` instead."""
        sim = self.sim
        sim.run(1, DT)
        names = [
            name
            for phase in PHASES
            for name in of_phase(phase, sim.config.corrects_positions, sim.config.sleep, soft=sim.config.soft)
        ]
        launches = [sim.bind(name, 0, self.worlds) for name in names]
        spent: list[list[float]] = []
        for _ in range(steps):
            taken = [timing.seconds(launch) for launch in launches]
            if (sim.state.numpy("flags") & int(CAPACITY_FLAGS)).any():
                sim.run(1, DT)
                launches = [sim.bind(name, 0, self.worlds) for name in names]
                continue
            spent.append(taken)
        return _shares({name: statistics.median(taken) for name, taken in zip(names, zip(*spent), strict=False)})


class Peer:
    """pymunk or pybox2d."""

    def __init__(self, name: str, handed: Handed, worlds: int) -> None:
        """Copy the first worlds."""
        self.handed, self.worlds = handed, worlds
        self.make, self.iterations, _ = PEERS[name]
        self.restart()

    def restart(self) -> float:
        """Copy the worlds anew; a world that is built by Python takes longer than the engine needs."""
        begin = time.perf_counter()
        self.world = self.make(*self.handed.groups, *self.iterations, worlds=self.worlds)
        return time.perf_counter() - begin

    def run(self, steps: int) -> float:
        return timing.seconds(lambda: self.world.run(steps, DT))

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        position, angle = self.world.places()
        return position, angle

    def shares(self, steps: int) -> dict[str, float]:
        """Neither tells."""
        return {}


class Foreign:
    """A program that speaks the protocol; it says itself how long its steps take."""

    def __init__(self, program: Program, handed: Handed, settings: Sequence[tuple[str, int]] = ()) -> None:
        """Tell it the settings and the worlds, and let it build them."""
        self.program, self.worlds = program, handed.worlds
        program.tell(["clear\n", *(f"setting {name} {value}\n" for name, value in settings)])
        program.tell(lines_of(*handed.groups))
        self.restart()

    def restart(self) -> float:
        return self.program.build()

    def run(self, steps: int) -> float:
        seconds, self._parts = self.program.step(steps, DT)
        return seconds

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        poses = self.program.poses()
        return poses[:, :2], poses[:, 2]

    def shares(self, steps: int) -> dict[str, float]:
        self.run(steps)
        return _shares(self._parts)


def _shares(parts: Mapping[str, float]) -> dict[str, float]:
    whole = sum(parts.values())
    return {name: value / whole for name, value in parts.items()} if whole else {}
