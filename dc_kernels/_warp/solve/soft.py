"""Substeps with soft contacts and joints, each followed by a sweep that relaxes them (Catto 2024, "Solver2D"; Box2D 3).

Pairs, contacts and rows are found once in a step. Each of its n substeps of h = dt / n applies a share of the forces,
starts from the impulses of the substep before, sweeps once with soft rows, moves the bodies, and sweeps once more
without softness and bias, which takes away the velocity that the softness gave to push overlaps out. Gaps follow the
displacements to first order. Bounces come at the end of the step.

What holds a joint, and a limit beyond its end, is soft as a contact is; a limit within its range may move up to the end
of it in a substep. Springs, motors and general rows keep their bounds and softness, those of a substep, in both sweeps;
a spring meets in both what it was off by before the bodies moved, which is implicit Euler. Rows of joints are made anew
each time that the bodies have moved: with those of the step's start small swings would gain 6 % of energy a second.
Where joints are not all rods, a solve is cut at these places (``launch.resume``), and they are made between. The two
rows of a hinge, a slider or a weld are solved as one block (``renew.h``).

Of a spring ``rows.row_bias`` is the rate at which it draws [1/s], and ``rows.row_gap`` what it is off by [m].
``rows.before`` holds what each row of a joint was off by when the substep began, and what share of the first row the
second one of a pair is taken without.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import cross, kernel_module, rotate
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.solve.constraints.jacobian import moved_rows
from dc_kernels._warp.solve.lanes import has_lanes, lane_functions
from dc_kernels._warp.solve.laws import clamped, inverse_or_zero
from dc_kernels._warp.solve.row import row_functions
from dc_kernels._warp.solve.world import ENDS, N_LANES, world_functions
from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.iteration import NEVER
from dc_kernels.solve.joints import PAIRED
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES, OWN, SOFT_NUMBERS, SURFACED, TOUCH

STATIC = wp.constant(int(BodyType.STATIC))
# where numbers stand in what a sweep is given: rate, mass and give of contacts with a fixed body (those of others come
# first) and of joints; substeps a second; slop; largest bias; 1 where it relaxes the rows
FIXED, HELD, PER_STEP, SLOP, LIMIT, RELAXES = (wp.constant(place) for place in (3, 6, 9, 10, 11, 12))
NO_PAUSE = wp.constant(NEVER)
REVOLUTE, PRISMATIC, WELD = (wp.constant(kind) for kind in PAIRED)


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``solve_soft``; one thread a world."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    vec3, Soft = wp.types.vector(3, real), wp.types.vector(SOFT_NUMBERS, real)
    module = kernel_module("soft", dtype, variant)
    contiguous = contiguous_groups(dtype)
    world, row = world_functions(dtype, variant), row_functions(dtype, variant)
    span_of, load_impulses, apply, bound_rolling = world.span_of, world.load_impulses, world.apply, world.bound_rolling
    sweep_lanes = lane_functions(dtype, variant).sweep_soft
    normal_speed, tangent_speed_after, within = row.normal_speed, row.tangent_speed_after, row.within
    normal_change, changed, least_normal = row.normal_change, row.changed, row.least_normal
    move_rows = moved_rows(dtype, variant) if variant in OWN else None
    columns = COLUMNS[variant]
    jointed, own, surfaced = variant in JOINTED, variant in OWN, variant in SURFACED
    width = wp.constant(len(columns) * LANES)
    at = {name: wp.constant(i * LANES) for i, name in enumerate(columns)}
    EN, ET, MU, GAP, BIAS = (at[name] for name in ("en", "et", "mu", "gap", "bias"))
    # variants that lack one never read it
    LO, HI, SOFT, HOLDS, AX, AY = (at.get(name, 0) for name in ("lo", "hi", "soft", "held", "ax", "ay"))
    NX, NY, RAN, RBN, IA, IB = (at.get(name, 0) for name in ("nx", "ny", "rAn", "rBn", "iA", "iB"))
    zero, one, two_pi = real(0.0), real(1.0), real(6.283185307179586)
    bounded = real(UNBOUNDED)

    @wp.func(module=module)
    def softness(frequency: real, damping: real, per_step: real):
        """Rate of the bias, share of the mass, share of the impulse given back (Catto 2011, "Soft constraints").

        Args:
            frequency: natural one, times the substep [1].
            damping: over the critical one [1].
            per_step: 1 over the substep [1/s].
        """
        turn = two_pi * frequency  # within a substep
        drag = real(2.0) * damping + turn
        stiff = turn * drag
        return vec3(turn / drag * per_step, stiff / (one + stiff), one / (one + stiff))

    @wp.func(module=module)
    def sweep_soft(block: int, lane: int, rows: t.Rows, motion: t.Motion, soft: Soft):
        """One row, as the lanes have it; the larger impulse change [N s]."""
        r = block * width + lane
        i = block * 2 * N_LANES + lane
        a = rows.body[i]
        b = rows.body[i + N_LANES]
        va = motion.solved[a]
        vb = motion.solved[b]
        off = rows.column[r + GAP] + normal_speed(rows.column, r, motion.displacement[a], motion.displacement[b])
        gap = off - soft[SLOP]
        kind = int(0)
        if wp.min(va[3], vb[3]) <= zero:
            kind = FIXED
        bias = wp.max(soft[kind] * wp.min(off, zero), -soft[LIMIT])
        mass = soft[kind + 1]
        give = soft[kind + 2]
        if gap > real(-TOUCH) * soft[SLOP]:
            bias = wp.max(gap, zero) * soft[PER_STEP]
            mass = one
            give = zero
        ln0 = rows.impulse[i]
        if wp.static(own):
            if rows.column[r + ET] <= zero:
                then = off  # a spring meets in both sweeps what it was off by when the substep began
                if soft[RELAXES] > zero:
                    then = rows.before[i]
                rows.before[i] = then
                bias = rows.column[r + BIAS]
                mass = one
                give = zero
                low = rows.column[r + LO]
                if rows.column[r + HOLDS] > zero:
                    rigid = low < -bounded and rows.column[r + HI] > bounded
                    if not rigid and ((low < zero and off < zero) or (low >= zero and off > zero)):
                        bias = off * soft[PER_STEP]
                    else:
                        bias = wp.min(wp.max(soft[HELD] * off, -soft[LIMIT]), soft[LIMIT])
                        mass = soft[HELD + 1]
                        give = soft[HELD + 2]
                elif rows.column[r + SOFT] > zero:
                    bias = bias * then + rows.column[r + SOFT] * ln0
        elif wp.static(jointed):
            if least_normal(rows.column, r) < zero:
                bias = wp.min(wp.max(soft[HELD] * off, -soft[LIMIT]), soft[LIMIT])
                mass = soft[HELD + 1]
                give = soft[HELD + 2]
        lt0 = rows.impulse[i + N_LANES]
        vn = normal_speed(rows.column, r, va, vb)
        ln = within(rows.column, r, ln0 - ((rows.column[r + EN] * mass) * (vn + bias) + give * ln0))
        dn = ln - ln0
        vt = tangent_speed_after(rows.column, r, va, vb, dn)
        limited = rows.column[r + MU] * ln
        lt = clamped(lt0 - rows.column[r + ET] * vt, limited)
        dt = lt - lt0
        motion.solved[a] = changed(rows.column, r, va, 0, dn, dt)
        motion.solved[b] = changed(rows.column, r, vb, 1, dn, dt)
        rows.impulse[i] = ln
        rows.impulse[i + N_LANES] = lt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def sweep(span: t.Span, soft: Soft, motion: t.Motion, rows: t.Rows):
        """One sweep over all rows of a world in colour order; the largest impulse change [N s]."""
        first = span.first
        change = zero
        if wp.static(surfaced):
            bound_rolling(span, rows)
        if has_lanes() == 1:
            change = sweep_lanes(
                rows.column,
                rows.body,
                motion.solved,
                motion.displacement,
                rows.impulse,
                rows.before,
                rows.color_block,
                span.world * ENDS,
                soft,
                span.team,
            )
            first = span.serial  # the lanes have done the colours before it
        for k in range(first * N_LANES, span.last * N_LANES):
            change = wp.max(change, sweep_soft(k / N_LANES, k % N_LANES, rows, motion, soft))
        return change

    @wp.func(module=module)
    def bounce(
        w: int, config: t.Config, model: t.Model, state: t.State, contacts: t.Contacts, motion: t.Motion, rows: t.Rows
    ):
        """Let contacts that were hit leave with the share of their speed before the step that restitution says."""
        hardly = config.restitution_threshold * wp.sqrt(wp.length(model.gravity[w]) * model.length_scale[w])
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            e = contacts.restitution[c]
            i = rows.slot[c]
            if e > zero and rows.change[i] > zero:
                r = i / (2 * N_LANES) * width + i % N_LANES
                a = contacts.body_a[c]
                b = contacts.body_b[c]
                va = state.velocity[a]
                vb = state.velocity[b]
                before = normal_speed(
                    rows.column,
                    r,
                    vec4(va[0], va[1], state.angular_velocity[a], zero),
                    vec4(vb[0], vb[1], state.angular_velocity[b], zero),
                )
                threshold = wp.where(e < one, hardly, zero)
                if before < -threshold:
                    now = normal_speed(rows.column, r, motion.solved[a], motion.solved[b])
                    x = rows.impulse[i]
                    dn = wp.max(x - rows.column[r + EN] * (now + e * before), zero) - x
                    motion.solved[a] = normal_change(rows.column, r, motion.solved[a], 0, dn)
                    motion.solved[b] = normal_change(rows.column, r, motion.solved[b], 1, dn)
                    rows.impulse[i] = x + dn
                    rows.change[i] = rows.change[i] + dn

    @wp.func(module=module)
    def begin(
        span: t.Span,
        share: real,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        motion: t.Motion,
        rows: t.Rows,
    ):
        """Start impulses of a substep, and bodies where they are, with the velocities that they have."""
        load_impulses(span, config, joints, contacts, motion, rows)
        for i in range(span.low, span.high):
            rows.impulse[i] = rows.impulse[i] * share
            rows.change[i] = zero
        for b in range(span.first_body, span.last_body):
            p = motion.predicted[b]
            v = vec4(zero, zero, zero, p[3])
            if model.body_type[b] != STATIC:
                v = vec4(state.velocity[b][0], state.velocity[b][1], state.angular_velocity[b], p[3])
            motion.solved[b] = v
            motion.displacement[b] = vec4(zero, zero, zero, p[3])

    @wp.func(module=module)
    def turn_rods(w: int, model: t.Model, state: t.State, joints: t.Joints, motion: t.Motion, rows: t.Rows):
        """Rows of rods that are packed as they are made, where the substeps have brought their bodies."""
        for j in range(rows.line_start[w], rows.line_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            da = motion.displacement[a]
            db = motion.displacement[b]
            angle_a = state.angle[a] + da[2]
            angle_b = state.angle[b] + db[2]
            ra = rotate(wp.cos(angle_a), wp.sin(angle_a), joints.joint_anchor_a[j])
            rb = rotate(wp.cos(angle_b), wp.sin(angle_b), joints.joint_anchor_b[j])
            d = (state.position[b] + vec2(db[0], db[1]) + rb) - (state.position[a] + vec2(da[0], da[1]) + ra)
            length = wp.length(d)
            if length > zero and wp.min(da[3], db[3]) >= zero:  # and awake
                n = d / length
                ran = cross(ra, n)
                rbn = cross(rb, n)
                i = rows.joint_slot[j]
                r = i / (2 * N_LANES) * width + i % N_LANES
                rows.column[r + NX] = n[0]
                rows.column[r + NY] = n[1]
                rows.column[r + RAN] = ran
                rows.column[r + RBN] = rbn
                if wp.static(own):
                    rows.column[r + AX] = n[0]
                    rows.column[r + AY] = n[1]
                mass = da[3] + db[3] + rows.column[r + IA] * ran * ran + rows.column[r + IB] * rbn * rbn
                rows.column[r + EN] = inverse_or_zero(mass)
                rows.column[r + GAP] = length - joints.joint_length[j] - normal_speed(rows.column, r, da, db)

    @wp.func(module=module)
    def accumulate(span: t.Span, model: t.Model, joints: t.Joints, rows: t.Rows):
        """Impulses of a substep to those of the step, along the rows of joints as they were made."""
        for i in range(span.low, span.high):
            rows.change[i] = rows.change[i] + rows.impulse[i]
        if wp.static(own):
            for j in range(model.joint_start[span.world], model.joint_start[span.world + 1]):
                kind = joints.joint_kind[j]
                if kind == REVOLUTE or kind == PRISMATIC or kind == WELD:
                    one_of = rows.row_slot[joints.joint_row_start[j]]
                    other = rows.row_slot[joints.joint_row_start[j] + 1]
                    more = rows.before[other + N_LANES] * rows.impulse[other]
                    rows.change[one_of] = rows.change[one_of] - more

    @wp.kernel(module=module, enable_backward=False)
    def solve_soft(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        contacts: t.Contacts,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Substeps of a world: velocities, displacements, and the impulses of the whole step.

        A part of the solve relaxes the rows of the substep before, and begins the next one: ``resume`` counts the parts
        before, ``pause`` those that are done now.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(contacts)
        contiguous(motion)
        contiguous(rows)
        contiguous(stats)
        if state.flags[w] != 0:
            return
        span = span_of(w, 0, config, model, motion, rows)
        span.team = launch.team
        share = one / real(config.substeps)
        h = motion.step_dt[w] * share
        per_step = one / h
        f = config.soft_frequency
        both = softness(f, config.soft_damping, per_step)
        fixed = softness(real(2.0) * f, config.soft_damping, per_step)
        held = softness(real(2.0) * f, real(2.0), per_step)
        soft = Soft()
        rigid = Soft()
        for k in range(3):
            soft[k] = both[k]
            soft[FIXED + k] = fixed[k]
            soft[HELD + k] = held[k]
            rigid[1 + 3 * k] = one
        soft[PER_STEP] = per_step
        soft[SLOP] = config.slop * model.length_scale[w]
        soft[LIMIT] = config.max_correction * model.length_scale[w] / motion.step_dt[w]
        rigid[PER_STEP] = soft[PER_STEP]
        rigid[SLOP] = soft[SLOP]
        rigid[LIMIT] = soft[LIMIT]
        rigid[RELAXES] = one
        change = zero
        done = launch.resume
        last = config.substeps
        if launch.pause < NO_PAUSE:
            last = launch.resume + launch.pause - 1
        if done == 0:
            begin(span, share, config, model, state, joints, contacts, motion, rows)
        while done <= last:
            if wp.static(own):
                move_rows(w, wp.where(done > 0, 1, 0), model, joints, motion, rows)
            if wp.static(jointed):
                turn_rods(w, model, state, joints, motion, rows)
            if done > 0:
                change = sweep(span, rigid, motion, rows)
                accumulate(span, model, joints, rows)
            if done < config.substeps:
                for b in range(span.first_body, span.last_body):
                    p = motion.predicted[b]
                    v = motion.solved[b]
                    if model.body_type[b] != STATIC:
                        x = v[0] + (p[0] - state.velocity[b][0]) * share
                        y = v[1] + (p[1] - state.velocity[b][1]) * share
                        v = vec4(x, y, v[2] + (p[2] - state.angular_velocity[b]) * share, v[3])
                    motion.solved[b] = v
                apply(span, motion, rows, rows.impulse)
                sweep(span, soft, motion, rows)
                for b in range(span.first_body, span.last_body):
                    v = motion.solved[b]
                    d = motion.displacement[b]
                    motion.displacement[b] = vec4(d[0] + v[0] * h, d[1] + v[1] * h, d[2] + v[2] * h, d[3])
            done += 1
        if last < config.substeps:
            return
        bounce(w, config, model, state, contacts, motion, rows)
        for i in range(span.low, span.high):
            rows.impulse[i] = rows.change[i]
        if wp.static(jointed):
            for j in range(rows.line_start[w], rows.line_start[w + 1]):  # rods of sleepers keep every bit
                if wp.min(motion.solved[joints.joint_body_a[j]][3], motion.solved[joints.joint_body_b[j]][3]) < zero:
                    rows.impulse[rows.joint_slot[j]] = joints.joint_impulse[j]
        sweeps = wp.where(span.last > span.first, 2 * config.substeps, 0)
        stats.sweeps[w] = sweeps
        stats.iteration[w].sweeps = sweeps
        stats.iteration[w].finished = 1
        stats.iteration[w].change = change
        stats.change[w] = change
        stats.residual[w] = zero

    return {"solve_soft": solve_soft}
