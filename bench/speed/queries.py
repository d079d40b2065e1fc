"""Queries: rays a second and core among 1 000 and 100 000 bodies, beside pymunk and pybox2d.

Discs of the scene ``thesis`` as they are placed; rays of 20 m from points and in directions drawn uniformly, most of
which meet something; boxes of 1 m. pymunk's ``segment_query_first``, ``point_query``, ``point_query_nearest`` and
``bb_query``, and pybox2d's ``RayCast`` and ``QueryAABB`` with callbacks, are called once a query, as their users would,
so Python is part of what they take. ``bb_query`` gives shapes whose boxes overlap, not the shapes themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "queries: rays, moving discs, points and closest points, ns each, among 1 000 and 100 000 bodies"
KINDS = ("ray", "disc", "point", "box", "closest")
ENGINES = ("pymunk", "pybox2d")
KEYS = ("rays_per_s_1000", "rays_per_s_100000", "over_pymunk_1000", "over_pybox2d_1000", "fraction_difference")
THREADS = 1
BODIES = (1_000, 100_000)
RAYS, PEER_RAYS = 200_000, 2_000
LENGTH = 20.0  # [m]
RADIUS, HALF = 0.25, 0.5  # of a disc that is cast, and half the side of a box [m]
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
        peers = peer_queries(builder, origin[:PEER_RAYS], translation[:PEER_RAYS]) if count == BODIES[0] else {}
        rounds = ROUNDS_QUICK if quick else ROUNDS
        times = timing.medians(timing.interleave({**ours, **peers}, rounds))
        for name in ours:
            values[f"{name}_ns_{count}"] = 1e9 * times[name] / (count if name == "update" else RAYS)
        values[f"rays_per_s_{count}"] = RAYS / times["ray"]
        fractions = asking.cast_rays(origin[:PEER_RAYS], translation[:PEER_RAYS]).fraction
        for name, ask in peers.items():
            engine, kind = name.split("_")
            # rays are named by the engine alone
            label = engine if kind == "ray" else name
            values[f"{label}_ns_{count}"] = 1e9 * times[name] / PEER_RAYS
            values[f"over_{label}_{count}"] = values[f"{label}_ns_{count}"] / values[f"{kind}_ns_{count}"]
            if kind == "ray":
                # a ray that begins within a body is told differently by each engine
                differs = np.abs(np.array(ask()) - fractions)[fractions > 0]
                values["fraction_difference"] = max(values["fraction_difference"], float(np.median(differs)))
    return values


def our_queries(asking: Any, origin: np.ndarray, translation: np.ndarray) -> dict[str, Callable[[], Any]]:
    """Queries by name."""
    return {
        "ray": lambda: asking.cast_rays(origin, translation),
        "disc": lambda: asking.cast_shape(origin, translation, radius=RADIUS),
        "point": lambda: asking.overlap_points(origin),
        "box": lambda: asking.overlap_boxes(origin - HALF, origin + HALF),
        "closest": lambda: asking.closest_points(origin),
        "update": asking.update,
    }


def peer_queries(builder: Any, origin: np.ndarray, translation: np.ndarray) -> dict[str, Callable[[], list[Any]]]:
    """What asks other engines one by one, by engine and kind; rays give their fractions."""
    from pipeline import scenes

    begins = [tuple(map(float, p)) for p in origin]
    ends = [tuple(map(float, p)) for p in origin + translation]
    space, _ = scenes.to_pymunk(builder)
    space.step(1e-9)  # makes its tree
    world, _ = scenes.to_box2d(builder)
    return {**by_pymunk(space, begins, ends), **by_pybox2d(world, begins, ends)}


def by_pymunk(space: Any, begins: list[Any], ends: list[Any]) -> dict[str, Callable[[], list[Any]]]:
    """Queries of a space of pymunk."""
    import pymunk

    every = pymunk.ShapeFilter()

    def rays() -> list[float]:
        found = (space.segment_query_first(a, b, 0.0, every) for a, b in zip(begins, ends, strict=True))
        return [1.0 if hit is None else hit.alpha for hit in found]

    return {
        "pymunk_ray": rays,
        "pymunk_disc": lambda: [
            space.segment_query_first(a, b, RADIUS, every) for a, b in zip(begins, ends, strict=True)
        ],
        "pymunk_point": lambda: [space.point_query(p, 0.0, every) for p in begins],
        "pymunk_box": lambda: [
            space.bb_query(pymunk.BB(x - HALF, y - HALF, x + HALF, y + HALF), every) for x, y in begins
        ],
        "pymunk_closest": lambda: [space.point_query_nearest(p, LENGTH, every) for p in begins],
    }


def by_pybox2d(world: Any, begins: list[Any], ends: list[Any]) -> dict[str, Callable[[], list[Any]]]:
    """Queries of a world of pybox2d, which casts no shapes and finds no closest point of a world."""
    import Box2D

    class Nearest(Box2D.b2RayCastCallback):  # type: ignore[misc]
        def ReportFixture(self, fixture: Any, point: Any, normal: Any, fraction: float) -> float:
            self.fraction = fraction
            return fraction

    class At(Box2D.b2QueryCallback):  # type: ignore[misc]
        def ReportFixture(self, fixture: Any) -> bool:
            if self.point is None or fixture.TestPoint(self.point):
                self.found.append(fixture)
            return True

    def rays() -> list[float]:
        fractions = []
        for a, b in zip(begins, ends, strict=True):
            nearest = Nearest()
            nearest.fraction = 1.0
            world.RayCast(nearest, a, b)
            fractions.append(nearest.fraction)
        return fractions

    def overlaps(half: float) -> list[list[Any]]:
        lists = []
        for x, y in begins:
            at = At()
            at.found, at.point = [], None if half else (x, y)
            world.QueryAABB(at, Box2D.b2AABB(lowerBound=(x - half, y - half), upperBound=(x + half, y + half)))
            lists.append(at.found)
        return lists

    return {"pybox2d_ray": rays, "pybox2d_point": lambda: overlaps(0.0), "pybox2d_box": lambda: overlaps(HALF)}


def report(values: dict[str, Any]) -> str:
    """Return the table for people."""
    columns = [(count, engine) for count in BODIES for engine in ("", *(ENGINES if count == BODIES[0] else ()))]

    def cell(kind: str, count: int, engine: str) -> float | None:
        label = kind if not engine else engine if kind == "ray" else f"{engine}_{kind}"
        return values.get(f"{label}_ns_{count}")

    rows = [[kind, *(cell(kind, *column) for column in columns)] for kind in (*KINDS, "update")]
    heads = [f"{count} bodies{', ' if engine else ''}{engine}" for count, engine in columns]
    return timing.table(["ns each (update: a body)", *heads], rows)
