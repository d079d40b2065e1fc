"""Bodies that slide without friction over rows of flush shapes: nothing may catch on an edge that a neighbour hides.

Other engines had it reported (matter.js 970, p2.js 173; Catto, Ghost collisions, 2020). Each case is a world: a shape
of five kinds at a speed from 0.2 to 100 m/s, over tiles that are shapes of one body, bodies of their own, or chains of
two vertices end to end, flush or off by up to the slop, in height and along the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import dc_kernels as dc

SHAPES: dict[str, Callable[[dc.ModelBuilder, int], object]] = {
    "box": lambda builder, body: builder.add_box(body, 0.4, 0.4, friction=0.0),
    "rounded": lambda builder, body: builder.add_box(body, 0.3, 0.3, radius=0.1, friction=0.0),
    "disc": lambda builder, body: builder.add_disc(body, 0.4, friction=0.0),
    "capsule": lambda builder, body: builder.add_capsule(body, (-0.3, 0.0), (0.3, 0.0), 0.4, friction=0.0),
    "triangle": lambda builder, body: builder.add_polygon(body, [(-0.4, -0.4), (0.4, -0.4), (0.0, 0.6)], friction=0.0),
}
"""By name, what adds a shape that stands 0.4 m below the origin of its body."""

SPEEDS = (0.2, 2.0, 7.0, 31.0, 100.0)  # [m/s]
TILINGS = ("body", "bodies", "chains")
WAY = 18.0  # [m] over tiles; slow bodies go as far as the seconds let them
SECONDS = 2.0
SLOP = 5e-4  # [m], of a world whose length scale is 1 m


class Case(NamedTuple):
    """One world."""

    shape: str
    speed: float  # [m/s]
    tiling: str
    off: float  # [slop], by which tiles differ at most in height, and gap along the way
    width: float  # [m] of a tile


def cases(quick: bool) -> list[Case]:
    """The grid of shapes, speeds and tilings; the quick form has one width of tiles."""
    return [
        Case(shape, speed, tiling, off, width)
        for shape in SHAPES
        for speed in SPEEDS
        for tiling in TILINGS
        for off in (0.0, 1.0)
        for width in ((0.5,) if quick else (0.3, 0.5, 1.0))
    ]


def build(chosen: list[Case]) -> tuple[dc.ModelBuilder, list[int]]:
    """A world for each case, and the body that slides in it."""
    builder, bodies = dc.ModelBuilder(), []
    draw = np.random.default_rng(12)
    for case in chosen:
        builder.add_world(length_scale=1.0)
        ground = builder.add_body(type=dc.BodyType.STATIC)
        x = -2.0
        while x < WAY + 2.0:
            x, top = x + case.off * SLOP * draw.uniform(), case.off * SLOP * draw.uniform(-1.0, 0.0)
            if case.tiling == "chains":
                builder.add_chain(ground, [(x, top), (x + case.width, top)], friction=0.0)
            elif case.tiling == "body":
                builder.add_box(ground, case.width / 2, 0.5, center=(x + case.width / 2, top - 0.5), friction=0.0)
            else:
                tile = builder.add_body((x + case.width / 2, top - 0.5), type=dc.BodyType.STATIC)
                builder.add_box(tile, case.width / 2, 0.5, friction=0.0)
            x += case.width
        bodies.append(builder.add_body(position=(0.0, 0.4), velocity=(case.speed, 0.0)))
        SHAPES[case.shape](builder, bodies[-1])
    return builder, bodies


def slide(
    chosen: list[Case], dt: float, dtype: str = "float32", backend: str = "warp", seconds: float = SECONDS
) -> list[dict[str, Any]]:
    """Of each case the least speed over that at the start [1], and how far the body rises and sinks [m]."""
    builder, bodies = build(chosen)
    sim = dc.Simulation(*builder.finalize(dtype=dtype, backend=backend))
    speed = np.array([case.speed for case in chosen])
    steps = (np.minimum(seconds, WAY / speed) / dt).astype(int)
    least, highest, lowest = speed.copy(), np.full(len(speed), 0.4), np.full(len(speed), 0.4)
    for step in range(steps.max()):
        sim.step(dt)
        on = step < steps  # the others have left their tiles
        v, y = sim.state.numpy("velocity")[bodies, 0], sim.state.numpy("position")[bodies, 1]
        y = y - sim.model.numpy("center_of_mass")[bodies, 1]  # of the frame's origin, as bodies stay upright
        least = np.where(on, np.minimum(least, np.where(np.isfinite(v), v, -math.inf)), least)
        highest = np.where(on, np.maximum(highest, y), highest)
        lowest = np.where(on, np.minimum(lowest, y), lowest)
    return [
        {**case._asdict(), "dt": dt, "dtype": dtype, "speed_kept": k, "rise": up - 0.4, "sink": 0.4 - down}
        for case, k, up, down in zip(chosen, (least / speed).tolist(), highest.tolist(), lowest.tolist(), strict=True)
    ]


def measure(quick: bool) -> dict[str, Any]:
    """Slide all cases.

    Returns:
        How many there are, the least share of a speed that was kept, the farthest that a body rose [m], and the cases
        that kept less than 0.999 of their speed, or rose or sank by more than their tiles are off and the slop.
    """
    rows = []
    for dtype, dt in (
        [("float32", 1 / 60)] if quick else [("float32", 1 / 60), ("float32", 1 / 240), ("float64", 1 / 60)]
    ):
        for discs in (False, True):  # worlds of discs alone have kernels of their own
            chosen = [case for case in cases(quick) if (case.shape == "disc") == discs]
            rows += slide(chosen, dt, dtype)
    caught = [r for r in rows if r["speed_kept"] < 0.999 or max(r["rise"], r["sink"] - r["off"] * SLOP) > SLOP]
    return {
        "cases": len(rows),
        "tiles_worst_speed": min(row["speed_kept"] for row in rows),
        "tiles_worst_jump_m": max(row["rise"] for row in rows),
        "slop_m": SLOP,
        "caught": caught,
    }
