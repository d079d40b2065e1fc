"""The iteration of a world's solve: warm start, stop, pause; what follows a sweep is the acceleration's."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.accelerate import accelerate_functions, adaptive
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS, world_functions
from dc_kernels.model.config import ACCELERATIONS, METHODS, STOPS
from dc_kernels.solve.iteration import ASKEW, BEST, GROWTH, NEVER, RETREAT, Stretch
from dc_kernels.solve.rows import OWN, SURFACED

JACOBI = wp.constant(METHODS["jacobi"])
AITKEN = wp.constant(ACCELERATIONS["aitken"])
ADAPTIVE = wp.constant(ACCELERATIONS["adaptive"])
PLAIN = wp.constant(ACCELERATIONS["none"])
MOMENTUM = wp.constant(int(Stretch.MOMENTUM))
AT_BEST = wp.constant(BEST)
NO_PAUSE = wp.constant(NEVER)
BY_RESIDUAL = wp.constant(STOPS["residual"])
BY_MOTION = wp.constant(STOPS["motion"])
GOES_ON = wp.constant(0)  # what conclude_sweep returns
ENDED = wp.constant(1)
PAUSES = wp.constant(2)
MEASURED = wp.constant(3)  # ENDED, and the residual is already known


@cache
def iteration_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``start``, ``prepare_sweep``, ``conclude_sweep``, and ``report`` of a world's solve."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("solver", dtype, variant)
    accelerate = accelerate_functions(dtype, variant)
    reset, accelerated = accelerate.reset, accelerate.after_sweep
    forbid = adaptive.functions(dtype, variant).forbid
    copy, squares = range_functions(dtype).copy, range_functions(dtype).squares
    world = world_functions(dtype, variant)
    refresh, natural_map, is_still = world.refresh, world.natural_map, world.is_still
    bound_rolling, surfaced = world.bound_rolling, variant in SURFACED
    follow, own = world.follow, variant in OWN
    huge, TOO_ASKEW = real(3e38), real(ASKEW)

    @wp.func(module=module)
    def start(
        span: t.Span,
        config: t.Config,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """The iteration from the beginning; it has ended where there is nothing to sweep."""
        w = span.world
        iteration[w].sweeps = 0
        iteration[w].finished = 0
        iteration[w].change = real(0.0)
        iteration[w].least_change = huge
        iteration[w].measured = -1
        iteration[w].step_before = huge
        iteration[w].step_last = huge
        reset(w, config, iteration)
        if config.max_sweeps == 0 or span.first == span.last:
            iteration[w].finished = 1

    @wp.func(module=module)
    def prepare_sweep(span: t.Span, config: t.Config, motion: t.Motion, rows: t.Rows):
        """Copy the velocities to ``motion.summed``, where Jacobi's rows add their changes up during a sweep.

        Rows of rolling resistance are bounded by what the normal impulses are before it.
        """
        if wp.static(surfaced):
            bound_rolling(span, rows)
        if config.method == JACOBI:
            for b in range(span.first_body, span.last_body):
                motion.summed[b] = motion.solved[b]

    @wp.func(module=module)
    def has_converged(
        span: t.Span,
        change: real,
        sweeps: int,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        residual: wp.array(dtype=real),
    ):
        """ENDED where a sweep ends the solve: by change, residual or motion, or at the cap; else GOES_ON.

        It is MEASURED where the world's ``residual`` was found on the way.
        """
        done = GOES_ON
        asks = int(0)
        if sweeps >= config.min_sweeps:
            if config.stop == BY_RESIDUAL:
                if sweeps % config.residual_every == 0 or sweeps >= config.max_sweeps:
                    asks = 1
            elif change < span.bound:
                done = ENDED
            elif config.stop == BY_MOTION and sweeps % config.residual_every == 0:
                asks = is_still(span, sweeps, config, motion, rows)
        if asks == 1:
            here = natural_map(span, motion.solved, rows)
            if here < wp.where(config.stop == BY_RESIDUAL, span.bound, TOO_ASKEW) or sweeps >= config.max_sweeps:
                residual[span.world] = here
                done = MEASURED
        if sweeps >= config.max_sweeps and done == GOES_ON:
            done = ENDED
        return done

    @wp.func(module=module)
    def keep_best(span: t.Span, change: real, config: t.Config, rows: t.Rows, iteration: wp.array(dtype=t.Iteration)):
        """Keep the impulses of the least change, and go back to them at the cap where the solve was led astray: then 1.

        Where plain sweeps circle, as they may with much friction, extrapolation can lead far off, and to NaN.
        """
        w = span.world
        sweeps = iteration[w].sweeps
        first = config.acceleration == ADAPTIVE and iteration[w].stretch_sweeps == 0
        best = span.past_at + AT_BEST * (span.high - span.low)
        if (first or 2 * sweeps > config.max_sweeps) and change < real(0.9) * iteration[w].least_change:
            iteration[w].least_change = change
            copy(rows.impulse, span.low, rows.past, best, rows.color_block, w * ENDS, span.team)
        least = iteration[w].least_change
        if sweeps >= config.max_sweeps and least < huge and not (change <= real(RETREAT) * least):
            copy(rows.past, best, rows.impulse, span.low, rows.color_block, w * ENDS, span.team)
            iteration[w].change = least
            return 1
        return 0

    @wp.func(module=module)
    def go_back(span: t.Span, change: real, config: t.Config, rows: t.Rows, iteration: wp.array(dtype=t.Iteration)):
        """1 where a sweep changes more than any problem asks for: to the best impulses, and on by another method.

        Along impulses that hardly move a body an acceleration may grow without end: float32 then loses the velocities.
        """
        w = span.world
        if iteration[w].sweeps == 1:
            iteration[w].change_bound = real(GROWTH) * wp.max(change, rows.scale[w])
        if change <= iteration[w].change_bound:
            return 0
        if iteration[w].least_change < huge:
            best = span.past_at + AT_BEST * (span.high - span.low)
            copy(rows.past, best, rows.impulse, span.low, rows.color_block, w * ENDS, span.team)
        forbid(w, iteration)
        return 1

    @wp.func(module=module)
    def conclude_sweep(
        span: t.Span,
        change: real,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
    ):
        """Stop, pause or accelerate; ENDED or MEASURED when the world is done, PAUSES where it pauses.

        A pause is due from ``pause_at`` sweeps on, where the steps of the last two are known: with Aitken at the end of
        a period.
        """
        w = span.world
        if config.method == JACOBI:
            for b in range(span.first_body, span.last_body):
                motion.solved[b] = motion.summed[b]
        sweeps = stats.iteration[w].sweeps
        if stats.history.shape[1] > sweeps:
            stats.history[w, sweeps] = change
        sweeps += 1
        stats.iteration[w].sweeps = sweeps
        stats.iteration[w].change = change
        found = int(0)
        if wp.static(own):
            found = follow(span, change, sweeps, config, motion, rows)
        done = has_converged(span, change, sweeps, config, motion, rows, stats.residual)
        if found == 1 and sweeps < config.max_sweeps:
            done = GOES_ON
        stats.iteration[w].finished = wp.where(done == GOES_ON, 0, 1)
        anew = done != GOES_ON and config.acceleration == ADAPTIVE and stats.iteration[w].stretch_method == MOMENTUM
        # not where it pauses: the worlds of a shard, solved in turn, share the memory that keeps them
        if config.acceleration != PLAIN and span.pause_at == NO_PAUSE:
            if keep_best(span, change, config, rows, stats.iteration) == 1:
                anew = True
        astray = int(0)
        if done == GOES_ON and config.acceleration == ADAPTIVE:
            astray = go_back(span, change, config, rows, stats.iteration)
        if anew or astray == 1:
            refresh(span, motion, rows)
            done = wp.where(done == GOES_ON, GOES_ON, ENDED)
        if done != GOES_ON:
            return done
        if astray == 1:
            return GOES_ON
        inside = stats.iteration[w].inside
        if accelerated(span, config, motion, rows, stats.iteration) == 1:
            return PAUSES
        if sweeps >= span.pause_at - 1 and (config.acceleration != AITKEN or inside + 1 < 0):
            stats.iteration[w].step_before = stats.iteration[w].step_last
            stats.iteration[w].step_last = squares(rows.change, rows.color_block, w * ENDS, span.team)
            if sweeps >= span.pause_at and stats.iteration[w].measured == sweeps - 1:
                return PAUSES
            stats.iteration[w].measured = sweeps
            copy(rows.change, span.low, rows.before, span.low, rows.color_block, w * ENDS, span.team)
        return GOES_ON

    @wp.func(module=module)
    def report(span: t.Span, done: int, motion: t.Motion, rows: t.Rows, stats: t.Stats):
        """What a solve tells of itself: sweeps, change, and where it has ended its residual, unless MEASURED."""
        w = span.world
        sweeps = stats.iteration[w].sweeps
        stats.sweeps[w] = sweeps
        stats.change[w] = stats.iteration[w].change
        if stats.iteration[w].finished == 1:
            for k in range(sweeps, stats.history.shape[1]):
                stats.history[w, k] = real(0.0)
            if done != MEASURED:
                stats.residual[w] = natural_map(span, motion.solved, rows)

    return SimpleNamespace(start=start, prepare_sweep=prepare_sweep, conclude_sweep=conclude_sweep, report=report)
