"""The row of a distance joint: J = [-n, -r_A x n, n, r_B x n] from anchor to anchor (Wu 2018, equation 2.20)."""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import clamp, cross, dot, length, rotate, tangent
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.laws import inverse_or_zero, relative_speed
from dc_kernels.model.config import POSITION_CORRECTIONS

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
MINUS_INFINITY = float("-inf")


@cache
def distance_row(dtype: str, variant: str) -> Any:
    """The function that makes the row of a distance joint."""
    t = group_types(dtype)
    vec2, vec4 = t.vec2, t.vec4
    Row = t.Row

    @ti.func
    def make_distance_row(
        j,
        w,
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
        per_dt = 1.0 / dt
        limit = config.max_correction * model.length_scale[w]
        a = joints.joint_body_a[j]
        b = joints.joint_body_b[j]
        va = motion.predicted[a]
        vb = motion.predicted[b]
        ra = rotate(ti.cos(state.angle[a]), ti.sin(state.angle[a]), joints.joint_anchor_a[j])
        rb = rotate(ti.cos(state.angle[b]), ti.sin(state.angle[b]), joints.joint_anchor_b[j])
        d = (state.position[b] + rb) - (state.position[a] + ra)
        apart = length(d)
        n = vec2(1.0, 0.0)
        if apart > 0.0:
            n = d / apart
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
        v0a = vec4(state.velocity[a][0], state.velocity[a][1], wa, 0.0)
        v0b = vec4(state.velocity[b][0], state.velocity[b][1], wb, 0.0)
        ut = relative_speed(tan, v0a, v0b, cross(ra, tan), cross(rb, tan))
        bend = wa * wa * dot(n, ra) - wb * wb * dot(n, rb)
        if apart > 0.0:
            bend += ut * ut / apart
        grow = clamp(0.5 * dt * dt * bend, -limit, limit)
        off = apart - joints.joint_length[j]
        pull = 0.0
        if config.position_correction == BAUMGARTE:
            pull = clamp(config.position_factor * off, -limit, limit)
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
        row.least = MINUS_INFINITY
        row.square = (en * (un + bias)) * (en * (un + bias))
        return row

    return make_distance_row
