"""Substeps with soft contacts, each followed by a sweep that relaxes them (Catto 2024, "Solver2D"; Box2D 3).

Pairs, contacts and rows are found once in a step. Each of its n substeps of h = dt / n applies a share of the forces,
starts from the impulses of the substep before, sweeps once with soft contacts, moves the bodies, and sweeps once more
without softness and bias, which takes away the velocity that the softness gave to push overlaps out. Gaps follow the
displacements to first order. Bounces come at the end of the step.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.lanes import has_lanes, row_macros
from dc_kernels._warp.solve.row import row_functions
from dc_kernels._warp.solve.world import N_LANES, world_functions
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES, TOUCH

STATIC = wp.constant(int(BodyType.STATIC))
# where numbers stand in what a sweep is given: rate, mass and give of contacts with a fixed body (those of others come
# first) and of rods; substeps a second; slop; largest bias
FIXED, RODS, PER_STEP, SLOP, LIMIT = (wp.constant(place) for place in (3, 6, 9, 10, 11))


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """``solve_soft``; one thread a world."""
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    vec3, vec12 = wp.types.vector(3, real), wp.types.vector(12, real)
    module = kernel_module("soft", dtype, variant)
    world, row = world_functions(dtype, variant), row_functions(dtype, variant)
    span_of, load_impulses, apply = world.span_of, world.load_impulses, world.apply
    normal_speed, tangent_speed, within = row.normal_speed, row.tangent_speed, row.within
    normal_change, tangent_change, least_normal = row.normal_change, row.tangent_change, row.least_normal
    columns = COLUMNS[variant]
    jointed = variant in JOINTED
    width = wp.constant(len(columns) * LANES)
    EN, ET, MU, GAP = (wp.constant(columns.index(name) * LANES) for name in ("en", "et", "mu", "gap"))
    zero, one, two_pi = real(0.0), real(1.0), real(6.283185307179586)

    headers = ("prelude.h", "solve/bodies.h", "solve/row.h", "solve/soft.h")

    @wp.func_native(native_code(*headers, dtype=dtype, TOUCH=TOUCH, **row_macros(variant)))
    def sweep_lanes(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        displacement: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        soft: vec12,
    ) -> real: ...

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
    def sweep_soft(block: int, lane: int, rows: t.Rows, motion: t.Motion, soft: vec12):
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
        if wp.static(jointed):
            if least_normal(rows.column, r) < zero:
                bias = wp.min(wp.max(soft[RODS] * off, -soft[LIMIT]), soft[LIMIT])
                mass = soft[RODS + 1]
                give = soft[RODS + 2]
        ln0 = rows.impulse[i]
        lt0 = rows.impulse[i + N_LANES]
        vn = normal_speed(rows.column, r, va, vb)
        ln = within(rows.column, r, ln0 - ((rows.column[r + EN] * mass) * (vn + bias) + give * ln0))
        dn = ln - ln0
        va = normal_change(rows.column, r, va, 0, dn)
        vb = normal_change(rows.column, r, vb, 1, dn)
        vt = tangent_speed(rows.column, r, va, vb)
        limited = rows.column[r + MU] * ln
        lt = wp.min(wp.max(lt0 - rows.column[r + ET] * vt, -limited), limited)
        dt = lt - lt0
        motion.solved[a] = tangent_change(rows.column, r, va, 0, dt)
        motion.solved[b] = tangent_change(rows.column, r, vb, 1, dt)
        rows.impulse[i] = ln
        rows.impulse[i + N_LANES] = lt
        return wp.max(wp.abs(dn), wp.abs(dt))

    @wp.func(module=module)
    def sweep(span: t.Span, soft: vec12, motion: t.Motion, rows: t.Rows):
        """One sweep over all rows of a world in colour order; the largest impulse change [N s]."""
        first = span.first
        change = zero
        if has_lanes() == 1:
            change = sweep_lanes(
                rows.column,
                rows.body,
                motion.solved,
                motion.displacement,
                rows.impulse,
                first,
                span.serial,
                soft,
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
    def solve(
        w: int,
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
        """The solve of a world; see ``solve_soft``."""
        span = span_of(w, 0, config, model, motion, rows)
        load_impulses(span, config, joints, contacts, motion, rows)
        share = one / real(config.substeps)
        h = motion.step_dt[w] * share
        per_step = one / h
        slop = config.slop * model.length_scale[w]
        limit = config.max_correction * model.length_scale[w] / motion.step_dt[w]
        f = config.soft_frequency
        both = softness(f, config.soft_damping, per_step)
        fixed = softness(real(2.0) * f, config.soft_damping, per_step)
        rods = softness(real(2.0) * f, real(2.0), per_step)
        soft = vec12()
        rigid = vec12()
        for k in range(3):
            soft[k] = both[k]
            soft[FIXED + k] = fixed[k]
            soft[RODS + k] = rods[k]
            rigid[1 + 3 * k] = one
        soft[PER_STEP] = per_step
        soft[SLOP] = slop
        soft[LIMIT] = limit
        rigid[PER_STEP] = per_step
        rigid[SLOP] = slop
        rigid[LIMIT] = limit
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
        change = zero
        done = int(0)
        while done < config.substeps:
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
            change = sweep(span, rigid, motion, rows)
            for i in range(span.low, span.high):
                rows.change[i] = rows.change[i] + rows.impulse[i]
            done += 1
        bounce(w, config, model, state, contacts, motion, rows)
        for i in range(span.low, span.high):
            rows.impulse[i] = rows.change[i]
        sweeps = wp.where(span.last > span.first, 2 * done, 0)
        stats.sweeps[w] = sweeps
        stats.iteration[w].sweeps = sweeps
        stats.iteration[w].finished = 1
        stats.iteration[w].change = change
        stats.change[w] = change
        stats.residual[w] = zero

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
        """All substeps of a world: velocities, displacements, and the impulses of the whole step."""
        w = wp.tid() + launch.world_offset
        if state.flags[w] != 0:
            return
        solve(w, launch, config, model, state, joints, contacts, motion, rows, stats)

    return {"solve_soft": solve_soft}
