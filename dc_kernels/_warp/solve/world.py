"""What is done to all rows of a world: a sweep, a change of velocities, the residual; one thread a world."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.lanes import has_lanes, lane_functions, row_macros
from dc_kernels._warp.solve.ranges import range_functions, ranges_code
from dc_kernels._warp.solve.row import row_functions
from dc_kernels._warp.solve.trees import tree_functions
from dc_kernels.model.config import JOINT_SOLVERS, METHODS, STOPS
from dc_kernels.solve.iteration import APART, ASTRAY, FALL, FAR, FARTHEST, NEVER, RISE
from dc_kernels.solve.rows import COLORS, COLUMNS, JOINTED, LANES, OWN, ROLLING_COLOR, SERIAL_COLOR, SURFACED

ENDS = wp.constant(COLORS + 1)
N_COLORS = wp.constant(COLORS)
N_LANES = wp.constant(LANES)
SERIAL = wp.constant(SERIAL_COLOR)
ROLLING = wp.constant(ROLLING_COLOR)
JACOBI = wp.constant(METHODS["jacobi"])
DIRECT = wp.constant(JOINT_SOLVERS["direct"])
BY_RESIDUAL = wp.constant(STOPS["residual"])
BY_MOTION = wp.constant(STOPS["motion"])
NO_PAUSE = wp.constant(NEVER)
LED_ASTRAY = wp.constant(ASTRAY)


@cache
def world_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``span_of``, ``load_impulses``, ``natural_map`` of a world's rows, and what moves their impulses."""
    t = group_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    Span = t.Span
    module = kernel_module("solver", dtype, variant)
    row = row_functions(dtype, variant)
    sweep_row, jacobi_row, apply_row = row.sweep_row, row.jacobi_row, row.apply_row
    natural_map_row, moving_row = row.natural_map_row, row.moving_row
    lanes = lane_functions(dtype, variant)
    sweep_lanes, apply_lanes, natural_map_lanes = lanes.sweep, lanes.apply, lanes.natural_map
    extrapolate_lanes, move_on, moving_lanes = lanes.extrapolate, lanes.move_on, lanes.moving
    lacking_lanes, lacking_row = lanes.lacking, row.lacking_row
    ranges = range_functions(dtype)
    restore, beyond, fastest = ranges.restore, ranges.beyond, ranges.fastest
    bound_lanes = lanes.bound
    jointed, own, surfaced = variant in JOINTED, variant in OWN, variant in SURFACED
    one, TOO_FAR, TOO_MUCH = real(1.0), real(FAR), real(APART)
    if own:
        trees = tree_functions(dtype, variant)
        factor_tree, solve_tree, lack_of_tree = trees.factor, trees.solve, trees.lack
    tiny = real(1e-30)
    never = real(-1e18)  # no change is as small
    columns = COLUMNS[variant]
    width = wp.constant(len(columns) * LANES)
    EN = wp.constant(columns.index("en") * LANES)

    @wp.func_native(ranges_code(dtype, "pack/load.h", **row_macros(variant)))
    def load_contacts(
        columns: wp.array(dtype=real),
        slot: wp.array(dtype=wp.int32),
        start: wp.array(dtype=vec2),
        impulse: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func(module=module)
    def span_of(w: int, past_at: int, config: t.Config, model: t.Model, motion: t.Motion, rows: t.Rows):
        """Where a world's rows lie, and the bound at which its solve stops.

        The bound is ``tolerance``, or the impulse ``relative_tolerance`` times weight times time step where that is
        smaller; the latter is left out where the typical weight is zero, and where the residual decides the stop. Where
        the motion decides and nothing weighs there is none: a fixed one would be large for light bodies.
        ``past_at`` counts the scalars of ``rows.past`` before the world's own.
        """
        span = Span()
        span.world = w
        span.first = rows.color_block[w * ENDS]
        span.serial = rows.color_block[w * ENDS + SERIAL]
        span.last = rows.color_block[w * ENDS + N_COLORS]
        span.low = span.first * 2 * N_LANES
        span.high = span.last * 2 * N_LANES
        span.first_body = model.body_start[w]
        span.last_body = model.body_start[w + 1]
        span.past_at = past_at
        span.pause_at = NO_PAUSE
        span.bound = config.tolerance
        relative = config.relative_tolerance * motion.weight[w] * motion.step_dt[w]
        if config.stop != BY_RESIDUAL and relative > real(0.0):
            span.bound = wp.min(config.tolerance, relative)
        dt = motion.step_dt[w]
        span.still = config.motion_tolerance * config.slop * model.length_scale[w] / dt
        if wp.static(jointed):  # what a joint lacks shows as stretch: such a world is solved to the tolerances
            if rows.line_start[w + 1] > rows.line_start[w]:
                span.still = never
        span.fall = real(FALL) * wp.length(model.gravity[w]) * dt
        if config.stop == BY_MOTION and motion.weight[w] == real(0.0) and span.still > real(0.0):
            span.bound = real(0.0)
        return span

    @wp.func(module=module)
    def bound_rolling(span: Span, rows: t.Rows):
        """Bounds of the rows of rolling resistance follow the normal impulses of their contacts."""
        first = rows.color_block[span.world * ENDS + ROLLING]
        bound_lanes(rows.column, rows.limit_slot, rows.impulse, first, span.last)

    @wp.func(module=module)
    def sweep(span: Span, config: t.Config, omega: real, motion: t.Motion, rows: t.Rows):
        """One sweep over all rows of a world in colour order; the largest impulse change [N s]."""
        first = span.first
        change = real(0.0)
        if config.method == JACOBI:
            for k in range(first * N_LANES, span.last * N_LANES):
                change = wp.max(change, jacobi_row(k / N_LANES, k % N_LANES, rows, motion, omega))
            return change
        if has_lanes() == 1:
            change = sweep_lanes(
                rows.column,
                rows.body,
                motion.solved,
                rows.impulse,
                rows.change,
                rows.color_block,
                span.world * ENDS,
                omega,
                span.team,
            )
            first = span.serial  # the lanes have done the colours before it
        # one loop over the rows: Warp would unroll one over lanes, which takes the compiler half a minute
        for k in range(first * N_LANES, span.last * N_LANES):
            change = wp.max(change, sweep_row(k / N_LANES, k % N_LANES, rows, motion.solved, omega))
        return change

    @wp.func(module=module)
    def apply(span: Span, motion: t.Motion, rows: t.Rows, delta: wp.array(dtype=real)):
        """Velocities follow a change of all row impulses of a world: V += M^-1 J^T delta (Wu 2018, equation 2.26)."""
        first = span.first
        if has_lanes() == 1:
            apply_lanes(rows.column, rows.body, motion.solved, delta, rows.color_block, span.world * ENDS, span.team)
            first = span.serial  # the lanes have done the colours before it
        for k in range(first * N_LANES, span.last * N_LANES):
            apply_row(k / N_LANES, k % N_LANES, rows, motion.solved, delta)

    @wp.func(module=module)
    def extrapolate(span: Span, alpha: real, motion: t.Motion, rows: t.Rows):
        """Impulses move on by alpha times their change, within their bounds, and the velocities follow."""
        first = span.first
        bodies = motion.solved
        if has_lanes() == 1:
            extrapolate_lanes(
                rows.column,
                rows.body,
                bodies,
                rows.impulse,
                rows.change,
                rows.color_block,
                span.world * ENDS,
                alpha,
                span.team,
            )
            first = span.serial  # the lanes have done the colours before it
        move_on(rows.column, rows.body, bodies, rows.impulse, rows.change, first, span.last, alpha)
        for k in range(first * N_LANES, span.last * N_LANES):
            apply_row(k / N_LANES, k % N_LANES, rows, bodies, rows.change)

    @wp.func(module=module)
    def refresh(span: Span, motion: t.Motion, rows: t.Rows):
        """Velocities anew from the impulses: steps of momentum add up their round-off."""
        restore(motion.predicted, motion.solved, span.first_body, span.last_body, span.team)
        apply(span, motion, rows, rows.impulse)

    @wp.func(module=module)
    def load_impulses(
        span: Span, config: t.Config, joints: t.Joints, contacts: t.Contacts, motion: t.Motion, rows: t.Rows
    ):
        """Impulses of contacts and joints to the rows; predicted velocities plus what they add.

        A row along which nothing can move has none: no sweep would change it.
        """
        w = span.world
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        load_contacts(
            rows.column, rows.slot, contacts.impulse, rows.impulse, span.first, span.last, start, end, span.team
        )
        if wp.static(jointed):
            for j in range(rows.line_start[w], rows.line_start[w + 1]):
                rows.impulse[rows.joint_slot[j]] = joints.joint_impulse[j]
        if wp.static(own):
            for k in range(rows.row_start[w], rows.row_start[w + 1]):
                i = rows.row_slot[k]
                if i >= 0:  # else it can carry nothing, and has no row
                    if rows.column[i / (2 * N_LANES) * width + i % N_LANES + EN] > real(0.0):
                        rows.impulse[i] = rows.row_impulse[k]
        if wp.static(surfaced):
            if rows.roll_slot.shape[0] > 0:
                for c in range(start, end):
                    i = rows.roll_slot[c]
                    if i >= 0:
                        rows.impulse[i] = contacts.rolling_impulse[c]
                bound_rolling(span, rows)
        refresh(span, motion, rows)
        if wp.static(own):
            for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
                rows.tree_used[tree] = 0

    @wp.func(module=module)
    def natural_map(span: Span, bodies: wp.array(dtype=vec4), rows: t.Rows):
        """Relative natural map of a world's rows [1]: how far its impulses are from a solution.

        It is the 2-norm of the natural maps of all rows over ``rows.scale``, the 2-norm of the impulses that would
        stop each row, with its friction, if it were alone; where that is zero, the former itself [N s].
        """
        first = span.first
        total = real(0.0)
        if has_lanes() == 1:
            total = natural_map_lanes(
                rows.column, rows.body, bodies, rows.impulse, rows.color_block, span.world * ENDS, span.team
            )
            first = span.serial  # the lanes have done the colours before it
        for k in range(first * N_LANES, span.last * N_LANES):
            total += natural_map_row(k / N_LANES, k % N_LANES, rows, bodies)
        total = wp.sqrt(total)
        scale = rows.scale[span.world]
        if scale > tiny:
            total = total / scale
        return total

    @wp.func(module=module)
    def lack(span: Span, times: real, enough: int, rows: t.Rows):
        """Rows without bounds that lacked more of their speed, as the last sweep came to them, than ``times`` still.

        They are counted until there are ``enough``.
        """
        count = int(0)
        still = times * span.still
        if has_lanes() == 1:
            count = lacking_lanes(rows.column, rows.change, span.first, span.last, still, enough)
        else:
            for k in range(span.first * N_LANES, span.last * N_LANES):
                if count < enough:
                    count += lacking_row(k / N_LANES, k % N_LANES, rows, still)
        return count

    @wp.func(module=module)
    def follow(span: Span, change: real, sweeps: int, config: t.Config, motion: t.Motion, rows: t.Rows):
        """Solve the trees of joints that the sweeps by now have left apart; 1 where that was first found of one.

        Sweeps are looked at a sweep before the stop by motion is, long before ``min_sweeps`` for what is far apart, and
        from there on after each where they do not suffice.
        """
        w = span.world
        found = int(0)
        if rows.tree_start[w + 1] == rows.tree_start[w] or config.joint_solver != DIRECT or config.method == JACOBI:
            return found
        late = sweeps >= config.min_sweeps
        looks = (sweeps + 1) % wp.min(config.residual_every, config.max_sweeps) == 0 or (late and change < span.bound)
        times = wp.where(sweeps + 1 < config.min_sweeps, TOO_FAR, TOO_MUCH)
        still = times * span.still
        open = config.stop != BY_MOTION and not (change < span.bound)
        if not (looks or late):
            return found
        if not open and lack(span, times, 1, rows) == 0:
            return found  # a look in lanes, which mostly spares those at each tree
        for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
            used = rows.tree_used[tree]
            if looks or (late and used > 0):
                if open or lack_of_tree(tree, still, 1, rows) == 1:
                    if used == 0:
                        factor_tree(tree, 0, motion.predicted, rows)
                        found = 1
                    rows.tree_used[tree] = sweeps
                    solve_tree(tree, 0, one, one, motion.solved, rows)
        return found

    @wp.func(module=module)
    def is_still(span: Span, sweeps: int, config: t.Config, motion: t.Motion, rows: t.Rows):
        """1 where the last sweep has moved at most one row in MOVING, one in SCARCE far: see ``SolverConfig.stop``.

        Rows of trees that were solved after it hold exactly, whatever they had lacked.
        """
        share = config.motion_share
        rise = real(RISE) * fastest(motion.predicted, span.first_body, span.last_body, span.team)
        least = real(0.0)
        farthest = real(FAR)
        if config.motion_mean > least:
            farthest = real(FARTHEST)
            mean = beyond(motion.solved, motion.predicted, span.first_body, span.last_body, span.fall, span.team)
            least = config.motion_mean * wp.min(mean, rise)
        shares = vec4(share, share * rise, least, farthest)
        if has_lanes() == 1:  # nothing is written, so rows of the serial colour may stand side by side too
            count = moving_lanes(
                rows.column,
                rows.body,
                motion.solved,
                motion.predicted,
                rows.change,
                span,
                shares,
                rows.color_block,
                span.world * ENDS,
            )
        else:
            count = int(0)
            for k in range(span.first * N_LANES, span.last * N_LANES):
                if count <= (span.last - span.first) * N_LANES:
                    here = moving_row(k / N_LANES, k % N_LANES, rows, motion, span, shares)
                    count = wp.where(here == LED_ASTRAY, here, count + here)
        done = wp.where(count <= 0, 1, 0)
        if wp.static(own):
            if done == 1:
                solved = int(0)
                still = TOO_MUCH * span.still
                for tree in range(rows.tree_start[span.world], rows.tree_start[span.world + 1]):
                    if rows.tree_used[tree] == sweeps:
                        solved += lack_of_tree(tree, still, span.high, rows)
                done = wp.where(lack(span, TOO_MUCH, solved + 1, rows) <= solved, 1, 0)
        return done

    return SimpleNamespace(
        span_of=span_of,
        is_still=is_still,
        bound_rolling=bound_rolling,
        sweep=sweep,
        apply=apply,
        extrapolate=extrapolate,
        refresh=refresh,
        load_impulses=load_impulses,
        natural_map=natural_map,
        follow=follow,
    )
