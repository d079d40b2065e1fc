"""The solve of packed rows in two schedules of one arithmetic.

``solve_world`` runs a world's whole solve in one thread. The other kernels are that solve cut at the colours:
``begin``, then for each sweep ``before_sweep``, ``sweep_color`` colour by colour, ``after_sweep``, and ``finish``.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import is_set, kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.accelerate import accelerate_functions, aitken, nncg
from dc_kernels._warp.solve.iteration import ENDED, GOES_ON, PAUSES, iteration_functions
from dc_kernels._warp.solve.position import position_kernels
from dc_kernels._warp.solve.row import row_functions
from dc_kernels._warp.solve.world import ENDS, JACOBI, N_LANES, NO_PAUSE, SERIAL, world_functions
from dc_kernels.model.config import ACCELERATIONS

NNCG = wp.constant(ACCELERATIONS["nncg"])


@cache
def kernels(dtype: str, variant: str) -> dict[str, Any]:
    """All solver kernels of a scalar type and row variant."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    colors = kernel_module("colors", dtype, variant)
    iteration = iteration_functions(dtype, variant)
    start, prepare_sweep, conclude_sweep, report = vars(iteration).values()
    world = world_functions(dtype, variant)
    span_of, sweep, load_impulses = world.span_of, world.sweep, world.load_impulses
    end_period = aitken.functions(dtype, variant).end_period
    reset_nncg = nncg.functions(dtype, variant).reset
    relaxation = accelerate_functions(dtype, variant).relaxation
    row = row_functions(dtype, variant)
    sweep_row, jacobi_row = row.sweep_row, row.jacobi_row

    # one function that is called once: what follows is then inlined, and its groups are not copied at each sweep
    @wp.func(module=module)
    def solve(
        tid: int,
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        joints: t.Joints,
        contacts: t.Contacts,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """The solve of a world; see ``solve_world``."""
        w = tid + launch.world_offset
        span = span_of(w, launch.past_offset + tid * launch.past_step, config, model, motion, rows)
        span.team = launch.team
        done = GOES_ON
        if launch.resume == 0:
            load_impulses(span, config, joints, contacts, motion, rows)
            start(span, config, stats.iteration)
            done = stats.iteration[w].finished
        else:
            if stats.iteration[w].finished == 1:
                return
            anew = stats.replaced[w]
            if anew == 1:
                stats.replaced[w] = 0
                load_impulses(span, config, joints, contacts, motion, rows)
                if config.acceleration == NNCG:
                    reset_nncg(w, config, stats.iteration)  # the direction belongs to the impulses before
            if stats.iteration[w].postponed == 1:
                stats.iteration[w].postponed = 0
                end_period(span, config.aitken_patience, 1 - anew, config, motion, rows, stats.iteration)
        if launch.pause < NO_PAUSE:
            span.pause_at = stats.iteration[w].sweeps + launch.pause
            if launch.pause == 0 and done == GOES_ON:
                done = PAUSES
        omega = relaxation(config)
        while done == GOES_ON:
            prepare_sweep(span, config, motion, rows)
            largest = sweep(span, config, omega, motion, rows)
            done = conclude_sweep(span, largest, config, motion, rows, stats)
            if is_set(launch.cut) == 1:
                break
        report(span, done, motion, rows, stats)

    @wp.kernel(module=module, enable_backward=False)
    def solve_world(
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
        tid = wp.tid()
        if state.flags[tid + launch.world_offset] != 0:
            return
        solve(tid, launch, config, model, joints, contacts, motion, rows, stats)

    @wp.kernel(module=colors, enable_backward=False)
    def begin(
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
        w = wp.tid() + launch.world_offset
        if state.flags[w] != 0:
            return
        span = span_of(w, 0, config, model, motion, rows)
        load_impulses(span, config, joints, contacts, motion, rows)
        start(span, config, stats.iteration)

    @wp.kernel(module=colors, enable_backward=False)
    def before_sweep(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: what a sweep needs to know of the state before it."""
        w = wp.tid() + launch.world_offset
        if state.flags[w] != 0 or stats.iteration[w].finished != 0:
            return
        prepare_sweep(span_of(w, 0, config, model, motion, rows), config, motion, rows)
        stats.change[w] = real(0.0)

    @wp.kernel(module=colors, enable_backward=False)
    def sweep_color(
        launch: t.Launch,
        color: int,
        config: t.Config,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: one thread a row of the colour; the serial colour is one thread's."""
        tid_world, i = wp.tid()
        w = tid_world + launch.world_offset
        if state.flags[w] != 0 or stats.iteration[w].finished != 0:
            return
        first = rows.color_block[w * ENDS + color]
        rows_here = (rows.color_block[w * ENDS + color + 1] - first) * N_LANES
        last = wp.min(i + 1, rows_here)
        if color == SERIAL:
            if i > 0:
                return
            last = rows_here
        omega = relaxation(config)
        change = real(0.0)
        for k in range(i, last):
            block = first + k / N_LANES
            lane = k % N_LANES
            if config.method == JACOBI:
                change = wp.max(change, jacobi_row(block, lane, rows, motion, omega))
            else:
                change = wp.max(change, sweep_row(block, lane, rows, motion.solved, omega))
        if change > real(0.0):
            wp.atomic_max(stats.change, w, change)

    @wp.kernel(module=colors, enable_backward=False)
    def after_sweep(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: stop or accelerate."""
        tid = wp.tid()
        w = tid + launch.world_offset
        if state.flags[w] != 0 or stats.iteration[w].finished != 0:
            return
        span = span_of(w, launch.past_offset + tid * launch.past_step, config, model, motion, rows)
        conclude_sweep(span, stats.change[w], config, motion, rows, stats)

    @wp.kernel(module=colors, enable_backward=False)
    def finish(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Colour schedule: what the solve reports."""
        w = wp.tid() + launch.world_offset
        if state.flags[w] != 0:
            return
        report(span_of(w, 0, config, model, motion, rows), ENDED, motion, rows, stats)

    return {
        "solve_world": solve_world,
        "begin": begin,
        "before_sweep": before_sweep,
        "sweep_color": sweep_color,
        "after_sweep": after_sweep,
        "finish": finish,
        **position_kernels(dtype, variant),
    }
