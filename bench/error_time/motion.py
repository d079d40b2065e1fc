"""Trajectories with a closed form: error at a fixed time over the time step, ours and the peers'.

Each motion ends at a time that every step of the ladder divides. The error is the distance along the motion (of the
pendulum: in the plane) from the exact place; how deep a body sinks into the floor is measured in other cases.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.peers.engines import ENGINES
from dc_kernels.runtime.imports import require
from pipeline import scenes

GRAVITY = 9.8  # [m/s^2]
STEPS = tuple(0.02 / 2**k for k in range(7))  # [s]
ROUNDS = 5
ORDER_FLOOR = 1e-9  # [m]: errors below are round-off and tell no order


@dataclass(frozen=True)
class Motion:
    """One body, and where it is exactly."""

    title: str
    duration: float
    """[s]"""
    build: Callable[[], dc.ModelBuilder]
    error: Callable[[np.ndarray], float]
    """Distance of a place (2,) from the exact one at the end [m]."""


def _on_floor(disc: bool, speed: float, friction: float) -> dc.ModelBuilder:
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -GRAVITY))
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, [(-50.0, 0.0), (50.0, 0.0)], friction=friction)
    height = 0.5 if disc else 0.25
    body = builder.add_body((0.0, height), velocity=(speed, 0.0))
    if disc:
        builder.add_disc(body, height, friction=friction)
    else:
        builder.add_box(body, 0.5, height, friction=friction)
    return builder


def _stop(place: np.ndarray) -> float:
    """Coulomb friction stops a box that slides at v after v^2 / (2 mu g)."""
    return abs(float(place[0]) - 3.0**2 / (2.0 * 0.3 * GRAVITY))


def _roll(place: np.ndarray) -> float:
    """A disc rolls down a slope at (2/3) g sin(theta), where tan(theta) <= 3 mu."""
    slope = 0.3
    along = -(place[0] * math.cos(slope) + place[1] * math.sin(slope))  # downhill is to the left
    return abs(float(along) - 0.5 * (2.0 / 3.0) * GRAVITY * math.sin(slope) * 1.6**2)


def _slide_to_roll(place: np.ndarray) -> float:
    """A disc thrown at v without spin slides for v / (3 mu g), then rolls at (2/3) v."""
    speed, friction = 3.0, 0.3
    until = speed / (3.0 * friction * GRAVITY)
    gone = speed * until - 0.5 * friction * GRAVITY * until**2
    return abs(float(place[0]) - (gone + 2.0 / 3.0 * speed * (1.6 - until)))


def _pendulum(place: np.ndarray) -> float:
    """A point on a rod let go at angle a from below: sin(angle / 2) = k sn(K - sqrt(g/l) t | k^2), k = sin(a / 2)."""
    special = require("scipy.special", "bench")
    m = math.sin(0.25 * math.pi) ** 2
    sn = special.ellipj(special.ellipk(m) - math.sqrt(GRAVITY) * 1.6, m)[0]
    angle = 2.0 * math.asin(math.sqrt(m) * float(sn))
    return float(np.hypot(place[0] - math.sin(angle), place[1] + math.cos(angle)))


MOTIONS: dict[str, Motion] = {
    "stop": Motion("sliding box comes to rest", 1.6, lambda: _on_floor(False, 3.0, 0.3), _stop),
    "roll": Motion(
        "disc rolls down a slope", 1.6, lambda: scenes.Incline(shape="disc", angle=0.3, gravity=GRAVITY).build(), _roll
    ),
    "slide_to_roll": Motion("disc slides, then rolls", 1.6, lambda: _on_floor(True, 3.0, 0.3), _slide_to_roll),
    "pendulum": Motion(
        "pendulum let go at 90 degrees",
        1.6,
        lambda: scenes.Chain(bodies=1, jitter=0.0, gravity=GRAVITY).build(),
        _pendulum,
    ),
}
SERIES = ("deep-contact", "deep-contact float64", "pymunk", "pybox2d")


def place_after(motion: Motion, series: str, dt: float) -> tuple[np.ndarray, float]:
    """Where the body ends (2,) [m], and the wall time of the steps [s]."""
    engine = series.split()[0]
    model, state, joints = motion.build().finalize(dtype="float32" if series == "deep-contact" else "float64")
    body = int(np.flatnonzero(model.numpy("body_type") == dc.BodyType.DYNAMIC)[0])
    steps = round(motion.duration / dt)
    if engine == "deep-contact":
        sim = dc.Simulation(model, state, joints)
        sim.warmup()
        seconds = timing.seconds(lambda: sim.run(steps, dt))
        return sim.state.numpy("position")[body].astype(np.float64), seconds
    make, choices = ENGINES[engine]
    world = make(model, state, joints, *choices[1 if engine == "pymunk" else 2])
    seconds = timing.seconds(lambda: world.run(steps, dt))
    return world.places()[0][body], seconds


def points(quick: bool, advance: Callable[[str], None]) -> list[dict[str, Any]]:
    """A point for each motion, engine and time step: wall time per simulated second and error [m]."""
    found = []
    for name, motion in MOTIONS.items():
        for series in SERIES:
            for dt in STEPS[: 4 if quick else None]:
                made = [place_after(motion, series, dt) for _ in range(ROUNDS)]
                seconds = statistics.median(seconds for _, seconds in made) / motion.duration
                point = {"scene": name, "kind": "motion", "engine": series.split()[0], "dt": dt, "seconds": seconds}
                if series.endswith("float64"):
                    point["dtype"] = "float64"
                found.append(point | {"trajectory": motion.error(made[0][0])})
            advance(name)
    return found


def order(steps: list[float], errors: list[float]) -> float | None:
    """Order of convergence: the median slope of log error over log dt; None where all is exact to round-off."""
    slopes = [
        math.log(errors[i] / errors[i + 1]) / math.log(steps[i] / steps[i + 1])
        for i in range(len(steps) - 1)
        if min(errors[i], errors[i + 1]) > ORDER_FLOOR
    ]
    return statistics.median(slopes) if slopes else None
