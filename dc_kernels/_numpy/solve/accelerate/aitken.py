"""Aitken's extrapolation: every few sweeps the impulses move on along their last step, to where it would end."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.solve.row import by_lane
from dc_kernels._numpy.solve.world import World

HUGE = 3e38


def reset(world: World) -> None:
    """A first period of the shortest length; no squared step is known."""
    it = world.iteration
    it.period, it.inside, it.stalled, it.postponed = world.config.aitken_period, 0, 0, 0
    it.plain_sweeps = 2 * world.config.aitken_period_max
    it.before_end = it.at_end = it.least_step = HUGE


def end_period(world: World, patience: int, move: bool = True) -> None:
    """The end of a period: extrapolate, unless ``move`` is false, and choose the length of the next."""
    it, config = world.iteration, world.config
    now = world.squared_step
    if now < it.before_end and move:
        ratio = np.sqrt(now / it.before_end)
        # the limit of the geometric series, if it is not too far away
        cap = config.aitken_cap
        world.extrapolate(ratio / (1.0 - ratio) if ratio < cap * (1.0 - ratio) else cap)
    if now > config.aitken_threshold * config.aitken_threshold * it.at_end:
        it.period = min(2 * it.period, config.aitken_period_max)
    else:
        it.period = max(config.aitken_period, it.period // 2)
    it.at_end = now
    it.inside = 0
    it.stalled += 1
    if now < it.least_step:
        it.least_step = now
        it.stalled = 0
    if it.stalled >= patience:  # the extrapolation cycles: plain sweeps, each time twice as many
        it.inside = -it.plain_sweeps
        it.plain_sweeps *= 2
        it.stalled = 0


def after_sweep(world: World) -> bool:
    """Count the sweep into its period, and end that; true where the solve pauses with the extrapolation to come."""
    it = world.iteration
    it.inside += 1
    if it.inside == it.period - 1:
        it.before_end = world.squared_step
        if it.sweeps >= world.pause_at - 1:
            by_lane(world.rows.before)[world.blocks] = world.change
    if it.inside >= it.period:
        if it.sweeps >= world.pause_at:  # the extrapolation waits: it is made when the solve goes on
            it.postponed = 1
            it.step_before, it.step_last = it.before_end, world.squared_step
            return True
        end_period(world, world.config.aitken_patience)
    return False
