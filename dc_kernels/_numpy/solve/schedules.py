"""The solve of packed rows: whole (``solve_world``), or cut at the colours."""

from __future__ import annotations

from functools import partial
from typing import Any

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.solve.accelerate import aitken, nncg
from dc_kernels._numpy.solve.iteration import conclude_sweep, prepare_sweep, report, start
from dc_kernels._numpy.solve.position import position_kernels
from dc_kernels._numpy.solve.row import by_lane, jacobi_row, read_row, sweep_row
from dc_kernels._numpy.solve.world import JACOBI, World, relaxation
from dc_kernels.model.config import ACCELERATIONS
from dc_kernels.solve.iteration import NEVER
from dc_kernels.solve.rows import COLORS, LANES, SERIAL_COLOR

NNCG = ACCELERATIONS["nncg"]


def kernels(dtype: str, variant: str) -> Kernels:
    """All solver kernels of a row variant; the arrays bring their scalar type."""
    world_of = partial(_world_of, variant)

    def solve_world(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        joints: Any,
        contacts: Any,
        motion: Any,
        rows: Any,
        stats: Any,
    ) -> None:
        """The solve of a world, to its end or to a pause, or on from there."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        world = world_of(tid, launch, config, model, motion, rows, stats)
        it = world.iteration
        if not launch.resume:
            world.load_impulses(joints, contacts)
            start(world)
        elif it.finished:
            return
        else:
            anew = bool(stats.replaced[w])
            stats.replaced[w] = 0
            if anew:
                world.load_impulses(joints, contacts)
                if config.acceleration == NNCG:
                    nncg.reset(world)
            if it.postponed:
                it.postponed = 0
                aitken.end_period(world, config.aitken_patience, not anew)
        if launch.pause < NEVER:
            world.pause_at = it.sweeps + launch.pause
        paused = launch.pause == 0
        while not (it.finished or paused):
            prepare_sweep(world)
            paused = conclude_sweep(world, world.sweep())
        report(world)

    def begin(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        joints: Any,
        contacts: Any,
        motion: Any,
        rows: Any,
        stats: Any,
    ) -> None:
        """Colour schedule: warm start."""
        if state.flags[tid + launch.world_offset]:
            return
        world = world_of(tid, launch, config, model, motion, rows, stats)
        world.load_impulses(joints, contacts)
        start(world)

    def before_sweep(
        tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, rows: Any, stats: Any
    ) -> None:
        """Colour schedule: what precedes a sweep."""
        w = tid + launch.world_offset
        if state.flags[w] or stats.iteration[w].finished:
            return
        prepare_sweep(world_of(tid, launch, config, model, motion, rows, stats))
        stats.change[w] = 0.0

    def sweep_color(
        tid: tuple[int, int],
        launch: Any,
        color: int,
        config: Any,
        state: Any,
        motion: Any,
        rows: Any,
        stats: Any,
    ) -> None:
        """Colour schedule: one thread a row of the colour; the serial colour is one thread's."""
        w = tid[0] + launch.world_offset
        if state.flags[w] or stats.iteration[w].finished:
            return
        first, last = rows.color_block[w * (COLORS + 1) + color : w * (COLORS + 1) + color + 2]
        there = range((last - first) * LANES)
        mine = there if color == SERIAL_COLOR and tid[1] == 0 else there[tid[1] : tid[1] + 1]
        if color == SERIAL_COLOR and tid[1] > 0:
            return
        omega = relaxation(config)
        for i in mine:
            block, lane = int(first) + i // LANES, i % LANES
            row = read_row(variant, block, lane, rows, motion.solved)
            if row is None:
                by_lane(rows.change)[block, :, lane] = 0.0
                continue
            if config.method == JACOBI:
                change = jacobi_row(row, rows, motion, omega)
            else:
                change = sweep_row(row, rows, motion.solved, omega)
            stats.change[w] = max(stats.change[w], change)

    def after_sweep(
        tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, rows: Any, stats: Any
    ) -> None:
        """Colour schedule: stop or accelerate."""
        w = tid + launch.world_offset
        if state.flags[w] or stats.iteration[w].finished:
            return
        world = world_of(tid, launch, config, model, motion, rows, stats)
        conclude_sweep(world, stats.change[w])

    def finish(tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, rows: Any, stats: Any) -> None:
        """Colour schedule: what the solve reports."""
        if not state.flags[tid + launch.world_offset]:
            report(world_of(tid, launch, config, model, motion, rows, stats))

    return {
        "solve_world": solve_world,
        "begin": begin,
        "before_sweep": before_sweep,
        "sweep_color": sweep_color,
        "after_sweep": after_sweep,
        "finish": finish,
        **position_kernels(variant),
    }


def _world_of(
    variant: str, tid: int, launch: Any, config: Any, model: Any, motion: Any, rows: Any, stats: Any
) -> World:
    """The world of a thread."""
    past_at = launch.past_offset + tid * launch.past_step
    return World(tid + launch.world_offset, variant, past_at, config, model, motion, rows, stats)
