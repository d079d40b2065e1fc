"""The row of a distance joint: J = [-n, -r_A x n, n, r_B x n] from anchor to anchor (Wu 2018, equation 2.20)."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, rotate, tangent
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.laws import inverse_or_zero, relative_speed
from dc_kernels.model.config import POSITION_CORRECTIONS

BAUMGARTE = wp.constant(POSITION_CORRECTIONS["baumgarte"])


@cache
def distance_row(dtype: str, variant: str) -> Any:
    """The function that makes the row of a distance joint."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Row = t.Row
    module = kernel_module("rows", dtype, variant)
    minus_infinity = real(float("-inf"))

    @wp.func(module=module)
    def asleep(a: int, b: int, model: t.Model):
        """The row of a joint that sleeps: without a normal it does nothing, and keeps its impulse."""
        row = Row()
        row.body_a = a
        row.body_b = b
        row.inv_inertia_a = model.inv_inertia[a]
        row.inv_inertia_b = model.inv_inertia[b]
        row.least = minus_infinity
        return row

    @wp.func(module=module)
    def make_distance_row(
        j: int,
        w: int,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        joints: t.Joints,
    ):
        """The row of joint j of world w.

        Its bias makes up for what the turn of its line and of its anchors' arms lengthens it by within the step, to
        second order; without it a pendulum loses (w dt)^2 / 2 of its speed in each step.
        """
        dt = motion.step_dt[w]
        per_dt = real(1.0) / dt
        limit = config.max_correction * model.length_scale[w]
        a = joints.joint_body_a[j]
        b = joints.joint_body_b[j]
        va = motion.predicted[a]
        vb = motion.predicted[b]
        if wp.min(va[3], vb[3]) < real(0.0):
            return asleep(a, b, model)
        ra = rotate(wp.cos(state.angle[a]), wp.sin(state.angle[a]), joints.joint_anchor_a[j])
        rb = rotate(wp.cos(state.angle[b]), wp.sin(state.angle[b]), joints.joint_anchor_b[j])
        d = (state.position[b] + rb) - (state.position[a] + ra)
        length = wp.length(d)
        n = vec2(real(1.0), real(0.0))
        if length > real(0.0):
            n = d / length
        ran = cross(ra, n)
        rbn = cross(rb, n)
        ia = model.inv_inertia[a]
        ib = model.inv_inertia[b]
        en = inverse_or_zero(va[3] + vb[3] + ia * ran * ran + ib * rbn * rbn)
        un = relative_speed(n, va, vb, ran, rbn)
        # before the step's forces, which the joints of a chain at rest will balance
        tan = tangent(n)
        wa = state.angular_velocity[a]
        wb = state.angular_velocity[b]
        v0a = vec4(state.velocity[a][0], state.velocity[a][1], wa, real(0.0))
        v0b = vec4(state.velocity[b][0], state.velocity[b][1], wb, real(0.0))
        ut = relative_speed(tan, v0a, v0b, cross(ra, tan), cross(rb, tan))
        bend = wa * wa * wp.dot(n, ra) - wb * wb * wp.dot(n, rb)
        if length > real(0.0):
            bend += ut * ut / length
        grow = wp.clamp(real(0.5) * dt * dt * bend, -limit, limit)
        off = length - joints.joint_length[j]
        pull = real(0.0)
        if config.position_correction == BAUMGARTE:
            pull = wp.clamp(config.position_factor * off, -limit, limit)
        bias = (pull + grow) * per_dt
        row = Row()
        row.body_a = a
        row.body_b = b
        row.normal = n
        row.normal_arm_a = ran
        row.normal_arm_b = rbn
        row.inv_inertia_a = ia
        row.inv_inertia_b = ib
        row.normal_mass = en
        row.bias = bias
        row.gap = off + grow
        row.least = minus_infinity
        row.square = (en * (un + bias)) * (en * (un + bias))
        return row

    return make_distance_row
