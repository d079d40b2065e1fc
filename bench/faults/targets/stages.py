"""Stages for other engines, and the calls that drive a simulation, and what each argument may be: for ``calls``."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bench.faults.targets.simulations import Backend, Target, always, builder, simulation
from bench.faults.values import HUGE, Array, Given, TimeStep
from dc_kernels.model.settings import Count, NotNegative, Positive, Whole

INT = np.int32
ROOM = Given("12", "", True, 2.5, math.nan, -1, 2**31, [1, -1], np.array([0.5]), np.zeros((1, 1), INT), lambda: 1)
"""Room of each world, or a number for all."""
SCALE = Given("12", "", math.nan, math.inf, -1.0, 10**400, np.ones(5, np.float32), lambda: 1)
"""A number >= 0, or one for each world."""
NUMBER = Given(*SCALE.values, None, True, np.ones(1, INT))
"""A number >= 0, or one for each contact, an array of float32."""
OWNERS = Array(2, whole=True, optional=True)
BITS = Array(2, whole=True, optional=True, ranged=False)
WORLDS = Given("0", 0.5, math.nan, [0.0], [1], [-2], [True, False], np.zeros((1, 1), INT), lambda: 1, *HUGE)


def stage_targets() -> Iterator[Target]:
    """Boxes, pairs and contacts of shapes, pairs of points, colours."""
    import dc_kernels as dc

    corner = np.array([[0.0, 0.0], [0.5, 0.0]], np.float32)
    threads: dict[str, Any] = {"threads": Count}
    start: Any = Array(2, whole=True, optional=True)

    def boxes() -> dict[str, Any]:
        return {"lower": corner.copy(), "upper": corner + np.float32(1.0)}

    filters: dict[str, Any] = {"shape_body": OWNERS, "body_type": OWNERS, "category": BITS, "mask": BITS}
    pairs: dict[str, Any] = {
        "lower": Array(2, 2),
        "upper": Array(2, 2),
        "start": start,
        "margin": NotNegative,
        "max_pairs": ROOM,
    }
    yield Target("Broadphase", called(dc.Broadphase), boxes, {**pairs, **threads, "backend": Backend, **filters})

    shape = {
        "shape_type": np.zeros(2, INT),
        "shape_radius": np.full(2, 0.5, np.float32),
        "vertex_start": np.arange(3, dtype=INT),
        "vertices": np.zeros((2, 2), np.float32),
    }

    def placed() -> dict[str, Any]:
        return {"shapes": dict(shape), "position": corner.copy(), "angle": np.zeros(2, np.float32)}

    where: dict[str, Any] = {"position": Array(2, 2), "angle": Array(2), **threads, "backend": Backend | None}
    yield Target("ShapeBoxes", called(dc.ShapeBoxes), placed, {"shapes": dc.Model, **where, "margin": NotNegative})
    rows = {"pairs": np.array([[0, 1]], INT)}
    yield Target(
        "Narrowphase",
        called(dc.Narrowphase),
        lambda: {**placed(), **rows},
        {"shapes": dc.Model, **where, "pairs": Array(1, 2, whole=True), "pair_start": start}
        | {"pair_count": Array(1, whole=True, optional=True), "reach": float, "max_contacts": ROOM},
    )

    def shapes_of(name: str) -> Callable[[], Callable[..., Any]]:
        return lambda: lambda **values: dc.ShapeBoxes(**{**placed(), "shapes": {**shape, **values}})

    kinds: dict[str, Any] = {"shape_type": Array(2, whole=True), "vertex_start": Array(3, whole=True)}
    kinds |= {"shape_radius": Array(2), "vertices": Array(2, 2)}
    for name, hint in kinds.items():
        yield Target(f"shapes.{name}", shapes_of(name), dict, {name: hint})
    points = np.random.default_rng(0).random((4, 2)).astype(np.float32)
    yield Target(
        "NeighborSearch()",
        called(dc.NeighborSearch),
        lambda: {"points": points.copy(), "radius": 0.1},
        {"points": Array(4, 2), "radius": Positive, "start": start, "max_pairs": ROOM, "backend": Backend},
    )
    chain = {"body_a": np.array([0, 1], INT), "body_b": np.array([1, 2], INT), "movable": np.ones(3)}
    yield Target(
        "color",
        lambda: dc.color,
        lambda: dict(chain),
        {"body_a": Array(2, whole=True), "body_b": Array(2, whole=True), "movable": Array(3, strict=False, fixed=False)}
        | {"color": BITS, "body_start": start, "contact_start": start, "backend": Backend},
    )


def called(stage: Callable[..., Any]) -> Callable[[], Callable[..., Any]]:
    """What makes a stage and calls it."""
    return lambda: lambda **arguments: stage(**arguments)()


def solver_targets() -> Iterator[Target]:
    """``ContactSolver``, and the problem that it is in Delassus form."""
    import dc_kernels as dc
    from dc_kernels import delassus

    real = np.float32

    def contact() -> dict[str, Any]:
        return {
            "body_a": np.zeros(1, INT),
            "body_b": np.ones(1, INT),
            "point": np.zeros((1, 2), real),
            "normal": np.array([[0.0, 1.0]], real),
            "gap": np.zeros(1, real),
            "inv_mass": np.array([0.0, 0.5], real),
            "inv_inertia": np.zeros(2, real),
            "position": np.zeros((2, 2), real),
            "velocity": np.array([[0.0, 0.0], [1.5, -2.0]], real),
            "angular_velocity": np.zeros(2, real),
            "impulse": np.zeros((1, 2), real),
        }

    start: Any = Array(2, whole=True, optional=True)
    touch: dict[str, Any] = {"body_a": Array(1, whole=True), "body_b": Array(1, whole=True), "point": Array(1, 2)}
    touch |= {"normal": Array(1, 2), "gap": Array(1), "friction": NUMBER, "restitution": NUMBER}
    masses: dict[str, Any] = {"inv_mass": Array(2), "inv_inertia": Array(2), "position": Array(2, 2)}
    moves: dict[str, Any] = {
        "velocity": Array(2, 2),
        "angular_velocity": Array(2),
        "impulse": Array(1, 2, optional=True),
    }
    known: dict[str, Any] = {
        "count": Array(1, whole=True, optional=True),
        "color": Array(1, whole=True, optional=True, ranged=False),
    }
    starts: dict[str, Any] = {"body_start": start, "contact_start": start, "joint_start": start}
    scales: dict[str, Any] = {"length_scale": SCALE, "weight": SCALE, "gravity": SCALE}
    options: dict[str, Any] = {
        "discs": bool,
        "config": dc.SolverConfig | None,
        "threads": Count,
        "schedule": Given("none", 1, None),
    }
    given: dict[str, Any] = {**touch, **masses, **moves, **known, **starts, **scales, **options, "backend": Backend}
    before = {"velocity_before": Array(2, 2, optional=True), "angular_velocity_before": Array(2, optional=True)}
    arms: dict[str, Any] = {
        "angle": Array(2, optional=True, finite=False),
        "joints": Given("12", 3, [1], {"joint": 1}, {1: 2}),
    }
    arms |= {name: Array(1, 2, optional=True) for name in ("arm_a", "arm_b")}
    arms |= {"rows": Given("12", 3, [1], {"row": 1}, {1: 2}), "row_start": Array(2, whole=True, optional=True)}
    given |= {**before, **arms}
    names: dict[str, tuple[str, ...]] = {"normal": ("inv_mass",), "point": ("arm_a",)}

    def solver() -> Callable[..., Any]:
        return lambda **arguments: dc.ContactSolver(**arguments).solve(0.01)

    yield Target("ContactSolver", always(solver()), contact, given, names)
    yield Target(
        "ContactSolver.solve",
        lambda: dc.ContactSolver(**contact()).solve,
        lambda: {"dt": 0.01},
        {"dt": TimeStep, "kept": bool, "config": dc.SolverConfig | None}
        | {**before, **{name: Array(*hint.shape, optional=True) for name, hint in moves.items()}},
    )
    joint = {
        "joint_body_a": np.zeros(1, INT),
        "joint_body_b": np.ones(1, INT),
        "joint_anchor_a": np.zeros((1, 2), real),
        "joint_anchor_b": np.zeros((1, 2), real),
        "joint_length": np.ones(1, real),
    }

    def jointed() -> Callable[..., Any]:
        ends: dict[str, Any] = {"angle": np.zeros(2, real)}
        return lambda **lines: dc.ContactSolver(**contact(), **ends, joints={**joint, **lines}).solve(0.01)

    lines: dict[str, Any] = {"joint_body_a": Array(1, whole=True), "joint_body_b": Array(1, whole=True)}
    lines |= {"joint_anchor_a": Array(1, 2), "joint_anchor_b": Array(1, 2), "joint_length": Array(1)}
    lines["joint_impulse"] = Array(1, optional=True)
    yield Target("ContactSolver.joints", jointed, dict, lines)
    yield Target(
        "from_contacts",
        lambda: delassus.from_contacts,
        lambda: {**contact(), "dt": 0.01},
        {**touch, **masses, "dt": TimeStep, "world": Whole},
        names,
    )


def driving_targets() -> Iterator[Target]:
    """What a program that drives a simulation asks of it."""
    import dc_kernels as dc

    sim = simulation
    state: dict[str, Any] = {
        "position": Array(2, 2, strict=False),
        "angle": Array(2, strict=False),
        "time": Array(1, strict=False),
    }
    wrong = Given("12", 3, [1], {"speed": 1.0}, {1: 2}, {"time": "12"}, builder().finalize()[0])
    yield Target("reset", lambda: sim().reset, dict, {"worlds": WORLDS, "state": wrong})
    for name, hint in state.items():

        def reset() -> Callable[..., Any]:
            made = sim()
            return lambda **values: made.reset(None, values)

        yield Target(f"reset.{name}", reset, dict, {name: hint})
    for function in (dc.contact_forces, dc.net_contact_forces, dc.joint_forces, dc.ContactEvents):
        yield Target(function.__name__, always(function), lambda: {"sim": sim()}, {"sim": dc.Simulation})
    changes: dict[str, Any] = {
        name: Given(*SCALE.values, None, True) for name in ("shape_friction", "shape_restitution", "mass", "inertia")
    }
    changes |= {"gravity": Array(1, 2, strict=False), "body_type": Given("2", None, True, 3, -1, 0.5, [0, 7])}
    yield Target("change_model", lambda: sim().change_model, dict, changes, {"inertia": ("inv_inertia",)})

    def writer(group: str, name: str) -> Callable[[], Callable[..., Any]]:
        def make() -> Callable[..., Any]:
            made = getattr(sim(), group)
            return lambda **values: made.assign(name, values[name])

        return make

    for name in ("position", "angle", "velocity", "force"):
        values = sim().state.numpy(name).copy()
        hint = Array(*values.shape, strict=False)
        yield Target(f"assign.{name}", writer("state", name), functools.partial(dict, **{name: values}), {name: hint})
    restored = {"count": [0], "contact_dt": [0.0]}
    empty = {name: np.zeros((0, 2) if name == "impulse" else 0) for name in ("key", "impulse", "color", "age")}

    def restore() -> Callable[..., Any]:
        made = sim()
        return lambda count, contact_dt: made.restore_contacts(count, empty, contact_dt)

    yield Target(
        "restore_contacts",
        restore,
        lambda: dict(restored),
        {"count": Array(1, whole=True, strict=False), "contact_dt": Given("1", None, [math.nan], [-1.0], [1e-40])},
        {"count": ("contact_count",)},
    )
    whole = {"count": np.zeros(1, INT), "arrays": empty, "contact_dt": np.zeros(1, np.float32)}
    less = [{name: empty[name] for name in empty if name != missing} for missing in empty]
    yield Target(
        "restore_contacts",
        lambda: sim().restore_contacts,
        lambda: dict(whole),
        {"arrays": Given("12", 3, None, [1], {}, {1: 2}, *less, {**empty, "key": "12"}, {**empty, "age": None})},
        {"arrays": tuple(empty)},
    )
