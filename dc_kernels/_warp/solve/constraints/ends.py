"""What the rows of all kinds of joints are made of: where the anchors are, and the row of each part of a joint.

A row's Jacobians J_A, J_B multiply the velocities V = (x, y, spin) of its bodies. Rows of angles count in arms of the
world's ``length_scale``, so that impulses of all rows are in N s and tolerances hold for them alike.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, rotate
from dc_kernels._warp.groups import group_types
from dc_kernels.model.config import METHODS, POSITION_CORRECTIONS
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.joints import NEAR_LIMIT, SMALL_TURN

BAUMGARTE = wp.constant(POSITION_CORRECTIONS["baumgarte"])
SUBSTEPS = wp.constant(METHODS["tgs_soft"])


@cache
def end_functions(dtype: str) -> SimpleNamespace:
    """``Ends`` and ``ends_of`` a joint.

    ``hold``, ``spring``, ``motor``, ``limit``, ``bounded``, ``idle`` and ``rest`` write a row of it.

    ``point``, ``slide`` and ``turn`` give Jacobians as ``Along``: of B against A at the anchors along a direction of
    the world, along one of body A, and in angle.
    """
    t = group_types(dtype)
    real, vec2, vec3 = t.real, t.vec2, wp.types.vector(3, t.real)
    module = kernel_module("joints", dtype)
    infinity, minus_infinity = real(float("inf")), real(float("-inf"))
    two_pi = real(6.283185307179586)
    nothing = real(UNBOUNDED)
    small_turn, near = real(SMALL_TURN), real(NEAR_LIMIT)

    class Ends:
        """Where the ends of a joint are, and what their bodies do before the step's forces."""

        a: wp.int32
        b: wp.int32
        ra: vec2  # from the centres of mass to the anchors
        rb: vec2
        d: vec2  # from anchor A to anchor B
        speed: vec2  # of anchor B against anchor A
        wa: real
        wb: real
        angle_a: real
        angle_b: real
        angle: real  # of B less that of A
        step: real
        substeps: wp.bool  # whether there are any, which follow what the rows are off by
        dt: real  # of the step, or a substep, in which an impulse acts
        size: real  # arm in which angles count
        most: real  # largest correction at once

    class Along:
        """Jacobians, what they are of at the beginning of the step, and what turning adds to it, to second order."""

        ja: vec3
        jb: vec3
        off: real
        grow: real

    Ends, Along = wp.struct(Ends, module=module), wp.struct(Along, module=module)

    @wp.func(module=module)
    def ends_of(
        j: int,
        w: int,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        joints: t.Joints,
    ):
        """The ends of joint j of world w, where the state has them, or the substeps that have been made since."""
        e = Ends()
        e.a = joints.joint_body_a[j]
        e.b = joints.joint_body_b[j]
        e.angle_a = state.angle[e.a]
        e.angle_b = state.angle[e.b]
        place_a = state.position[e.a]
        place_b = state.position[e.b]
        velocity_a = state.velocity[e.a]
        velocity_b = state.velocity[e.b]
        e.wa = state.angular_velocity[e.a]
        e.wb = state.angular_velocity[e.b]
        if launch.resume > 0:
            moved_a = motion.displacement[e.a]
            moved_b = motion.displacement[e.b]
            solved_a = motion.solved[e.a]
            solved_b = motion.solved[e.b]
            e.angle_a += moved_a[2]
            e.angle_b += moved_b[2]
            place_a += vec2(moved_a[0], moved_a[1])
            place_b += vec2(moved_b[0], moved_b[1])
            velocity_a = vec2(solved_a[0], solved_a[1])
            velocity_b = vec2(solved_b[0], solved_b[1])
            e.wa = solved_a[2]
            e.wb = solved_b[2]
        e.ra = rotate(wp.cos(e.angle_a), wp.sin(e.angle_a), joints.joint_anchor_a[j])
        e.rb = rotate(wp.cos(e.angle_b), wp.sin(e.angle_b), joints.joint_anchor_b[j])
        e.d = (place_b + e.rb) - (place_a + e.ra)
        va = velocity_a + e.wa * vec2(-e.ra[1], e.ra[0])
        vb = velocity_b + e.wb * vec2(-e.rb[1], e.rb[0])
        e.speed = vb - va
        e.angle = e.angle_b - e.angle_a
        e.step = motion.step_dt[w]
        e.dt = e.step
        e.substeps = config.method == SUBSTEPS
        if e.substeps:
            e.dt = e.step / real(config.substeps)
        e.size = model.length_scale[w]
        e.most = config.max_correction * e.size
        return e

    @wp.func(module=module)
    def point(e: Ends, n: vec2):
        """Along a direction of the world."""
        along = Along()
        along.ja = vec3(-n[0], -n[1], -cross(e.ra, n))
        along.jb = vec3(n[0], n[1], cross(e.rb, n))
        along.off = wp.dot(n, e.d)
        bend = e.wa * e.wa * wp.dot(n, e.ra) - e.wb * e.wb * wp.dot(n, e.rb)
        along.grow = real(0.5) * e.dt * e.dt * bend
        return along

    @wp.func(module=module)
    def slide(e: Ends, n: vec2):
        """Along a direction that turns with body A."""
        along = Along()
        along.ja = vec3(-n[0], -n[1], -cross(e.d + e.ra, n))
        along.jb = vec3(n[0], n[1], cross(e.rb, n))
        along.off = wp.dot(n, e.d)
        across = vec2(-n[1], n[0])
        bend = e.wa * e.wa * wp.dot(n, e.ra - e.d) - e.wb * e.wb * wp.dot(n, e.rb)
        bend += real(2.0) * e.wa * wp.dot(across, e.speed)
        along.grow = real(0.5) * e.dt * e.dt * bend
        return along

    @wp.func(module=module)
    def turn(e: Ends, ratio: real, off: real):
        """Of the angle of B less ``ratio`` times that of A, which is ``off`` [rad] from 0."""
        along = Along()
        along.ja = vec3(real(0.0), real(0.0), -ratio * e.size)
        along.jb = vec3(real(0.0), real(0.0), e.size)
        along.off = off * e.size
        return along

    @wp.func(module=module)
    def write(
        k: int,
        e: Ends,
        along: Along,
        bias: real,
        lower: real,
        upper: real,
        soft: real,
        gap: real,
        held: real,
        rows: t.Rows,
    ):
        rows.row_body_a[k] = e.a
        rows.row_body_b[k] = e.b
        rows.row_jacobian_a[k] = along.ja
        rows.row_jacobian_b[k] = along.jb
        rows.row_bias[k] = bias
        rows.row_lower[k] = lower
        rows.row_upper[k] = upper
        rows.row_softness[k] = soft
        rows.row_gap[k] = gap
        rows.row_held[k] = held

    @wp.func(module=module)
    def idle(k: int, e: Ends, rows: t.Rows):
        """A row that does nothing."""
        write(k, e, Along(), real(0.0), minus_infinity, infinity, real(0.0), real(0.0), real(0.0), rows)

    @wp.func(module=module)
    def rest(k: int, e: Ends, rows: t.Rows):
        """A row that does nothing and keeps its impulse, of bodies that sleep."""
        write(k, e, Along(), real(0.0), minus_infinity, infinity, real(0.0), real(0.0), real(-1.0), rows)

    @wp.func(module=module)
    def hold(k: int, e: Ends, along: Along, config: t.Config, rows: t.Rows):
        """What must stay 0, at the end of the step; of bodies that turn far in a step, where it is now."""
        turn = wp.max(wp.abs(e.wa), wp.abs(e.wb)) * e.dt
        grow = along.grow * wp.max(real(1.0) - turn * turn / (small_turn * small_turn), real(0.0))
        grow = wp.clamp(grow, -e.most, e.most)
        pull = real(0.0)
        if config.position_correction == BAUMGARTE:
            pull = wp.clamp(config.position_factor * along.off, -e.most, e.most)
        bias = (pull + grow) / e.dt
        write(k, e, along, bias, minus_infinity, infinity, real(0.0), along.off + grow, real(1.0), rows)

    @wp.func(module=module)
    def spring(
        k: int,
        e: Ends,
        along: Along,
        frequency: real,
        ratio: real,
        most: real,
        model: t.Model,
        motion: t.Motion,
        rows: t.Rows,
    ):
        """What a damped spring of limited impulse draws to 0, by implicit Euler (Catto 2011).

        With the effective mass m = 1 / (J M^-1 J^T), stiffness m w^2 and damping 2 m w ratio, where w = 2 pi frequency,
        its impulse makes J V + bias + softness impulse = 0 with bias = off w / (2 ratio + w dt) and
        softness = 1 / (m w dt (2 ratio + w dt)). Where substeps follow what it is off by, its bias is kept for each of
        that, w / (2 ratio + w dt).
        """
        of_a = wp.max(motion.predicted[e.a][3], real(0.0)) * (along.ja[0] * along.ja[0] + along.ja[1] * along.ja[1])
        of_b = wp.max(motion.predicted[e.b][3], real(0.0)) * (along.jb[0] * along.jb[0] + along.jb[1] * along.jb[1])
        of_a += model.inv_inertia[e.a] * along.ja[2] * along.ja[2]
        of_b += model.inv_inertia[e.b] * along.jb[2] * along.jb[2]
        rate = two_pi * frequency
        give = real(2.0) * ratio + rate * e.dt
        if give * rate > real(0.0):
            soft = (of_a + of_b) / (rate * e.dt * give)
            if e.substeps:
                write(k, e, along, rate / give, -most, most, soft, along.off, real(0.0), rows)
            else:
                write(k, e, along, along.off * rate / give, -most, most, soft, real(0.0), real(0.0), rows)
        else:
            idle(k, e, rows)

    @wp.func(module=module)
    def steady(
        k: int, e: Ends, along: Along, inertia: real, brake: real, model: t.Model, motion: t.Motion, rows: t.Rows
    ):
        """Inertia against a change of speed, beyond that of the bodies themselves, and a share of the speed to lose.

        Its impulse makes J (V - V0) + brake J V0 + impulse / (inertia - m) = 0, where V0 is what the step's forces
        alone would give.
        """
        va = motion.predicted[e.a]
        vb = motion.predicted[e.b]
        of_a = wp.max(va[3], real(0.0)) * (along.ja[0] * along.ja[0] + along.ja[1] * along.ja[1])
        of_b = wp.max(vb[3], real(0.0)) * (along.jb[0] * along.jb[0] + along.jb[1] * along.jb[1])
        of_a += model.inv_inertia[e.a] * along.ja[2] * along.ja[2]
        of_b += model.inv_inertia[e.b] * along.jb[2] * along.jb[2]
        more = inertia * (of_a + of_b) - real(1.0)
        if more > real(0.0):
            speed = (along.ja[0] * va[0] + along.ja[1] * va[1]) + along.ja[2] * va[2]
            speed += (along.jb[0] * vb[0] + along.jb[1] * vb[1]) + along.jb[2] * vb[2]
            soft = (of_a + of_b) / more
            write(k, e, along, (brake - real(1.0)) * speed, minus_infinity, infinity, soft, real(0.0), real(0.0), rows)
        else:
            idle(k, e, rows)

    @wp.func(module=module)
    def motor(k: int, e: Ends, along: Along, speed: real, most: real, rows: t.Rows):
        """A speed, by impulses up to ``most``."""
        write(k, e, along, -speed, -most, most, real(0.0), real(0.0), real(0.0), rows)

    @wp.func(module=module)
    def bounded(k: int, e: Ends, along: Along, speed: real, lower: real, upper: real, rows: t.Rows):
        """A speed, by impulses between bounds, of which UNBOUNDED is none."""
        low = wp.where(lower > -nothing, lower * e.dt, minus_infinity)
        high = wp.where(upper < nothing, upper * e.dt, infinity)
        write(k, e, along, -speed, low, high, real(0.0), real(0.0), real(0.0), rows)

    @wp.func(module=module)
    def limit(k: int, e: Ends, along: Along, lower: real, upper: real, config: t.Config, rows: t.Rows):
        """A range, of which the nearer end counts; what is within it may move up to it in the step.

        Far from both ends the row can carry nothing, so that it is not packed.
        """
        above = along.off - lower
        below = upper - along.off
        sign = real(1.0)
        room = above
        if below < above:
            sign = real(-1.0)
            room = below
        bias = wp.max(room, real(0.0)) / e.dt
        if config.position_correction == BAUMGARTE and room < real(0.0):
            bias = wp.max(config.position_factor * room, -e.most) / e.dt
        low = wp.where(sign > real(0.0), real(0.0), minus_infinity)
        high = wp.where(sign > real(0.0), infinity, real(0.0))
        gap = sign * room
        if upper - lower <= config.slop * e.size:  # both ends are one
            low = minus_infinity
            high = infinity
            bias = real(0.0)
        way = e.step * (wp.abs(e.speed[0]) + wp.abs(e.speed[1]) + e.size * (wp.abs(e.wa) + wp.abs(e.wb)))
        if room > near * e.size + real(2.0) * way:
            low = real(0.0)
            high = real(0.0)
        write(k, e, along, sign * bias, low, high, real(0.0), gap, real(1.0), rows)

    return SimpleNamespace(
        Ends=Ends,
        Along=Along,
        ends_of=ends_of,
        point=point,
        slide=slide,
        turn=turn,
        idle=idle,
        rest=rest,
        hold=hold,
        spring=spring,
        steady=steady,
        motor=motor,
        bounded=bounded,
        limit=limit,
    )
