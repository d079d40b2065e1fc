"""What the kernels of sleep share: islands, what a body or joint was last seen like."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels.model.enums import BodyType, Rest

DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
KINEMATIC = wp.constant(int(BodyType.KINEMATIC))
AWAKE = wp.constant(int(Rest.AWAKE))
ASLEEP = wp.constant(int(Rest.ASLEEP))
ROUSED = wp.constant(int(Rest.ROUSED))
FALLING = wp.constant(int(Rest.FALLING))


@wp.func
def root_of(parent: wp.array(dtype=wp.int32), body: int):
    """The root of a body's island; the way there is halved."""
    i = int(body)
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@wp.func
def join(parent: wp.array(dtype=wp.int32), a: int, b: int):
    """The islands of two bodies become one."""
    i = root_of(parent, a)
    j = root_of(parent, b)
    parent[wp.max(i, j)] = wp.min(i, j)


@wp.func
def differ(p: Any, q: Any):
    """Whether two vectors of two numbers differ."""
    return p[0] != q[0] or p[1] != q[1]


@cache
def island_functions(dtype: str) -> SimpleNamespace:
    """``sleeps``, ``moves``, ``see_body``, ``is_other_place``, ``see_joint`` and ``is_other_joint``."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("sleep", dtype)

    @wp.func(module=module)
    def sleeps(body: int, model: t.Model, sleepers: t.Sleepers):
        """Whether a body sleeps, or has been roused and wakes in this step."""
        return model.body_type[body] == DYNAMIC and sleepers.asleep[body] != AWAKE

    @wp.func(module=module)
    def moves(body: int, model: t.Model, state: t.State):
        """Whether a kinematic body has a velocity."""
        v = state.velocity[body]
        moving = v[0] != real(0.0) or v[1] != real(0.0) or state.angular_velocity[body] != real(0.0)
        return model.body_type[body] == KINEMATIC and moving

    @wp.func(module=module)
    def see_body(body: int, state: t.State, sleepers: t.Sleepers):
        """Remember where a body is and what acts on it."""
        sleepers.position[body] = state.position[body]
        sleepers.angle[body] = state.angle[body]
        sleepers.force[body] = state.force[body]
        sleepers.torque[body] = state.torque[body]

    @wp.func(module=module)
    def is_other_place(body: int, state: t.State, sleepers: t.Sleepers):
        """Whether a body is elsewhere than was last seen."""
        return differ(sleepers.position[body], state.position[body]) or sleepers.angle[body] != state.angle[body]

    @wp.func(module=module)
    def see_joint(j: int, joints: t.Joints, sleepers: t.Sleepers):
        """Remember what a joint is like."""
        sleepers.anchor_a[j] = joints.joint_anchor_a[j]
        sleepers.anchor_b[j] = joints.joint_anchor_b[j]
        sleepers.length[j] = joints.joint_length[j]

    @wp.func(module=module)
    def is_other_joint(j: int, joints: t.Joints, sleepers: t.Sleepers):
        """Whether a joint is another than was last seen."""
        other = differ(sleepers.anchor_a[j], joints.joint_anchor_a[j]) or sleepers.length[j] != joints.joint_length[j]
        return other or differ(sleepers.anchor_b[j], joints.joint_anchor_b[j])

    return SimpleNamespace(
        sleeps=sleeps,
        moves=moves,
        see_body=see_body,
        is_other_place=is_other_place,
        see_joint=see_joint,
        is_other_joint=is_other_joint,
    )
