"""Queries: rays a second and core among 1 000 and 100 000 bodies, beside pymunk and pybox2d.

Discs of the scene ``thesis`` as they are placed; rays of 20 m from points and in directions drawn uniformly, most of
which meet something. pymunk's ``segment_query_first`` and pybox2d's ``RayCast`` with a callback that keeps the closest
are called once a ray, as their users would, so Python is part of what they take.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "queries: rays, moving discs, points and closest points, ns each, among 1 000 and 100 000 bodies"
KEYS = ("rays_per_s_1000", "rays_per_s_100000", "over_pymunk_1000", "over_pybox2d_1000", "fraction_difference")
THREADS = 1
BODIES = (1_000, 100_000)
RAYS, PEER_RAYS = 200_000, 2_000
LENGTH = 20.0  # [m]
ROUNDS, ROUNDS_QUICK = 7, 3


def measure(quick: bool) -> dict[str, Any]:
    """Nanoseconds a query by kind and number of bodies, rays a second, and ratios to the peers."""
    import dc_kernels as dc
    from pipeline.scenes import scene

    values: dict[str, Any] = {"fraction_difference": 0.0}
    rng = np.random.default_rng(0)
    for count in BODIES:
        timing.progress(f"{count} bodies")
        builder = scene("thesis", bodies=count).build(1, 0)
        model, state, _ = builder.finalize()
        asking = dc.Queries(model, state.position, state.angle)
        position = state.numpy("position")[1:]
        origin = rng.uniform(position.min(axis=0), position.max(axis=0), (RAYS, 2)).astype(np.float32)
        angle = rng.uniform(0.0, 2.0 * np.pi, RAYS)
        translation = (LENGTH * np.stack([np.cos(angle), np.sin(angle)], axis=1)).astype(np.float32)
        ours = our_queries(asking, origin, translation)
        peers = peer_rays(builder, origin[:PEER_RAYS], translation[:PEER_RAYS]) if count == BODIES[0] else {}
        rounds = ROUNDS_QUICK if quick else ROUNDS
        times = timing.medians(timing.interleave({**ours, **peers}, rounds))
        for name in ours:
            values[f"{name}_ns_{count}"] = 1e9 * times[name] / (count if name == "update" else RAYS)
        values[f"rays_per_s_{count}"] = RAYS / times["ray"]
        fractions = asking.cast_rays(origin[:PEER_RAYS], translation[:PEER_RAYS]).fraction
        for name, cast in peers.items():
            values[f"{name}_ns_{count}"] = 1e9 * times[name] / PEER_RAYS
            values[f"over_{name}_{count}"] = values[f"{name}_ns_{count}"] / values[f"ray_ns_{count}"]
            # a ray that begins within a body is told differently by each engine
            differs = np.abs(np.array(cast()) - fractions)[fractions > 0]
            values["fraction_difference"] = max(values["fraction_difference"], float(np.median(differs)))
    return values


def our_queries(asking: Any, origin: np.ndarray, translation: np.ndarray) -> dict[str, Callable[[], Any]]:
    """Queries by name."""
    return {
        "ray": lambda: asking.cast_rays(origin, translation),
        "disc": lambda: asking.cast_shape(origin, translation, radius=0.25),
        "point": lambda: asking.overlap_points(origin),
        "closest": lambda: asking.closest_points(origin),
        "update": asking.update,
    }


def peer_rays(builder: Any, origin: np.ndarray, translation: np.ndarray) -> dict[str, Callable[[], list[float]]]:
    """What casts the rays one by one in other engines, and gives the fractions."""
    import Box2D
    import pymunk

    from pipeline import scenes

    space, _ = scenes.to_pymunk(builder)
    space.step(1e-9)  # makes its tree
    world, _ = scenes.to_box2d(builder)
    begins = [tuple(map(float, p)) for p in origin]
    ends = [tuple(map(float, p)) for p in origin + translation]
    every = pymunk.ShapeFilter()

    class Nearest(Box2D.b2RayCastCallback):  # type: ignore[misc]
        def ReportFixture(self, fixture: Any, point: Any, normal: Any, fraction: float) -> float:
            self.fraction = fraction
            return fraction

    def by_pymunk() -> list[float]:
        found = (space.segment_query_first(a, b, 0.0, every) for a, b in zip(begins, ends, strict=True))
        return [1.0 if hit is None else hit.alpha for hit in found]

    def by_pybox2d() -> list[float]:
        fractions = []
        for a, b in zip(begins, ends, strict=True):
            nearest = Nearest()
            nearest.fraction = 1.0
            world.RayCast(nearest, a, b)
            fractions.append(nearest.fraction)
        return fractions

    return {"pymunk": by_pymunk, "pybox2d": by_pybox2d}


def report(values: dict[str, Any]) -> str:
    """Return the table for people."""
    names = ("ray", "disc", "point", "closest", "update", "pymunk", "pybox2d")
    rows = [[name, *(values.get(f"{name}_ns_{count}") for count in BODIES)] for name in names]
    return timing.table(["ns each (update: a body)", *(f"{count} bodies" for count in BODIES)], rows)
