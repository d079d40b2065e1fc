"""Joints of all kinds have the bits of Warp on Taichi, swept and solved as trees."""

from __future__ import annotations

import itertools

import pytest

import dc_kernels as dc
from tests.parity.scenes import add_ground, discs

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)
DT = 0.01


def block(builder: dc.ModelBuilder, x: float, y: float) -> int:
    body = builder.add_body((x, y))
    builder.add_box(body, 0.2, 0.1)
    return body


def wheel(builder: dc.ModelBuilder, x: float, y: float, radius: float, density: float = 1.0) -> int:
    body = builder.add_body((x, y))
    builder.add_disc(body, radius, density=density)
    return body


def linked(builder: dc.ModelBuilder) -> None:
    """A chain with a load of forty links, which needs a tree; one joint at least of each kind, one that breaks."""
    builder.add_world()
    add_ground(builder, width=8.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    chain = [block(builder, -3.0 + 0.4 * i, 3.0) for i in range(5)]
    builder.add_revolute_joint(wall, chain[0], (-3.2, 3.0), (-0.2, 0.0))
    for one, other in itertools.pairwise(chain):
        builder.add_revolute_joint(one, other, (0.2, 0.0), (-0.2, 0.0))
    builder.add_weld_joint(chain[-1], wheel(builder, -1.0, 2.6, 0.3, density=40.0), (0.2, 0.0), (0.0, 0.4))
    arm, slider, car = block(builder, 0.5, 2.0), block(builder, 1.5, 1.5), block(builder, 3.2, 1.2)
    limits = {"lower": -0.5, "upper": 0.5, "motor_speed": 2.0}
    builder.add_revolute_joint(wall, arm, (0.3, 2.0), (-0.2, 0.0), max_motor_torque=3.0, **limits)
    builder.add_prismatic_joint(wall, slider, (1.0, 0.2), (1.5, 1.5), (0.0, 0.0), max_motor_force=5.0, **limits)
    builder.add_weld_joint(slider, block(builder, 2.5, 1.5), (0.5, 0.0), (-0.5, 0.0), frequency=3.0)
    builder.add_wheel_joint(
        car, wheel(builder, 3.2, 0.6, 0.25), (0.0, 1.0), (0.0, -0.5), (0.0, 0.0), max_motor_torque=1.0, **limits
    )
    builder.add_target_joint(wall, block(builder, 0.0, 0.5), (0.5, 1.0), (0.0, 0.0), max_force=30.0)
    gears = wheel(builder, -2.0, 1.0, 0.2), wheel(builder, -1.4, 1.0, 0.3)
    builder.add_revolute_joint(wall, gears[0], (-2.0, 1.0), motor_speed=3.0, max_motor_torque=2.0)
    builder.add_revolute_joint(wall, gears[1], (-1.4, 1.0))
    builder.add_gear_joint(*gears, ratio=-0.66)
    hung, below = block(builder, 1.0, 3.5), block(builder, 1.8, 3.5)
    builder.add_distance_joint(hung, below, length=0.7, frequency=4.0, damping_ratio=0.2, lower=0.3, upper=1.0)
    builder.add_rope_joint(wall, hung, (1.0, 4.5), max_length=1.0)
    builder.add_general_joint(below, car, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), speed=0.1, lower=-2.0, upper=2.0)
    builder.add_weld_joint(wall, block(builder, -3.2, 1.0), (-3.6, 1.0), (-0.4, 0.0), break_force=2.0)
    builder.add_world()
    discs(builder, 2, 2)
    rods = [builder.add_body((0.0, 3.5), type=dc.BodyType.STATIC)]  # under a load, with rows across them
    rods += [wheel(builder, 0.5 * i, 3.5, 0.1, density) for i, density in ((1, 1.0), (2, 1.0), (3, 60.0))]
    for one, other in itertools.pairwise(rods):
        builder.add_distance_joint(one, other, length=0.5, across=True)


def test_joints_of_all_kinds_have_the_bits_of_warp() -> None:
    """Stage by stage, as a whole step with such rows compiles for 15 s more; test_taichi_steps.py runs whole steps."""
    sims = []
    for backend in ("warp", "taichi"):
        builder = dc.ModelBuilder()
        linked(builder)
        sims.append(dc.Simulation(*builder.finalize("float32", backend=backend)))
    warp, taichi = sims
    for steps in (1, 8, 106):
        warp.run(steps, DT)
        for _ in range(steps):
            taichi.collide(DT)
            taichi.solve()
            taichi.advance()
        for name in ("state", "joints"):
            want, got = getattr(warp, name).views(), getattr(taichi, name).views()
            assert [key for key in want if want[key].tobytes() != got[key].tobytes()] == [], f"{name}, {steps} steps"
        assert (taichi.rows.numpy("tree_used") == warp.rows.numpy("tree_used")).all()
    assert set(warp.rows.numpy("tree_used") > 0) == {False, True}
    assert warp.joints.numpy("joint_broken").sum() == 1
    for sim in sims:  # a motor's speed, and the velocity of what is static, which nothing moves by
        sim.joints.numpy("joint_speed")[7] = float("nan")
        sim.state.worlds("velocity")[2][0, 0] = float("inf")
        sim.collide(DT)
        assert sim.state.numpy("flags").tolist() == [dc.Flag.NONFINITE, 0, dc.Flag.NONFINITE]
