"""What is done to all rows of a world: a sweep, a change of velocities, the residual; one thread a world.

Taichi inlines a function wherever it is called, so what takes long to compile is called once in a solve: changes of
velocities wait for the place where ``follow`` is called, before the next sweep.
"""

from enum import IntEnum
from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.bodies import LANE_BITS, LAST_LANE, body_functions
from dc_kernels._taichi.solve.lanes import lane_functions
from dc_kernels._taichi.solve.ranges import piece, range_functions
from dc_kernels._taichi.solve.row import row_functions
from dc_kernels._taichi.solve.trees import tree_functions
from dc_kernels.model.config import JOINT_SOLVERS, METHODS, STOPS
from dc_kernels.solve.iteration import APART, FALL, FAR, FARTHEST, NEVER, RISE
from dc_kernels.solve.rows import COLORS, COLUMNS, JOINTED, LANES, SERIAL_COLOR

ENDS = COLORS + 1
JACOBI = METHODS["jacobi"]
BY_RESIDUAL = STOPS["residual"]
BY_MOTION = STOPS["motion"]
DIRECT = JOINT_SOLVERS["direct"]
TINY = 1e-30


class Follow(IntEnum):
    """What is left to do to the velocities when the impulses have changed."""

    NOTHING = 0
    CHANGE = 1
    """They follow ``rows.change``."""
    ANEW = 2
    """They are made anew from the impulses: steps of momentum add up their round-off."""


NOTHING = int(Follow.NOTHING)
CHANGE = int(Follow.CHANGE)
ANEW = int(Follow.ANEW)


@cache
def world_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``span_of``, ``sweep``, ``follow``, ``load_impulses`` and ``natural_map`` of a world's rows."""
    t = group_types(dtype)
    vec8 = t.vec8
    Span = t.Span
    row = row_functions(dtype, variant)
    sweep_row, jacobi_row, apply_row = row.sweep_row, row.jacobi_row, row.apply_row
    unknown_floor = body_functions(dtype).unknown_floor
    lanes = lane_functions(dtype, variant)
    sweep_lanes, apply_lanes, natural_map_lanes, moving = lanes.sweep, lanes.apply, lanes.natural_map, lanes.moving
    lacking = lanes.lacking
    beyond, fastest = range_functions(dtype).beyond, range_functions(dtype).fastest
    jointed, own = variant in JOINTED, variant == "rows"
    factor_tree = solve_tree = lack_of_tree = None
    if own:
        trees = tree_functions(dtype, variant)
        factor_tree, solve_tree, lack_of_tree = trees.factor, trees.solve, trees.lack
    columns = COLUMNS[variant]
    width = len(columns)
    EN, ET = columns.index("en"), columns.index("et")

    @ti.func
    def span_of(w, past_at, config: t.Config, model: t.Model, motion: t.Motion, rows: t.Rows):
        """Where a world's rows lie, and the bound at which its solve stops.

        The bound is ``tolerance``, or the impulse ``relative_tolerance`` times weight times time step where that is
        smaller; the latter is left out where the typical weight is zero, and where the residual decides the stop. Where
        the motion decides and nothing weighs there is none: a fixed one would be large for light bodies.
        ``past_at`` counts the scalars of ``rows.past`` before the world's own.
        """
        span = Span()
        span.world = w
        span.first = rows.color_block[w * ENDS]
        span.serial = rows.color_block[w * ENDS + SERIAL_COLOR]
        span.last = rows.color_block[w * ENDS + COLORS]
        span.low = span.first * 2 * LANES
        span.high = span.last * 2 * LANES
        span.first_body = model.body_start[w]
        span.last_body = model.body_start[w + 1]
        span.past_at = past_at
        span.pause_at = NEVER
        span.bound = config.tolerance
        relative = config.relative_tolerance * motion.weight[w] * motion.step_dt[w]
        if config.stop != BY_RESIDUAL and relative > 0.0:
            span.bound = ti.min(config.tolerance, relative)
        dt = motion.step_dt[w]
        span.still = config.motion_tolerance * config.slop * model.length_scale[w] / dt
        if ti.static(jointed):  # what a joint lacks shows as stretch: such a world is solved to the tolerances
            if rows.line_start[w + 1] > rows.line_start[w]:
                span.still = -1e18
        pull = model.gravity[w]
        span.fall = FALL * ti.sqrt(pull[0] * pull[0] + pull[1] * pull[1]) * dt
        if config.stop == BY_MOTION and motion.weight[w] == 0.0 and span.still > 0.0:
            span.bound = 0.0
        return span

    @ti.func
    def sweep(span, config: t.Config, omega, motion: t.Motion, rows: t.Rows):
        """One sweep over all rows of a world in colour order; the largest impulse change [N s]."""
        first = span.first
        change = 0.0
        if config.method == JACOBI:
            for k in range(first * LANES, span.last * LANES):
                moved = jacobi_row(k // LANES, k % LANES, rows, motion.solved, motion.summed, omega)
                change = ti.max(change, moved)
        else:
            change = sweep_lanes(rows, motion.solved, span.world * ENDS, omega, unknown_floor(config))
            for k in range(span.serial * LANES, span.last * LANES):
                change = ti.max(change, sweep_row(k // LANES, k % LANES, rows, motion.solved, omega))
        return change

    @ti.func
    def follow(span, what, config: t.Config, motion: t.Motion, rows: t.Rows):
        """Velocities follow the impulses, V += M^-1 J^T delta (Wu 2018, equation 2.26), as ``what`` says."""
        if what == ANEW:
            for b in range(span.first_body, span.last_body):
                motion.solved[b] = motion.predicted[b]
        if what == ANEW or what == CHANGE:
            anew = ti.cast(what == ANEW, ti.i32)
            apply_lanes(rows, motion.solved, anew, span.first, span.serial, unknown_floor(config))
            for k in range(span.serial * LANES, span.last * LANES):
                apply_row(k // LANES, k % LANES, rows, motion.solved, anew)

    @ti.func
    def load_impulses(span, model: t.Model, joints: t.Joints, contacts: t.Contacts, rows: t.Rows):
        """Impulses of contacts and joints to the rows; velocities are to be made anew then.

        A row along which nothing can move has none: no sweep would change it.
        """
        w = span.world
        start = contacts.contact_start[w]
        for c in range(start, start + contacts.contact_count[w]):
            i = rows.slot[c]
            given = contacts.impulse[c]
            rows.impulse[i >> LANE_BITS][i & LAST_LANE] = given[0]
            rows.impulse[(i >> LANE_BITS) + 1][i & LAST_LANE] = given[1]
        for b in range(span.first, span.last):  # empty lanes have no mass
            along = ti.select(rows.column[b * width + EN] > 0.0, rows.impulse[2 * b], vec8(0.0))
            across = ti.select(rows.column[b * width + ET] > 0.0, rows.impulse[2 * b + 1], vec8(0.0))
            rows.impulse[2 * b] = along
            rows.impulse[2 * b + 1] = across
        if ti.static(jointed):
            for j in range(rows.line_start[w], rows.line_start[w + 1]):
                i = rows.joint_slot[j]
                rows.impulse[i // LANES][i % LANES] = joints.joint_impulse[j]
        if ti.static(own):
            for k in range(rows.row_start[w], rows.row_start[w + 1]):
                i = rows.row_slot[k]
                if i >= 0:  # else it can carry nothing, and has no row
                    if rows.column[i // (2 * LANES) * width + EN][i % LANES] > 0.0:
                        rows.impulse[i // LANES][i % LANES] = rows.row_impulse[k]
            for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
                rows.tree_used[tree] = 0

    @ti.func
    def solve_apart(span, change, sweeps, config: t.Config, motion: t.Motion, rows: t.Rows):
        """Solve the trees of joints that the sweeps by now have left apart; 1 where that was first found of one.

        Sweeps are looked at a sweep before the stop by motion is, long before ``min_sweeps`` for what is far apart, and
        from there on after each where they do not suffice.
        """
        w = span.world
        found = 0
        if rows.tree_start[w + 1] > rows.tree_start[w] and config.joint_solver == DIRECT and config.method != JACOBI:
            late = sweeps >= config.min_sweeps
            every = ti.min(config.residual_every, config.max_sweeps)
            looks = (sweeps + 1) % every == 0 or (late and change < span.bound)
            still = APART * span.still
            if sweeps + 1 < config.min_sweeps:
                still = FAR * span.still
            open = config.stop != BY_MOTION and not (change < span.bound)
            apart = open
            if not open and (looks or late):  # a look in lanes, which mostly spares those at each tree
                apart = lacking(rows, span.first, span.last, still, 1) > 0
            if apart and (looks or late):
                for tree in range(rows.tree_start[w], rows.tree_start[w + 1]):
                    used = rows.tree_used[tree]
                    if looks or used > 0:
                        if open or lack_of_tree(tree, still, rows) > 0:
                            if used == 0:
                                factor_tree(tree, 0, motion.predicted, rows)
                                found = 1
                            rows.tree_used[tree] = sweeps
                            solve_tree(tree, 0, 1.0, 1.0, motion.solved, rows)
        return found

    @ti.func
    def is_still(span, sweeps, config: t.Config, motion: t.Motion, rows: t.Rows):
        """1 where the last sweep has moved at most one row in MOVING, one in SCARCE far: see ``SolverConfig.stop``.

        Rows of trees that were solved after it hold exactly, whatever they had lacked.
        """
        share, floor = config.motion_share, unknown_floor(config)
        rise = RISE * fastest(motion, span.first_body, span.last_body)
        least = 0.0
        farthest = FAR
        if config.motion_mean > 0.0:
            farthest = FARTHEST
            mean = beyond(motion, span.first_body, span.last_body, span.fall)
            least = config.motion_mean * ti.min(mean, rise)
        shares = t.vec4(share, share * rise, least, farthest)
        count = moving(rows, motion, span.first, span.last, span.still, span.fall, shares, floor)
        done = ti.cast(count <= 0, ti.i32)
        if ti.static(own):
            if done == 1:
                solved = 0
                still = APART * span.still
                for tree in range(rows.tree_start[span.world], rows.tree_start[span.world + 1]):
                    if rows.tree_used[tree] == sweeps:
                        solved += lack_of_tree(tree, still, rows)
                done = ti.cast(lacking(rows, span.first, span.last, still, solved + 1) <= solved, ti.i32)
        return done

    @ti.func
    def natural_map(span, config: t.Config, bodies: ti.template(), rows: t.Rows):
        """Relative natural map of a world's rows [1]: how far its impulses are from a solution.

        It is the 2-norm of the natural maps of all rows over ``rows.scale``, the 2-norm of the impulses that would
        stop each row, with its friction, if it were alone; where that is zero, the former itself [N s].
        """
        total = 0.0
        floor = unknown_floor(config)
        begin = span.first
        length = piece(span.serial - span.first, 2 * LANES)
        while begin < span.last:
            end = ti.min(begin + length, span.serial)
            before = total
            start = 0.0
            if begin >= span.serial:  # row after row
                end = span.last
                before = 0.0
                start = total
            total = before + natural_map_lanes(rows, bodies, begin, end, start, floor)
            begin = end
        total = ti.sqrt(total)
        scale = rows.scale[span.world]
        if scale > TINY:
            total = total / scale
        return total

    return SimpleNamespace(
        span_of=span_of,
        sweep=sweep,
        follow=follow,
        load_impulses=load_impulses,
        solve_apart=solve_apart,
        is_still=is_still,
        natural_map=natural_map,
    )
