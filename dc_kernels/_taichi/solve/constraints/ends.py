"""What the rows of all kinds of joints are made of: where the anchors are, and the row of each part of a joint.

A row's Jacobians J_A, J_B multiply the velocities V = (x, y, spin) of its bodies. Rows of angles count in arms of the
world's ``length_scale``, so that impulses of all rows are in N s and tolerances hold for them alike.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.common import clamp, cross, dot, rotate
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.model.config import POSITION_CORRECTIONS
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.joints import NEAR_LIMIT, SMALL_TURN

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
INFINITY = float("inf")
TWO_PI = 6.283185307179586


@cache
def end_functions(dtype: str) -> SimpleNamespace:
    """``ends_of`` a joint; ``hold``, ``spring``, ``motor``, ``limit``, ``bounded``, ``idle``, ``rest`` write a row.

    ``point``, ``slide`` and ``turn`` give Jacobians: of B against A at the anchors along a direction of the world,
    along one of body A, and in angle. ``Along`` holds them, what they are of at the beginning of the step, ``off``, and
    what turning adds to it, to second order, ``grow``.
    """
    t = group_types(dtype)
    real, vec2, vec3 = t.real, t.vec2, t.vec3
    # bodies; from their centres to the anchors; from anchor A to B, and its speed; spins before the step's forces;
    # angle of B less that of A; the arm in which angles count; the largest correction at once
    Ends = ti.types.struct(
        a=ti.i32,
        b=ti.i32,
        ra=vec2,
        rb=vec2,
        d=vec2,
        speed=vec2,
        wa=real,
        wb=real,
        angle=real,
        dt=real,
        size=real,
        most=real,
    )
    Along = ti.types.struct(ja=vec3, jb=vec3, off=real, grow=real)

    @ti.func
    def ends_of(j, w, config: t.Config, model: t.Model, state: t.State, motion: t.Motion, joints: t.Joints):
        """The ends of joint j of world w."""
        e = Ends()
        a = joints.joint_body_a[j]
        b = joints.joint_body_b[j]
        ra = rotate(ti.cos(state.angle[a]), ti.sin(state.angle[a]), joints.joint_anchor_a[j])
        rb = rotate(ti.cos(state.angle[b]), ti.sin(state.angle[b]), joints.joint_anchor_b[j])
        wa = state.angular_velocity[a]
        wb = state.angular_velocity[b]
        va = state.velocity[a] + wa * vec2(0.0 - ra[1], ra[0])
        vb = state.velocity[b] + wb * vec2(0.0 - rb[1], rb[0])
        e.a = a
        e.b = b
        e.ra = ra
        e.rb = rb
        e.d = (state.position[b] + rb) - (state.position[a] + ra)
        e.wa = wa
        e.wb = wb
        e.speed = vb - va
        e.angle = state.angle[b] - state.angle[a]
        e.dt = motion.step_dt[w]
        e.size = model.length_scale[w]
        e.most = config.max_correction * e.size
        return e

    @ti.func
    def point(e, n):
        """Along a direction of the world."""
        along = Along()
        along.ja = vec3(0.0 - n[0], 0.0 - n[1], 0.0 - cross(e.ra, n))
        along.jb = vec3(n[0], n[1], cross(e.rb, n))
        along.off = dot(n, e.d)
        bend = e.wa * e.wa * dot(n, e.ra) - e.wb * e.wb * dot(n, e.rb)
        along.grow = 0.5 * e.dt * e.dt * bend
        return along

    @ti.func
    def slide(e, n):
        """Along a direction that turns with body A."""
        along = Along()
        along.ja = vec3(0.0 - n[0], 0.0 - n[1], 0.0 - cross(e.d + e.ra, n))
        along.jb = vec3(n[0], n[1], cross(e.rb, n))
        along.off = dot(n, e.d)
        across = vec2(0.0 - n[1], n[0])
        bend = e.wa * e.wa * dot(n, e.ra - e.d) - e.wb * e.wb * dot(n, e.rb)
        bend += 2.0 * e.wa * dot(across, e.speed)
        along.grow = 0.5 * e.dt * e.dt * bend
        return along

    @ti.func
    def turn(e, ratio, off):
        """Of the angle of B less ``ratio`` times that of A, which is ``off`` [rad] from 0."""
        along = Along()
        along.ja = vec3(0.0, 0.0, (0.0 - ratio) * e.size)
        along.jb = vec3(0.0, 0.0, e.size)
        along.off = off * e.size
        return along

    @ti.func
    def write(k, e, along, bias, lower, upper, soft, gap, held, rows: t.Rows):
        rows.row_body_a[k] = e.a
        rows.row_body_b[k] = e.b
        for i in ti.static(range(3)):
            rows.row_jacobian_a[k, i] = along.ja[i]
            rows.row_jacobian_b[k, i] = along.jb[i]
        rows.row_bias[k] = bias
        rows.row_lower[k] = lower
        rows.row_upper[k] = upper
        rows.row_softness[k] = soft
        rows.row_gap[k] = gap
        rows.row_held[k] = held

    @ti.func
    def idle(k, e, rows: t.Rows):
        """A row that does nothing."""
        write(k, e, Along(), 0.0, -INFINITY, INFINITY, 0.0, 0.0, 0.0, rows)

    @ti.func
    def rest(k, e, rows: t.Rows):
        """A row that does nothing and keeps its impulse, of bodies that sleep."""
        write(k, e, Along(), 0.0, -INFINITY, INFINITY, 0.0, 0.0, -1.0, rows)

    @ti.func
    def hold(k, e, along, config: t.Config, rows: t.Rows):
        """What must stay 0, at the end of the step; of bodies that turn far in a step, where it is now."""
        angle = ti.max(ti.abs(e.wa), ti.abs(e.wb)) * e.dt
        grow = along.grow * ti.max(1.0 - angle * angle / (real(SMALL_TURN) * real(SMALL_TURN)), 0.0)
        grow = clamp(grow, 0.0 - e.most, e.most)
        pull = real(0.0)
        if config.position_correction == BAUMGARTE:
            pull = clamp(config.position_factor * along.off, 0.0 - e.most, e.most)
        bias = (pull + grow) / e.dt
        write(k, e, along, bias, -INFINITY, INFINITY, 0.0, along.off + grow, 1.0, rows)

    @ti.func
    def spring(k, e, along, frequency, ratio, most, model: t.Model, motion: t.Motion, rows: t.Rows):
        """What a damped spring of limited impulse draws to 0, by implicit Euler (Catto 2011).

        With the effective mass m = 1 / (J M^-1 J^T), stiffness m w^2 and damping 2 m w ratio, where w = 2 pi frequency,
        its impulse makes J V + bias + softness impulse = 0 with bias = off w / (2 ratio + w dt) and
        softness = 1 / (m w dt (2 ratio + w dt)).
        """
        of_a = ti.max(motion.predicted[e.a][3], 0.0) * (along.ja[0] * along.ja[0] + along.ja[1] * along.ja[1])
        of_b = ti.max(motion.predicted[e.b][3], 0.0) * (along.jb[0] * along.jb[0] + along.jb[1] * along.jb[1])
        of_a += model.inv_inertia[e.a] * along.ja[2] * along.ja[2]
        of_b += model.inv_inertia[e.b] * along.jb[2] * along.jb[2]
        rate = TWO_PI * frequency
        give = 2.0 * ratio + rate * e.dt
        if give * rate > 0.0:
            soft = (of_a + of_b) / (rate * e.dt * give)
            write(k, e, along, along.off * rate / give, 0.0 - most, most, soft, 0.0, 0.0, rows)
        else:
            idle(k, e, rows)

    @ti.func
    def steady(k, e, along, inertia, brake, model: t.Model, motion: t.Motion, rows: t.Rows):
        """Inertia against a change of speed, beyond that of the bodies themselves, and a share of the speed to lose.

        Its impulse makes J (V - V0) + brake J V0 + impulse / (inertia - m) = 0, where V0 is what the step's forces
        alone would give.
        """
        va = motion.predicted[e.a]
        vb = motion.predicted[e.b]
        of_a = ti.max(va[3], 0.0) * (along.ja[0] * along.ja[0] + along.ja[1] * along.ja[1])
        of_b = ti.max(vb[3], 0.0) * (along.jb[0] * along.jb[0] + along.jb[1] * along.jb[1])
        of_a += model.inv_inertia[e.a] * along.ja[2] * along.ja[2]
        of_b += model.inv_inertia[e.b] * along.jb[2] * along.jb[2]
        more = inertia * (of_a + of_b) - 1.0
        if more > 0.0:
            speed = (along.ja[0] * va[0] + along.ja[1] * va[1]) + along.ja[2] * va[2]
            speed += (along.jb[0] * vb[0] + along.jb[1] * vb[1]) + along.jb[2] * vb[2]
            soft = (of_a + of_b) / more
            write(k, e, along, (brake - 1.0) * speed, -INFINITY, INFINITY, soft, 0.0, 0.0, rows)
        else:
            idle(k, e, rows)

    @ti.func
    def motor(k, e, along, speed, most, rows: t.Rows):
        """A speed, by impulses up to ``most``."""
        write(k, e, along, 0.0 - speed, 0.0 - most, most, 0.0, 0.0, 0.0, rows)

    @ti.func
    def bounded(k, e, along, speed, lower, upper, rows: t.Rows):
        """A speed, by impulses between bounds, of which UNBOUNDED is none."""
        low = ti.select(lower > -UNBOUNDED, lower * e.dt, -INFINITY)
        high = ti.select(upper < UNBOUNDED, upper * e.dt, INFINITY)
        write(k, e, along, 0.0 - speed, low, high, 0.0, 0.0, 0.0, rows)

    @ti.func
    def limit(k, e, along, lower, upper, config: t.Config, rows: t.Rows):
        """A range, of which the nearer end counts; what is within it may move up to it in the step.

        Far from both ends the row can carry nothing, so that it is not packed.
        """
        above = along.off - lower
        below = upper - along.off
        sign = real(1.0)
        room = above
        if below < above:
            sign = -1.0
            room = below
        bias = ti.max(room, 0.0) / e.dt
        if config.position_correction == BAUMGARTE and room < 0.0:
            bias = ti.max(config.position_factor * room, 0.0 - e.most) / e.dt
        low = ti.select(sign > 0.0, real(0.0), -INFINITY)
        high = ti.select(sign > 0.0, INFINITY, real(0.0))
        gap = sign * room
        if upper - lower <= config.slop * e.size:  # both ends are one
            low = -INFINITY
            high = INFINITY
            bias = 0.0
        way = e.dt * (ti.abs(e.speed[0]) + ti.abs(e.speed[1]) + e.size * (ti.abs(e.wa) + ti.abs(e.wb)))
        if room > NEAR_LIMIT * e.size + 2.0 * way:
            low = 0.0
            high = 0.0
        write(k, e, along, sign * bias, low, high, 0.0, gap, 1.0, rows)

    return SimpleNamespace(
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
