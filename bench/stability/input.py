"""Input that makes no sense, worlds that blow up, room that runs out, and worlds with nothing to do."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.cases import DT
from bench.stability.invariants import contact_table
from bench.verdicts import Cases, Check

cases = Cases()
NAN, INF = math.nan, math.inf
DTYPES = ("float32", "float64")
SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
STATE = ("position", "angle", "velocity", "angular_velocity")

# method of the builder, arguments, what the message has to name
REFUSED: list[tuple[str, tuple[Any, ...], dict[str, Any], str]] = [
    ("add_world", (), {"gravity": (0.0, INF)}, "gravity[1] of world 1"),
    ("add_world", (), {"gravity": (NAN, 0.0)}, "gravity[0] of world 1"),
    ("add_world", (), {"length_scale": 0.0}, "length_scale of world 1"),
    ("add_body", ((NAN, 0.0),), {}, "position[0] of body 2"),
    ("add_body", (), {"mass": 0.0}, "mass of body 2"),
    ("add_body", (), {"mass": -1.0}, "mass of body 2"),
    ("add_body", (), {"inertia": -1.0}, "inertia of body 2"),
    ("add_body", (), {"velocity": (0.0, NAN)}, "velocity[1] of body 2"),
    ("add_body", (), {"angle": INF}, "angle of body 2"),
    ("add_disc", (0, 0.0), {}, "radius of shape 1"),
    ("add_disc", (0, -1.0), {}, "radius of shape 1"),
    ("add_disc", (0, NAN), {}, "radius of shape 1"),
    ("add_disc", (0, 1.0), {"density": -1.0}, "density of shape 1"),
    ("add_disc", (0, 1.0), {"friction": NAN}, "friction of shape 1"),
    ("add_disc", (0, 1.0), {"restitution": 1.5}, "restitution of shape 1"),
    ("add_box", (0, 0.0, 1.0), {}, "half_width of shape 1"),
    ("add_box", (0, 1.0, 1e-9), {}, "corners of shape 1"),
    ("add_capsule", (0, (1.0, 1.0), (1.0, 1.0), 0.1), {}, "p1 and p2 of shape 1"),
    ("add_polygon", (0, ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))), {}, "vertices of shape 1"),
    ("add_polygon", (0, ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))), {}, "vertices of shape 1"),
    ("add_polygon", (0, ((0.0, 0.0), (2.0, 0.0), (1.0, 0.5), (1.0, 2.0))), {}, "vertices of shape 1"),
    ("add_polygon", (0, ((0.0, 0.0), (1.0, 0.0), (0.0, NAN))), {}, "vertices of shape 1[2, 1]"),
    ("add_chain", (1, ((0.0, 0.0), (0.0, 0.0))), {}, "vertices of shape 1"),
    ("add_distance_joint", (0, 0), {}, "body_a and body_b of joint 0"),
    ("add_distance_joint", (0, 1), {"length": -1.0}, "length of joint 0"),
    ("add_discs", (((0.0, 0.0), (0.0, NAN)), 1.0), {}, "positions[1, 1]"),
    ("add_discs", (((0.0, 0.0), (1.0, 0.0)), (1.0, 0.0)), {}, "radius[1]"),
]
TIME_STEPS = (0.0, -0.01, NAN, INF, -INF, 1e-320)


def refused(call: Callable[[], Any], name: str) -> bool:
    """Whether a call raises a ValueError that names the field."""
    try:
        call()
    except ValueError as error:
        return name in str(error)
    return False


@cases.add
def senseless_input(quick: bool) -> Iterator[Check]:
    """Zero, negative, NaN, inf and degenerate input is refused by a ValueError that names field and index.

    Vertices in clockwise order are not wrong: they make the same body.
    """
    missed = 0
    for method, arguments, options, name in REFUSED:
        builder = dc.ModelBuilder()
        builder.add_world()
        builder.add_disc(builder.add_body(), 0.5)
        builder.add_body(type=dc.BodyType.STATIC)
        missed += not refused(functools.partial(getattr(builder, method), *arguments, **options), name)
    yield Check(f"of {len(REFUSED)} senseless arguments, not refused by name [1]", missed, 0.0)
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body(), 0.5, density=0.0)
    yield Check("a dynamic body of density 0, not refused [1]", not refused(builder.finalize, "mass of body 0"), 0.0)
    sim = pile("float32")
    before = state_bits(sim, range(3))
    missed = sum(not refused(functools.partial(sim.run, 3, dt), "dt is") for dt in TIME_STEPS)
    yield Check(f"of {len(TIME_STEPS)} senseless time steps, not refused [1]", missed, 0.0)
    yield Check("bits that they changed [1]", state_bits(sim, range(3)) != before, 0.0)
    masses = []
    for corners in (SQUARE, SQUARE[::-1]):
        builder = dc.ModelBuilder()
        builder.add_world()
        builder.add_polygon(builder.add_body(), corners)
        model = builder.finalize("float64")[0]
        masses.append((model.numpy("mass")[0], model.numpy("inertia")[0], *model.numpy("center_of_mass")[0]))
    yield Check("clockwise square: mass, inertia and centre off [kg, m]", np.abs(np.diff(masses, axis=0)).max(), 1e-12)


def pile(dtype: str, worlds: int = 3, **options: Any) -> dc.Simulation:
    """Discs, boxes and capsules that fall into a box, in several worlds."""
    builder = dc.ModelBuilder()
    for seed in range(worlds):
        draw = np.random.default_rng(seed)
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, ((-2.0, 4.0), (-2.0, 0.0), (2.0, 0.0), (2.0, 4.0)))
        for i in range(16):
            body = builder.add_body((-1.4 + 0.9 * (i % 4), 0.4 + 0.7 * (i // 4)), angle=draw.uniform(-3.0, 3.0))
            if i % 3 == 0:
                builder.add_disc(body, 0.3)
            elif i % 3 == 1:
                builder.add_box(body, 0.3, 0.15)
            else:
                builder.add_capsule(body, (-0.15, 0.0), (0.15, 0.0), 0.15)
    return dc.Simulation(*builder.finalize(dtype), **options)


def state_bits(sim: dc.Simulation, worlds: Any, contacts: bool = True) -> list[bytes]:
    """State, and contacts, of some worlds as bytes; -0 counts as 0."""
    table, found = contact_table(sim), []
    for w in worlds:
        first, last = sim.model.numpy("body_start")[w : w + 2]
        arrays = [sim.state.numpy(name)[first:last] for name in STATE] + [sim.state.numpy("time")[w : w + 1]]
        if contacts:
            arrays += [table[name][table["world"] == w] for name in ("key", "impulse", "gap")]
        found += [(a + np.zeros(1, a.dtype)).tobytes() for a in arrays]
    return found


@cases.add
def not_finite(quick: bool) -> Iterator[Check]:
    """NaN or inf written into any array of the state in mid-run: its world is flagged NONFINITE and keeps its state.

    The other worlds go on with the bits that they have without it.
    """
    for dtype in ("float32",) if quick else DTYPES:
        wrong, runs, sim = 0, 0, None
        reference = pile(dtype)
        reference.run(60, DT)
        for name in (*STATE, "force", "torque"):
            for value in (NAN, INF, -INF):
                sim = pile(dtype)
                sim.run(30, DT)
                sim.state.numpy(name)[int(sim.model.numpy("body_start")[1]) + 3] = value
                frozen = state_bits(sim, [1], contacts=False)
                sim.run(30, DT)
                runs += 1
                flagged = sim.state.numpy("flags").tolist() == [0, int(dc.Flag.NONFINITE), 0]
                kept = state_bits(sim, [1], contacts=False) == frozen
                others = state_bits(sim, [0, 2]) == state_bits(reference, [0, 2])
                wrong += not (flagged and kept and others)
        yield Check(f"of {runs} values, {dtype}: not flagged, or bits changed [1]", wrong, 0.0, sim)
        fast = pile(dtype)
        fast.state.numpy("velocity")[int(fast.model.numpy("body_start")[1]) + 3] = np.finfo(dtype).max / 2
        fast.run(60, DT)
        finite = all(np.isfinite(fast.state.numpy(name)).all() for name in STATE)
        same = state_bits(fast, [0, 2]) == state_bits(reference, [0, 2])
        yield Check(
            f"speed of half the largest number, {dtype}: state not finite or others changed", not (finite and same), 0.0
        )


@cases.add
def overflow(quick: bool) -> Iterator[Check]:
    """Room for no pair and no contact at first: it grows, and ends with the bits of a run that had all it needed."""
    for dtype in DTYPES:
        for options in ({}, {"threads": 2}) if quick else ({}, {"threads": 2}, {"schedule": "color"}):
            ample = pile(dtype, pairs_per_shape=60.0, contacts_per_body=60.0)
            tight = pile(dtype, pairs_per_shape=0.0, contacts_per_body=0.0, **options)
            room = {name: use["reserved"] for name, use in ample.capacity().items()}
            for sim in (ample, tight):
                sim.run(60 if quick else 300, DT)
            differ = state_bits(tight, range(3)) != state_bits(ample, range(3))
            grown = room != {name: use["reserved"] for name, use in ample.capacity().items()}
            what = ", ".join(f"{name} {value}" for name, value in options.items()) or "one thread"
            yield Check(f"{dtype}, {what}: bits differ, or the ample one grew [1]", differ or grown, 0.0, tight)


@cases.add
def nothing_to_do(quick: bool) -> Iterator[Check]:
    """Worlds without bodies, of static bodies, of kinematic ones (which pass through each other), beside a full one."""
    for dtype in DTYPES:
        for schedule in ("world", "color"):
            builder = dc.ModelBuilder()
            builder.add_world()
            builder.add_world()
            for x in (0.0, 0.5):
                builder.add_box(builder.add_body((x, 0.0), type=dc.BodyType.STATIC), 1.0, 1.0)
            builder.add_world()
            for x in (-3.0, 3.0):
                body = builder.add_body((x, 0.0), velocity=(-x, 0.0), angular_velocity=1.0, type=dc.BodyType.KINEMATIC)
                builder.add_box(body, 1.0, 1.0)
            builder.add_world()
            builder.add_disc(builder.add_body((0.0, 5.0)), 0.5)
            sim = dc.Simulation(*builder.finalize(dtype), schedule=schedule)  # type: ignore[arg-type]
            sim.run(200, DT)
            found = (sim.stats.numpy("sweeps"), sim.contacts.numpy("contact_count"), sim.state.numpy("flags"))
            busy = any(values.any() for values in found)
            yield Check(f"{dtype}, schedule {schedule}: flags, sweeps or contacts [1]", busy, 0.0)
            position = sim.state.numpy("position")
            # two static bodies; kinematic ones after 2 s at +-3 m/s; free fall of semi-implicit Euler
            fall = 5.0 - 9.8 * DT * DT * 200 * 201 / 2
            expected = np.array([(0.0, 0.0), (0.5, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, fall)])
            bound = {"float32": 1e-4, "float64": 1e-11}[dtype]
            yield Check(f"{dtype}, schedule {schedule}: way off [m]", np.abs(position - expected).max(), bound, sim)
            time = float(np.abs(sim.state.numpy("time") - 200 * DT).max())
            yield Check(f"{dtype}, schedule {schedule}: time off [s]", time, 1e-6)
