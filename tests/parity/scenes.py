"""Scenes that every backend is run on: one or two of each kind of thing that a step does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.model.room import used_slots

SCRATCH = {
    "bucket",
    "cell",
    "sorted_shape",
    "sorted_box",
    "left",
    "temp_a",
    "temp_b",
    "turn",
    "kept_rebuilds",
    "kept_side",
    "kept_count",
    "kept_a",
    "kept_b",
    "kept_edges",
    "kept_frame",
    "kept_bound",
    "color_mask",
    "parent",
    "island_time",
    "tree_factor",
    "tree_wanted",
    "tree_moves",
}
"""Arrays that a kernel leaves in a state of its own."""
COUNTED = {"shape_a": "count", "shape_b": "count", "near_a": "near_count", "near_b": "near_count"}


def in_use(field: str, array: np.ndarray, pairs: Any) -> np.ndarray:
    """What an array holds that says something: behind the last pair of each world there may be anything."""
    if field not in COUNTED:
        return array
    return array[used_slots(pairs.numpy("start"), pairs.numpy(COUNTED[field]))]


def add_ground(builder: dc.ModelBuilder, width: float = 6.0, wall: bool = True) -> None:
    """A floor at y = 0, with walls."""
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(ground, width, 0.5, center=(0.0, -0.5), friction=0.6)
    if wall:
        builder.add_box(ground, 0.5, 3.0, center=(-width / 2 - 0.5, 3.0))
        builder.add_box(ground, 0.5, 3.0, center=(width / 2 + 0.5, 3.0))


def discs(builder: dc.ModelBuilder, columns: int = 4, rows: int = 5, friction: float = 0.4) -> None:
    """Discs of two sizes that fall into a box and pile up."""
    builder.add_world()
    add_ground(builder, width=columns * 1.02)
    draw = np.random.default_rng(7)
    for i in range(rows):
        for j in range(columns):
            at = (j - 0.5 * (columns - 1) + draw.uniform(-0.02, 0.02), 0.52 + 1.01 * i)
            body = builder.add_body(position=at, velocity=(draw.uniform(-1, 1), -1.0), angular_velocity=draw.normal())
            builder.add_disc(body, draw.choice([0.4, 0.5]), friction=friction)


def mixed(builder: dc.ModelBuilder) -> None:
    """Polygons, capsules, discs off their centre and a chain as the ground; all of them turn."""
    builder.add_world(origin=(3.0, -2.0))
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(-3.1, 3.0), (-2.9, 0.1), (-1.0, 0.0), (0.3, -0.2), (1.5, 0.1), (3.2, 0.0), (3.3, 3.0)])
    draw = np.random.default_rng(3)
    for i in range(12):
        body = builder.add_body(
            position=(-2.1 + 1.4 * (i % 4), 0.75 + 1.0 * (i // 4)),
            angle=draw.uniform(-3, 3),
            velocity=(draw.uniform(-1, 1), -2.0),
            angular_velocity=draw.uniform(-2, 2),
        )
        if i % 4 == 0:
            builder.add_box(body, 0.4, 0.3, friction=0.7)
        elif i % 4 == 1:
            builder.add_capsule(body, (-0.3, 0.0), (0.3, 0.1), 0.2)
        elif i % 4 == 2:
            builder.add_polygon(body, [(-0.4, -0.3), (0.4, -0.3), (0.5, 0.1), (0.0, 0.5)], radius=0.05)
        else:
            builder.add_disc(body, 0.25, center=(-0.2, 0.0))
            builder.add_disc(body, 0.2, center=(0.25, 0.1), density=2.0)


def boxes(builder: dc.ModelBuilder) -> None:
    """A stack of boxes."""
    builder.add_world()
    add_ground(builder, wall=False)
    for i in range(5):
        body = builder.add_body(position=(0.04 * i, 0.5 + 1.001 * i), angle=0.001 * i)
        builder.add_box(body, 0.6 - 0.03 * i, 0.5)


def pendulum(builder: dc.ModelBuilder) -> None:
    """A chain of joints with a heavy end that swings against blocks."""
    builder.add_world()
    add_ground(builder)
    hook = builder.add_body(position=(0.0, 4.0), type=dc.BodyType.STATIC)
    before = hook
    for i in range(5):
        link = builder.add_body(position=(0.5 + 0.5 * i, 4.0 - 0.05 * i), angle=0.1 * i)
        builder.add_capsule(link, (-0.15, 0.0), (0.15, 0.0), 0.05)
        builder.add_distance_joint(
            before, link, (0.0, 0.0) if before == hook else (0.2, 0.0), (-0.2, 0.0), 0.3 if i % 2 else None
        )
        before = link
    weight = builder.add_body(position=(3.1, 3.4))
    builder.add_disc(weight, 0.3, density=5.0)
    builder.add_distance_joint(before, weight, (0.2, 0.0), (0.0, 0.25))
    for i in range(2):
        builder.add_box(builder.add_body(position=(2.3, 0.3 + 0.6 * i), angle=0.02), 0.3, 0.3)
    builder.add_disc(builder.add_body(position=(2.9 - 1.2, 0.2)), 0.2)


def bounce(builder: dc.ModelBuilder) -> None:
    """Bouncing discs and a bouncing box, without friction."""
    builder.add_world()
    add_ground(builder, width=4.0)
    for i in range(5):
        body = builder.add_body(position=(-1.6 + 0.8 * i, 0.46 + 0.1 * i), velocity=(2.0 - i, -5.0))
        builder.add_disc(body, 0.35, restitution=0.2 * i, friction=0.0)
    box = builder.add_body(position=(0.3, 1.6), velocity=(0.0, -6.0), angle=0.2)
    builder.add_box(box, 0.3, 0.2, restitution=0.8, friction=0.0)


def kinematic(builder: dc.ModelBuilder) -> None:
    """A kinematic paddle that turns among discs, and forces."""
    builder.add_world(gravity=(0.0, -3.0))
    add_ground(builder, width=4.0)
    paddle = builder.add_body(
        position=(0.0, 1.8), velocity=(0.3, 0.1), angular_velocity=1.5, type=dc.BodyType.KINEMATIC
    )
    builder.add_box(paddle, 1.0, 0.1)
    for i in range(8):
        builder.add_disc(builder.add_body(position=(-1.4 + 0.7 * (i % 4), 0.31 + 1.95 * (i // 4))), 0.3)


def surfaces(builder: dc.ModelBuilder) -> None:
    """Boxes and discs on a belt against a wall, some of which resist rolling; a joint, damping, a light body."""
    builder.add_world()
    add_ground(builder, width=4.0)
    belt = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(belt, 1.5, 0.1, center=(-0.4, 0.1), surface_speed=-1.5, friction=0.8)
    bodies = []
    for i in range(8):
        trait = {"linear_damping": 0.5, "gravity_scale": 0.2} if i == 3 else {}
        bodies.append(builder.add_body((-1.6 + 0.5 * i, 0.6 + 0.1 * i), velocity=(0.4 * i, -1.0), **trait))
        if i % 3 == 0:
            builder.add_box(bodies[-1], 0.2, 0.15)
        else:
            builder.add_disc(bodies[-1], 0.2, rolling_resistance=0.1 * i, friction=0.7)
    builder.add_distance_joint(bodies[1], bodies[2], length=0.6)


def frozen(builder: dc.ModelBuilder) -> None:
    """Three worlds; the one in the middle is made to freeze (see ``simulation``)."""
    for columns in (2, 3, 2):
        discs(builder, columns, 2)


def worlds(builder: dc.ModelBuilder) -> None:
    """Two worlds of different size, an empty one, and one of boxes."""
    discs(builder, 2, 2)
    builder.add_world()
    boxes(builder)
    discs(builder, 3, 4)


def crowd(builder: dc.ModelBuilder, seed: int = 0, count: int = 40) -> None:
    """Shapes of all kinds and of sizes 1 : 30, thrown over each other at random."""
    draw = np.random.default_rng(seed)
    builder.add_world(length_scale=0.5)
    ground = builder.add_body(type=dc.BodyType.STATIC)
    x = np.linspace(-4.0, 4.0, 9)
    builder.add_chain(ground, np.stack([x, draw.uniform(-0.6, 0.6, 9)], axis=1))
    builder.add_chain(ground, draw.normal(size=(5, 2)).cumsum(axis=0) + 2.0, closed=True)
    for i in range(count):
        kind = (dc.BodyType.DYNAMIC, dc.BodyType.DYNAMIC, dc.BodyType.DYNAMIC, dc.BodyType.KINEMATIC)[i % 4]
        body = builder.add_body(
            position=draw.uniform((-4, -1), (4, 4)),
            angle=draw.uniform(-9, 9),
            velocity=draw.normal(0, 3, 2),
            angular_velocity=draw.normal(0, 100 if i % 7 == 0 else 5),
            type=kind,
        )
        size = 0.05 * 30 ** draw.uniform()
        if i % 5 == 0:
            builder.add_disc(body, size, friction=draw.uniform(), restitution=draw.uniform())
        elif i % 5 == 1:
            builder.add_capsule(body, draw.normal(size=2), draw.normal(size=2), 0.3 * size)
        else:
            turn = np.linspace(0, 2 * np.pi, draw.integers(4, 10))[:-1]
            corners = size * np.stack([np.cos(turn), 0.6 * np.sin(turn)], axis=1) + draw.normal(0, 0.2, 2)
            builder.add_polygon(body, corners, radius=draw.choice([0.0, 0.1 * size]), friction=draw.uniform())
            if i % 5 == 3:
                builder.add_disc(body, 0.4 * size, center=draw.normal(0, 0.3, 2), mask=0xFFFFFFFF ^ draw.integers(4))


def carried(builder: dc.ModelBuilder) -> None:
    """Polygons and discs in a chain that a kinematic body carries, and in one that falls; both come last."""
    builder.add_world(length_scale=0.5)
    for i in range(8):
        body = builder.add_body(
            (0.5 * (i % 4) - 0.8 + 4.0 * (i // 4), 0.6 + 0.3 * (i % 3)), 0.4 * i, (0.3 * i, -1.0), 0.5 * i
        )
        if i % 3:
            builder.add_box(body, 0.2, 0.15, radius=0.02 * (i % 2))
        else:
            builder.add_disc(body, 0.2)
    turn = np.linspace(0, -np.pi, 9)
    bowl = 1.3 * np.stack([np.cos(turn), np.sin(turn)], axis=1) + (0.0, 0.8)
    lift = builder.add_body(velocity=(0.3, 0.2), angular_velocity=0.2, type=dc.BodyType.KINEMATIC)
    builder.add_chain(lift, bowl)
    builder.add_chain(builder.add_body((4.0, 0.0), mass=2.0), bowl)


def simulation(scene: Callable[[dc.ModelBuilder], None], dtype: str, backend: str, **options: Any) -> dc.Simulation:
    builder = dc.ModelBuilder()
    scene(builder)
    model, state, joints = builder.finalize(dtype=dtype, backend=backend)
    sim = dc.Simulation(model, state, joints, **options)
    if scene is frozen:
        state.numpy("velocity")[model.numpy("body_start")[2] - 1] = np.inf
    if scene is kinematic:
        state.numpy("force")[-1] = (0.4, 1.0)
        state.numpy("torque")[-1] = 0.05
    return sim
