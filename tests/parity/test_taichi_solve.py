"""Taichi's solver leaves the bits of Warp's with all settings: methods, accelerations, stops, schedules, pauses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.arrays import to_numpy
from dc_kernels.runtime.backends import make_kernels
from dc_kernels.solve.iteration import ASKEW, NEVER, Stretch
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR
from dc_kernels.solve.schedules import settings_of_solve
from tests.parity.scenes import boxes, discs, mixed, pendulum, simulation, worlds
from tests.parity.test_taichi import DT, Twin

Scene = Callable[[dc.ModelBuilder], None]


def jointed(builder: dc.ModelBuilder) -> None:
    """Joints, polygons, and a world with none of either."""
    for scene in (pendulum, boxes, mixed, worlds):
        scene(builder)


def twin_of(scene: Scene, dtype: str, steps: int = 12, **settings: Any) -> Twin:
    """A simulation within a step, and Taichi's kernels for it."""
    sim = simulation(scene, dtype, "warp", config=dc.SolverConfig(**{"tolerance": 0.0, **settings}))
    sim.run(steps, DT)
    sim.collide(DT)
    return Twin(sim)


def falling_tower(builder: dc.ModelBuilder) -> None:
    """Discs one on the other that hit a floor, from which the shock goes up by one of them a sweep at most."""
    builder.add_world()
    builder.add_disc(builder.add_body((0.0, -50.0), type=dc.BodyType.STATIC), 50.0)
    for k in range(12):
        builder.add_disc(builder.add_body((0.0, k + 0.5), velocity=(0.0, -5.0)), 0.5)


CASES: dict[str, tuple[Scene, str, dict[str, Any]]] = {
    "plain": (jointed, "float32", {"acceleration": "none", "max_sweeps": 11, "history": True}),
    "sor": (jointed, "float64", {"acceleration": "sor", "max_sweeps": 11, "position_correction": "baumgarte"}),
    "nncg": (jointed, "float32", {"acceleration": "nncg", "max_sweeps": 30}),
    "aitken": (jointed, "float64", {"acceleration": "aitken", "max_sweeps": 40, "start": "zero"}),
    "impatient": (
        jointed,
        "float32",
        {"acceleration": "aitken", "max_sweeps": 60, "aitken_patience": 1, "aitken_period_max": 4},
    ),
    "converges": (jointed, "float32", {"tolerance": 1e-4, "max_sweeps": 600, "history": True}),
    "residual": (jointed, "float32", {"stop": "residual", "tolerance": 1e-3, "residual_every": 3, "max_sweeps": 90}),
    "jacobi": (jointed, "float64", {"method": "jacobi", "acceleration": "none", "max_sweeps": 20}),
    "jacobi nncg": (jointed, "float32", {"method": "jacobi", "acceleration": "nncg", "max_sweeps": 20}),
    "no sweeps": (jointed, "float32", {"max_sweeps": 0}),
    "discs jacobi": (discs, "float32", {"method": "jacobi", "max_sweeps": 33, "stretch": 10}),
    "discs nncg": (discs, "float64", {"acceleration": "nncg", "max_sweeps": 33}),
    "general": (mixed, "float32", {"max_sweeps": 70, "stretch": 10}),
    "askew": (
        falling_tower,
        "float32",
        {"start": "zero", "stop": "motion", "motion_tolerance": 1e9, "min_sweeps": 1, "residual_every": 1},
    ),
}


@pytest.mark.parametrize("case", list(CASES))
def test_a_solve_has_the_bits_of_warp(case: str) -> None:
    scene, dtype, settings = CASES[case]
    twin = twin_of(scene, dtype, **settings)
    for name in ("pack_rows", "solve_world", "unpack_impulses", "displace", "correct_positions"):
        twin.run(name)
    sweeps = twin.sim.stats.numpy("sweeps")
    assert case in ("converges", "residual", "askew") or sweeps.max() == settings["max_sweeps"]
    if case == "askew":  # any change counts as none, but the residual that is left after the first sweeps says to go on
        assert 1 < sweeps.max() < 1000 and (twin.sim.stats.numpy("residual") < ASKEW).all()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_method_of_the_adaptive_acceleration_has_the_bits_of_warp(dtype: str) -> None:
    twin = twin_of(jointed, dtype, max_sweeps=300, stretch=10)
    twin.run("solve_world")
    iteration = twin.sim.stats.numpy("iteration")
    assert (iteration["rate"] < 1e9).any(axis=0).tolist() == [True] * len(Stretch)
    assert (iteration["products"] != 0).any()


@pytest.mark.parametrize(
    ("dtype", "settings"),
    [
        ("float32", {"acceleration": "aitken", "max_sweeps": 7}),
        ("float32", {"method": "jacobi", "acceleration": "nncg", "max_sweeps": 3}),
        ("float32", {"max_sweeps": 14, "stretch": 10}),
    ],
)
def test_the_colour_schedule_has_the_bits_of_warp(dtype: str, settings: dict[str, Any]) -> None:
    twin = twin_of(jointed, dtype, **settings)
    rows = twin.sim.rows
    ends = rows.numpy("color_block").reshape(-1, COLORS + 1)
    widest = np.diff(ends, axis=1).max(axis=0) * LANES
    twin.run("begin")
    for _ in range(settings["max_sweeps"]):
        twin.run("before_sweep")
        for color in np.flatnonzero(widest):
            width = 1 if color == SERIAL_COLOR else int(widest[color])
            twin.run("sweep_color", (len(ends), width), color=int(color))
        twin.run("after_sweep")
    twin.run("finish")
    assert (twin.sim.stats.numpy("iteration")["finished"] == 1).all()


@pytest.mark.parametrize("acceleration", ["none", "aitken", "nncg"])
@pytest.mark.parametrize("replaced", [False, True])
def test_a_solve_that_pauses_has_the_bits_of_warp(acceleration: str, replaced: bool) -> None:
    twin = twin_of(jointed, "float32", acceleration=acceleration, max_sweeps=40)
    sim = twin.sim
    start = sim.contacts.numpy("impulse").copy()
    pauses = (0, 3, 4, 5, NEVER)
    for i, pause in enumerate(pauses):
        changed = settings_of_solve(sim.config, pause, resume=i > 0)
        values = sim.launch_values(0, changed)
        if replaced and i == 2:
            sim.contacts.numpy("impulse")[...] = 0.5 * start
            sim.stats.numpy("replaced")[...] = 1
        twin.run("solve_world", launch=values["launch"], config=values["config"])
        assert sim.running.any() == (pause != NEVER)
    assert sim.stats.numpy("sweeps").max() == 40


def test_rows_of_the_serial_colour_have_the_bits_of_warp() -> None:
    twin = twin_of(jointed, "float32", max_sweeps=13)
    sim = twin.sim
    color = to_numpy(sim.contacts.array("color"))
    color[color == 1] = SERIAL_COLOR
    for name in ("pack_rows", "solve_world", "unpack_impulses", "displace", "correct_positions"):
        twin.run(name)
    ends = sim.rows.numpy("color_block").reshape(-1, COLORS + 1)
    assert (ends[:, COLORS] > ends[:, SERIAL_COLOR]).sum() > 2


def test_a_method_that_grows_without_end_is_left_with_the_bits_of_warp() -> None:
    def far_hit(builder: dc.ModelBuilder) -> None:
        """A hexagon that hits a wall of tiles from afar (tests/solve/test_adaptive.py)."""
        builder.add_world(gravity=(0, 0))
        wall = builder.add_body(type=dc.BodyType.STATIC)
        for k in range(-12, 13):
            builder.add_box(wall, 0.01, 0.25, center=(0.0, 0.5 * k))
        at = (-5.546689294038405, -0.3143702183382114)
        hexagon = builder.add_body(at, angle=5.712495303330157, velocity=(400.0, 0.0))
        turns = np.arange(6) * np.pi / 3
        builder.add_polygon(hexagon, 0.3 * np.stack((np.cos(turns), np.sin(turns)), axis=1))

    sim = simulation(far_hit, "float32", "warp", config=dc.SolverConfig.preset("accurate"))
    sim.collide(1 / 60)
    Twin(sim).run("solve_world")
    assert (sim.stats.numpy("iteration")["rate"] <= -1e9).any()


@pytest.mark.parametrize(
    "settings",
    [{}, {"method": "jacobi", "acceleration": "none"}, {"acceleration": "nncg", "stop": "residual", "tolerance": 0.0}],
)
def test_rows_of_a_callers_own_jacobians_have_the_bits_of_warp(settings: dict[str, Any]) -> None:
    """In float64, whose kernels ``solve/test_own_rows.py`` compiles too."""
    draw = np.random.default_rng(3)
    contacts, own, count = 60, 50, 30
    pairs = draw.permuted(np.tile(np.arange(count, dtype=np.int32), (contacts + own + 5, 1)), axis=1)[:, :2]
    a, b = np.ascontiguousarray(pairs.T)
    normal = draw.normal(size=(contacts, 2))
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    def real(*shape: int) -> np.ndarray:
        return draw.normal(size=shape)

    rows = {
        "row_body_a": a[contacts : contacts + own].copy(),
        "row_body_b": b[contacts : contacts + own].copy(),
        "row_jacobian_a": real(own, 3),
        "row_jacobian_b": real(own, 3),
        "row_bias": real(own),
        "row_lower": np.where(np.arange(own) % 3, -abs(real(own)), -np.inf),
        "row_upper": np.where(np.arange(own) % 2, abs(real(own)), np.inf),
        "row_softness": np.where(np.arange(own) % 5, 0.0, 0.3),
        "row_impulse": real(own),
    }
    joints = {
        "joint_body_a": a[contacts + own :].copy(),
        "joint_body_b": b[contacts + own :].copy(),
        "joint_anchor_a": real(5, 2),
        "joint_anchor_b": real(5, 2),
        "joint_length": abs(real(5)) + 0.1,
    }
    solver = dc.ContactSolver(
        body_a=a[:contacts].copy(),
        body_b=b[:contacts].copy(),
        point=None,
        normal=normal,
        gap=0.01 * real(contacts),
        arm_a=real(contacts, 2),
        arm_b=real(contacts, 2),
        friction=0.5,
        inv_mass=np.where(np.arange(count) < 3, 0.0, 1.0),
        inv_inertia=np.where(np.arange(count) < 3, 0.0, 2.0),
        position=real(count, 2),
        angle=real(count),
        velocity=real(count, 2),
        angular_velocity=real(count),
        joints=joints,
        rows=rows,
        config=dc.SolverConfig(**{"max_sweeps": 30, **settings}),
    )
    solver.pack(DT)
    assert solver.variant == "rows"
    twin = object.__new__(Twin)
    twin.sim, twin.kernels = solver, {}  # type: ignore[assignment]
    for file in ("solve.pack", "solve.schedules"):
        twin.kernels |= make_kernels("taichi", file, "float64", "rows")
    for name in ("pack_rows", "solve_world", "unpack_impulses"):
        twin.run(name)
    assert solver.stats.numpy("sweeps")[0] > 9
    assert (solver.rows.numpy("row_impulse") != 0.0).sum() > 30
    twin.run("correct_positions")
