"""Scenes and simulations that the benches share."""

from __future__ import annotations

from typing import Any

import numpy as np

import dc_kernels as dc
from bench.peers.peers import DiscWorld
from pipeline import scenes

DT = 0.01  # time step [s] and steps of the thesis protocol
STEPS = 250
BATCH = 64  # worlds in a batch
# Contacts: discs of a settled thesis pile with half as many, and its copies side by side.
SWEEP_PILES = {2_000: (1_000, 1), 20_000: (10_000, 1), 200_000: (10_000, 10)}
# Bodies in a world: worlds in the batch.
SCALING_WORLDS = {100: 64, 1_000: 8, 10_000: 1, 100_000: 1}
SETTLING = {100: 300, 1_000: 700, 10_000: 650, 100_000: 1_600}  # steps until a dropped pile has come to rest
SETTLING_COPIES = 12  # steps after piles at rest were put side by side
SWEEPS = 30  # at most in a step of a settled pile: enough to keep it at rest from the cache


def simulation(
    scene: scenes.Scene, worlds: int = 1, seed: int = 0, *, dtype: str = "float32", **options: Any
) -> dc.Simulation:
    """Make a simulation of one world for each of the seeds ``seed, seed + 1, ...``.

    Args:
        scene: what stands in a world.
        worlds: how many.
        seed: of the first.
        dtype: scalar of the arrays.
        options: of ``dc.Simulation``: config, threads, schedule, specialize.
    """
    model, state, joints = scene.build(worlds, seed).finalize(dtype=dtype)
    return dc.Simulation(model, state, joints, **options)


def disc_worlds(scene: scenes.Thesis, worlds: int, seed: int = 0) -> list[DiscWorld]:
    """Return the worlds of ``simulation`` as the peers take them: positions, radii and walls."""
    model, state, _ = scene.build(worlds, seed).finalize(dtype="float64")
    side = scene.side
    corners = np.array([(0.0, side), (0.0, 0.0), (side, 0.0), (side, side)])
    walls = np.stack([corners[:-1], corners[1:]], axis=1)
    return [
        DiscWorld(
            positions=positions,
            radii=np.full(len(positions), scene.radius),
            walls=walls,
            gravity=(0.0, -scene.gravity),
            density=scene.density,
            friction=scene.friction,
        )
        for positions in disc_positions(model, state)
    ]


def disc_positions(model: dc.Model, state: dc.State) -> list[np.ndarray]:
    """Return the positions (n, 2) [m] in float64 of the dynamic bodies of each world, its origin added."""
    dynamic = model.numpy("body_type") == dc.BodyType.DYNAMIC
    positions, starts = state.numpy("position").astype(np.float64), model.numpy("body_start")
    found = []
    for world in range(model.world_count):
        bodies = slice(starts[world], starts[world + 1])
        found.append(positions[bodies][dynamic[bodies]] + model.numpy("origin")[world])
    return found


def dynamic_count(sim: dc.Simulation) -> int:
    """Count the dynamic bodies of all worlds."""
    return int((sim.model.numpy("body_type") == dc.BodyType.DYNAMIC).sum())


def contact_count(sim: dc.Simulation) -> int:
    """Count the present contacts of all worlds."""
    return int(sim.contacts.numpy("contact_count").sum())


def settled(bodies: int, worlds: int = 1) -> dc.Simulation:
    """Drop thesis piles of so many discs, a key of ``SETTLING``, and step until they rest."""
    sim = simulation(scenes.Thesis(bodies=bodies), worlds, config=dc.SolverConfig.preset("accurate", max_sweeps=SWEEPS))
    sim.run(SETTLING[bodies], DT)
    return sim


def wide_pile(pile: np.ndarray, copies: int, *, shuffled: bool = False, worlds: int = 1) -> dc.ModelBuilder:
    """Put copies of a settled thesis pile side by side in each world, every second one mirrored.

    It spares the fall of so large a pile.

    Args:
        pile: positions of its discs (n, 2) [m].
        copies: how many.
        shuffled: number the bodies at random instead of by place.
        worlds: how many, all alike.
    """
    scene = scenes.Thesis(bodies=len(pile))
    left = -0.5 * copies * scene.side
    mirrored = [scene.side, 0.0] + pile * [-1.0, 1.0]
    positions = np.concatenate([(mirrored if i % 2 else pile) + [left + i * scene.side, 0.0] for i in range(copies)])
    if shuffled:
        positions = np.random.default_rng(0).permutation(positions)
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world(gravity=(0.0, -scene.gravity))
        scene.add_static_chain(builder, [(left, scene.side), (left, 0.0), (-left, 0.0), (-left, scene.side)])
        builder.add_discs(positions, scene.radius, **scene.material)
    return builder


def side_by_side(
    sim: dc.Simulation, copies: int, *, shuffled: bool = False, worlds: int = 1, **options: Any
) -> dc.Simulation:
    """Put copies of the pile in the first world of a simulation side by side (``wide_pile``), and let them rest.

    Options are those of ``dc.Simulation``, except config.
    """
    builder = wide_pile(disc_positions(sim.model, sim.state)[0], copies, shuffled=shuffled, worlds=worlds)
    model, state, joints = builder.finalize()
    wide = dc.Simulation(model, state, joints, config=dc.SolverConfig(max_sweeps=SWEEPS), **options)
    wide.run(SETTLING_COPIES, DT)
    return wide
