"""The iteration of a world's solve: warm start, stop, pause. Shared by both schedules."""

from __future__ import annotations

from typing import Any

from dc_kernels._numpy.solve.accelerate import METHODS, adaptive
from dc_kernels._numpy.solve.row import by_lane
from dc_kernels._numpy.solve.world import BY_MOTION, BY_RESIDUAL, JACOBI, World
from dc_kernels.model.config import ACCELERATIONS
from dc_kernels.solve.iteration import BEST, GROWTH, NEVER, RETREAT, Stretch

AITKEN = ACCELERATIONS["aitken"]
PLAIN = ACCELERATIONS["none"]
ADAPTIVE = ACCELERATIONS["adaptive"]
HUGE = 3e38


def start(world: World) -> None:
    """The iteration from the beginning; it has ended where there is nothing to sweep."""
    it = world.iteration
    it.sweeps, it.change, it.measured = 0, 0.0, -1
    it.least_change = it.step_before = it.step_last = HUGE
    if world.config.acceleration in METHODS:
        METHODS[world.config.acceleration].reset(world)
    it.finished = int(world.config.max_sweeps == 0 or not world.own_rows)


def prepare_sweep(world: World) -> None:
    """A place to sum up Jacobi's changes; bounds of rolling resistance follow the normal impulses."""
    world.bound_rolling()
    if world.config.method == JACOBI:
        world.motion.summed[world.bodies] = world.motion.solved[world.bodies]


def conclude_sweep(world: World, largest: Any) -> bool:
    """Stop (``finished`` then is 1), pause (true), or accelerate; see the Warp function."""
    config, it, stats, rows = world.config, world.iteration, world.stats, world.rows
    if config.method == JACOBI:
        world.motion.solved[world.bodies] = world.motion.summed[world.bodies]
    if stats.history.shape[1] > it.sweeps:
        stats.history[world.w, it.sweeps] = largest
    it.sweeps += 1
    it.change = largest
    last = it.sweeps >= config.max_sweeps
    apart = world.follow(largest)
    if it.sweeps < config.min_sweeps:
        converged = False
    elif config.stop == BY_RESIDUAL:
        look = last or it.sweeps % config.residual_every == 0
        converged = look and world.natural_map() < world.bound
    else:
        converged = largest < world.bound
        if config.stop == BY_MOTION and it.sweeps % config.residual_every == 0:
            converged = converged or world.is_still
    it.finished = int(last or (converged and not apart))
    anew = bool(it.finished) and config.acceleration == ADAPTIVE and it.stretch_method == Stretch.MOMENTUM
    if config.acceleration != PLAIN and world.pause_at == NEVER:
        anew = keep_best(world, largest, last) or anew
    astray = not it.finished and config.acceleration == ADAPTIVE and go_back(world, largest)
    if anew or astray:
        world.refresh()
    if it.finished or astray:
        return False
    inside = it.inside + 1
    if config.acceleration in METHODS and METHODS[config.acceleration].after_sweep(world):
        return True
    if it.sweeps >= world.pause_at - 1 and (config.acceleration != AITKEN or inside < 0):
        it.step_before, it.step_last = it.step_last, world.squared_step
        if it.sweeps >= world.pause_at and it.measured == it.sweeps - 1:
            return True
        it.measured = it.sweeps
        by_lane(rows.before)[world.blocks] = world.change
    return False


def keep_best(world: World, largest: Any, last: bool) -> bool:
    """Keep the impulses of the least change, and go back to them at the cap where the solve was led astray."""
    config, it, x, best = world.config, world.iteration, world.impulse, world.past[BEST]
    first = config.acceleration == ADAPTIVE and it.stretch_sweeps == 0
    if (first or 2 * it.sweeps > config.max_sweeps) and largest < x.dtype.type(0.9) * it.least_change:
        it.least_change = largest
        best[:] = x
    if last and it.least_change < HUGE and not largest <= RETREAT * it.least_change:
        x[:] = best
        it.change = it.least_change
        return True
    return False


def go_back(world: World, largest: Any) -> bool:
    """Whether a sweep changes more than any problem asks for: then to the best impulses, and on by another method."""
    it, x = world.iteration, world.impulse
    if it.sweeps == 1:
        it.change_bound = x.dtype.type(GROWTH) * max(largest, world.rows.scale[world.w])
    if largest <= it.change_bound:
        return False
    if it.least_change < HUGE:
        x[:] = world.past[BEST]
    adaptive.forbid(world)
    return True


def report(world: World) -> None:
    """What a solve tells of itself: sweeps, change, and where it has ended its residual."""
    it, stats, w = world.iteration, world.stats, world.w
    stats.sweeps[w] = it.sweeps
    stats.change[w] = it.change
    if it.finished:
        stats.history[w, it.sweeps :] = 0.0
        stats.residual[w] = world.natural_map()
