"""The solve of packed rows in two schedules of one arithmetic.

``solve_world`` runs a world's whole solve in one thread. The other kernels are that solve cut at the colours:
``begin``, then for each sweep ``before_sweep``, ``sweep_color`` colour by colour, ``after_sweep``, and ``finish``.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.elements import element_functions
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.interrupts import is_cut
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.solve.accelerate import accelerate_functions, aitken, nncg
from dc_kernels._taichi.solve.iteration import GOES_ON, PAUSES, iteration_functions
from dc_kernels._taichi.solve.position import position_kernels
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels._taichi.solve.row import row_functions
from dc_kernels._taichi.solve.world import ANEW, ENDS, JACOBI, NOTHING, world_functions
from dc_kernels.model.config import ACCELERATIONS
from dc_kernels.solve.iteration import NEVER
from dc_kernels.solve.rows import LANES, SERIAL_COLOR

NNCG = ACCELERATIONS["nncg"]
UNKNOWN = 3e38  # a residual that nothing asked for


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """All solver kernels of a scalar type and row variant."""
    t = group_types(dtype)
    iteration = iteration_functions(dtype, variant)
    start, conclude_sweep, report = iteration.start, iteration.conclude_sweep, iteration.report
    prepare_sweep, end_sweep, asks_for_residual = (
        iteration.prepare_sweep,
        iteration.end_sweep,
        iteration.asks_for_residual,
    )
    world = world_functions(dtype, variant)
    span_of, sweep, follow, load_impulses = world.span_of, world.sweep, world.follow, world.load_impulses
    natural_map, solve_apart, own = world.natural_map, world.solve_apart, variant == "rows"
    end_period = aitken.functions(dtype, variant).end_period
    reset_nncg = nncg.functions(dtype, variant).reset
    relaxation = accelerate_functions(dtype, variant).relaxation
    squares = range_functions(dtype).squares
    row = row_functions(dtype, variant)
    sweep_row, jacobi_row = row.sweep_row, row.jacobi_row
    of_iteration = element_functions("iteration", dtype)
    load, store = of_iteration.load, of_iteration.store

    @kernel
    def solve_world(
        tid,
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
        """The solve of a world, to its end or to a pause after some ``pause`` sweeps; ``resume`` goes on from there.

        Without ``replaced`` a solve that pauses ends with the bits of one that does not. One that ``cut`` ends after
        the sweep that it is in stays unfinished.
        """
        w = tid + launch.world_offset
        it = load(stats.iteration, w)
        if state.flags[w] == 0 and not (launch.resume == 1 and it.finished == 1):
            span = span_of(w, launch.past_offset + tid * launch.past_step, config, model, motion, rows)
            anew = 1 - launch.resume
            if launch.resume == 1:
                anew = stats.replaced[w]
                stats.replaced[w] = 0
            what = 0  # the velocities are to follow
            if anew == 1:
                load_impulses(span, model, joints, contacts, rows)
                what = ANEW
            done = GOES_ON
            if launch.resume == 0:
                start(span, config, it)
                done = it.finished
            else:
                if anew == 1 and config.acceleration == NNCG:
                    reset_nncg(it)  # the direction belongs to the impulses before
                if it.postponed == 1:
                    it.postponed = 0
                    now = squares(rows, span.low, span.high)
                    change = end_period(span, now, config.aitken_patience, 1 - anew, config, rows, it)
                    if anew == 0:
                        what = change
            if launch.pause < NEVER:
                span.pause_at = it.sweeps + launch.pause
                if launch.pause == 0 and done == GOES_ON:
                    done = PAUSES
            omega = relaxation(config)
            sweeping = 1
            asks = 0
            residual = 0.0
            while sweeping == 1:
                follow(span, what, config, motion, rows)
                largest = 0.0
                apart = 0
                # it is known where the last sweep asked for it, and the velocities have stayed
                asks = ti.cast(it.finished == 1 and (asks == 0 or what != NOTHING), ti.i32)
                if done == GOES_ON:
                    prepare_sweep(span, config, motion)
                    largest = sweep(span, config, omega, motion, rows)
                    end_sweep(span, config, motion)
                    if ti.static(own):
                        apart = solve_apart(span, largest, it.sweeps + 1, config, motion, rows)
                    asks = asks_for_residual(span, largest, it.sweeps + 1, config, motion, rows)
                    residual = UNKNOWN
                if asks == 1:  # in the middle and at the end: compiled once
                    residual = natural_map(span, config, motion.solved, rows)
                if done == GOES_ON:
                    done, what = conclude_sweep(span, largest, residual, apart, config, motion, rows, stats, it)
                    if is_cut((span.last - span.first) * LANES, launch.cut):
                        done = PAUSES
                else:
                    sweeping = 0
                    report(span, residual, stats, it)
            store(stats.iteration, w, it)

    @kernel
    def begin(
        tid,
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
        """Colour schedule: warm start."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            span = span_of(w, 0, config, model, motion, rows)
            load_impulses(span, model, joints, contacts, rows)
            follow(span, ANEW, config, motion, rows)
            it = load(stats.iteration, w)
            start(span, config, it)
            store(stats.iteration, w, it)

    @kernel
    def before_sweep(
        tid,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: what a sweep needs to know of the state before it."""
        w = tid + launch.world_offset
        it = load(stats.iteration, w)
        if state.flags[w] == 0 and it.finished == 0:
            prepare_sweep(span_of(w, 0, config, model, motion, rows), config, motion)
            stats.change[w] = 0.0

    @kernel
    def sweep_color(
        tid_world,
        i,
        launch: t.Launch,
        color: ti.i32,
        config: t.Config,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: one thread a row of the colour; the serial colour is one thread's."""
        w = tid_world + launch.world_offset
        it = load(stats.iteration, w)
        if state.flags[w] == 0 and it.finished == 0:
            first = rows.color_block[w * ENDS + color]
            rows_here = (rows.color_block[w * ENDS + color + 1] - first) * LANES
            last = ti.min(i + 1, rows_here)
            if color == SERIAL_COLOR:
                last = 0
                if i == 0:
                    last = rows_here
            omega = relaxation(config)
            change = 0.0
            for k in range(i, last):
                block = first + k // LANES
                lane = k % LANES
                if config.method == JACOBI:
                    change = ti.max(change, jacobi_row(block, lane, rows, motion.solved, motion.summed, omega))
                else:
                    change = ti.max(change, sweep_row(block, lane, rows, motion.solved, omega))
            stats.change[w] = ti.max(stats.change[w], change)

    @kernel
    def after_sweep(
        tid,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: stop or accelerate."""
        w = tid + launch.world_offset
        it = load(stats.iteration, w)
        if state.flags[w] == 0 and it.finished == 0:
            span = span_of(w, launch.past_offset + tid * launch.past_step, config, model, motion, rows)
            end_sweep(span, config, motion)
            apart = 0
            if ti.static(own):
                apart = solve_apart(span, stats.change[w], it.sweeps + 1, config, motion, rows)
            residual = UNKNOWN
            if asks_for_residual(span, stats.change[w], it.sweeps + 1, config, motion, rows) == 1:
                residual = natural_map(span, config, motion.solved, rows)
            _, what = conclude_sweep(span, stats.change[w], residual, apart, config, motion, rows, stats, it)
            follow(span, what, config, motion, rows)
            store(stats.iteration, w, it)

    @kernel
    def finish(
        tid,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: what the solve reports."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            it = load(stats.iteration, w)
            span = span_of(w, 0, config, model, motion, rows)
            residual = 0.0
            if it.finished == 1:
                residual = natural_map(span, config, motion.solved, rows)
            report(span, residual, stats, it)

    return {
        "solve_world": solve_world,
        "begin": begin,
        "before_sweep": before_sweep,
        "sweep_color": sweep_color,
        "after_sweep": after_sweep,
        "finish": finish,
        **position_kernels(dtype, variant),
    }
