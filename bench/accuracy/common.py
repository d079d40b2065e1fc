"""What the cases of closed forms share: the register, exact settings, limits from rounding, the order in the time step.

g = 9.8 m/s^2, SI units, solid discs have k = I / (m r^2) = 1/2. Time steps are powers of two where a discrete closed
form is checked, so that float32 holds them exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.verdicts import Cases, Check

G = 9.8
cases = Cases()

TOLERANCE = {"float64": 1e-13, "float32": 1e-6}
"""Largest impulse change [N s] at which an exact solve ends: what rounding of impulses near 1 N s lets it reach."""
EXACT = (("float64", "none"), ("float64", "aitken"), ("float64", "adaptive"), ("float32", "adaptive"))
"""Scalars and accelerations of the cases with a discrete closed form."""
ORDER_OFF = 0.15
"""How far a measured order may lie from the one of the theory."""


def world(gravity: tuple[float, float] = (0.0, -G), **options: Any) -> dc.ModelBuilder:
    """A builder with one world."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=gravity, **options)
    return builder


def tilted(theta: float) -> tuple[float, float]:
    """Gravity as a slope of angle theta [rad] feels it, downhill along x."""
    return G * math.sin(theta), -G * math.cos(theta)


def floor(builder: dc.ModelBuilder, half_width: float = 60.0, **material: Any) -> int:
    """The half plane y < 0."""
    body = builder.add_body((0.0, -2.0), type=dc.BodyType.STATIC)
    builder.add_box(body, half_width, 2.0, **material)
    return body


def box(
    builder: dc.ModelBuilder, position: Any, half_width: float, half_height: float, *, mu: float = 0.5, **body: Any
) -> int:
    """A box of mass 1 unless said otherwise; ``body``: of ``add_body``."""
    index = builder.add_body(position, **{"mass": 1.0, **body})
    builder.add_box(index, half_width, half_height, friction=mu)
    return index


def disc(
    builder: dc.ModelBuilder,
    position: Any,
    radius: float,
    *,
    k: float = 0.5,
    mu: float = 0.5,
    restitution: float = 0.0,
    **body: Any,
) -> int:
    """A disc of mass 1 unless said otherwise and inertia k m r^2: 1/2 is solid, 1 a ring."""
    mass = body.pop("mass", 1.0)
    index = builder.add_body(position, mass=mass, inertia=k * mass * radius**2, **body)
    builder.add_disc(index, radius, friction=mu, restitution=restitution)
    return index


def simulation(
    builder: dc.ModelBuilder, dtype: str = "float64", acceleration: str = "adaptive", **settings: Any
) -> dc.Simulation:
    """Solved as far as the scalar allows; impacts bounce at any speed."""
    options: dict[str, Any] = {"tolerance": TOLERANCE[dtype], "max_sweeps": 5000, "restitution_threshold": 0.0}
    options |= {"acceleration": acceleration} | settings
    return dc.Simulation(*builder.finalize(dtype), config=dc.SolverConfig(**options))


def leftover(dtype: str, steps: int, scale: float, mass: float = 1.0) -> float:
    """What rounding and the stop of the solver leave of an exact closed form, in the unit of a velocity.

    Each step rounds some four times at the size ``scale`` and ends within 10 tolerances of its solution, as a
    Gauss-Seidel that contracts by .9 or better does; the sum over the steps is the worst case.
    """
    return steps * (4 * float(np.finfo(dtype).eps) * scale + 10 * TOLERANCE[dtype] / mass)


def creep(dtype: str, time: float, condition: float = 1.0) -> float:
    """How far something of 1 kg that stands may move in a time [s], in m: at the speed that a solve leaves.

    The next solve removes that speed, so it doesn't add up over the steps; ``condition`` multiplies it.
    """
    return time * condition * leftover(dtype, 1, 1.0)


def order(steps: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log error over log time step, by least squares over at least four.

    Raises:
        ValueError: for fewer than four time steps.
    """
    if len(steps) < 4:
        raise ValueError(f"{len(steps)} time steps; an order needs at least four")
    return float(np.polyfit(np.log(steps), np.log(np.abs(errors)), 1)[0])


def order_check(what: str, steps: Sequence[float], errors: Sequence[float], expected: float = 1.0) -> Check:
    """Whether the order of convergence is the one of the theory."""
    slope = order(steps, errors)
    return Check(f"order of {what} in dt is {slope:.3f}, off {expected:g}", abs(slope - expected), ORDER_OFF)


def near(what: str, value: Any, expected: Any, limit: float, sim: dc.Simulation | None = None) -> Check:
    """The largest absolute difference."""
    return Check(what, float(np.abs(np.asarray(value, float) - np.asarray(expected, float)).max()), limit, sim)


def relative(what: str, value: Any, expected: Any, limit: float, sim: dc.Simulation | None = None) -> Check:
    """The largest difference over the largest expected value."""
    expected = np.asarray(expected, float)
    return Check(what, float(np.abs(np.asarray(value, float) - expected).max() / np.abs(expected).max()), limit, sim)


def at_least(what: str, value: float, least: float, sim: dc.Simulation | None = None) -> Check:
    """For what has to move: the least over the value is at most one."""
    return Check(f"{what}: least over value", least / value if value > 0 else math.inf, 1.0, sim)


def record(sim: dc.Simulation, steps: int, dt: float, read: Callable[[dc.Simulation], Any]) -> np.ndarray:
    """What ``read`` gives after each step, (steps, ...)."""
    values: list[Any] = []
    sim.run(steps, dt, callback=lambda s: values.append(np.array(read(s), float)))
    return np.array(values)


def velocity(sim: dc.Simulation) -> np.ndarray:
    """v_x, v_y, w of each body, (bodies, 3) in float64."""
    return np.column_stack((sim.state.numpy("velocity"), sim.state.numpy("angular_velocity"))).astype(float)


def pose(sim: dc.Simulation) -> np.ndarray:
    """x, y, angle of each body, (bodies, 3) in float64."""
    return np.column_stack((sim.state.numpy("position"), sim.state.numpy("angle"))).astype(float)


def loads(sim: dc.Simulation, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal and tangential force (n, 2) [N] of the contacts, and their bodies A and B."""
    from dc_kernels import measure

    slots, _ = measure.contact_slots(sim.contacts)
    contacts = sim.contacts
    force = contacts.numpy("impulse")[slots].astype(float) / dt
    return force, contacts.numpy("body_a")[slots], contacts.numpy("body_b")[slots]
