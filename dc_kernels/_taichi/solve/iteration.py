"""The iteration of a world's solve: warm start, stop, pause; what follows a sweep is the acceleration's.

``it`` is the world's struct of ``stats.iteration``, which a solve loads once and stores at its end.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.accelerate import POSTPONED, accelerate_functions, adaptive
from dc_kernels._taichi.solve.ranges import range_functions
from dc_kernels._taichi.solve.world import ANEW, BY_MOTION, BY_RESIDUAL, JACOBI, world_functions
from dc_kernels.model.config import ACCELERATIONS
from dc_kernels.solve.iteration import ASKEW, BEST, GROWTH, NEVER, RETREAT, Stretch

AITKEN = ACCELERATIONS["aitken"]
ADAPTIVE = ACCELERATIONS["adaptive"]
PLAIN = ACCELERATIONS["none"]
MOMENTUM = int(Stretch.MOMENTUM)
HUGE = 3e38
GOES_ON = 0  # what conclude_sweep returns
ENDED = 1
PAUSES = 2


@cache
def iteration_functions(dtype: str, variant: str) -> SimpleNamespace:
    """What a world's solve does around its sweeps.

    ``start``, then ``prepare_sweep``, ``end_sweep``, ``asks_for_residual`` and ``conclude_sweep``; at last ``report``.
    """
    t = group_types(dtype)
    accelerate = accelerate_functions(dtype, variant)
    reset, accelerated = accelerate.reset, accelerate.after_sweep
    forbid = adaptive.functions(dtype, variant).forbid
    ranges = range_functions(dtype)
    squares, copy = ranges.squares, ranges.copy
    world = world_functions(dtype, variant)
    is_still = world.is_still

    @ti.func
    def start(span, config: t.Config, it: ti.template()):
        """The iteration from the beginning; it has ended where there is nothing to sweep."""
        it.sweeps = 0
        it.finished = 0
        it.change = 0.0
        it.least_change = HUGE
        it.measured = -1
        it.step_before = HUGE
        it.step_last = HUGE
        reset(config, it)
        if config.max_sweeps == 0 or span.first == span.last:
            it.finished = 1

    @ti.func
    def prepare_sweep(span, config: t.Config, motion: t.Motion):
        """Copy the velocities to ``motion.summed``, where Jacobi's rows add their changes up during a sweep."""
        if config.method == JACOBI:
            for b in range(span.first_body, span.last_body):
                motion.summed[b] = motion.solved[b]

    @ti.func
    def end_sweep(span, config: t.Config, motion: t.Motion):
        """Take the velocities of ``motion.summed``, behind a sweep of Jacobi's rows."""
        if config.method == JACOBI:
            for b in range(span.first_body, span.last_body):
                motion.solved[b] = motion.summed[b]

    @ti.func
    def asks_for_residual(span, change, sweeps, config: t.Config, motion: t.Motion, rows: t.Rows):
        """1 where after so many sweeps the residual decides if the solve goes on."""
        asks = 0
        due = sweeps % config.residual_every == 0
        if sweeps < config.min_sweeps:
            asks = 0
        elif config.stop == BY_RESIDUAL:
            asks = ti.cast(due or sweeps >= config.max_sweeps, ti.i32)
        elif config.stop == BY_MOTION and due and not (change < span.bound):
            asks = is_still(span, sweeps, config, motion, rows)
        return asks

    @ti.func
    def has_converged(span, change, residual, sweeps, config: t.Config):
        """1 where a sweep ends the solve: at the tolerance, by change, residual or motion, or at the cap."""
        done = 0
        if sweeps < config.min_sweeps:
            done = 0
        elif config.stop == BY_RESIDUAL:
            done = ti.cast(residual < span.bound, ti.i32)
        elif change < span.bound:
            done = 1
        elif config.stop == BY_MOTION:
            done = ti.cast(residual < ASKEW, ti.i32)
        if sweeps >= config.max_sweeps:
            done = 1
        return done

    @ti.func
    def keep_best(span, change, config: t.Config, rows: t.Rows, it: ti.template()):
        """Keep the impulses of the least change, and go back to them at the cap where the solve was led astray: then 1.

        Where plain sweeps circle, as they may with much friction, extrapolation can lead far off, and to NaN.
        """
        back = 0
        first = config.acceleration == ADAPTIVE and it.stretch_sweeps == 0
        best = span.past_at + BEST * (span.high - span.low)
        if (first or 2 * it.sweeps > config.max_sweeps) and change < 0.9 * it.least_change:
            it.least_change = change
            copy(rows.impulse, rows.past, best, span.low, span.high)
        least = it.least_change
        if it.sweeps >= config.max_sweeps and least < HUGE and not (change <= RETREAT * least):
            copy(rows.past, rows.impulse, span.low, best, best + (span.high - span.low))
            it.change = least
            back = 1
        return back

    @ti.func
    def go_back(span, change, rows: t.Rows, it: ti.template()):
        """1 where a sweep changes more than any problem asks for: to the best impulses, and on by another method.

        Along impulses that hardly move a body an acceleration may grow without end: float32 then loses the velocities.
        """
        back = 0
        if it.sweeps == 1:
            it.change_bound = GROWTH * ti.max(change, rows.scale[span.world])
        if not (change <= it.change_bound):
            if it.least_change < HUGE:
                best = span.past_at + BEST * (span.high - span.low)
                copy(rows.past, rows.impulse, span.low, best, best + (span.high - span.low))
            forbid(it)
            back = 1
        return back

    @ti.func
    def conclude_sweep(
        span,
        change,
        residual,
        anew,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        stats: t.Stats,
        it: ti.template(),
    ):
        """Stop, pause or accelerate: ENDED when the world is done, PAUSES where it pauses; and what is to ``follow``.

        With ``anew`` 1 the sweeps go on below the cap, as trees of joints have just been found apart;
        ``residual`` is huge where ``asks_for_residual`` did not ask for it. A pause is due from ``pause_at`` sweeps on,
        where the steps of the last two are known: with Aitken at the end of a period.
        """
        follow = 0
        state = GOES_ON
        w = span.world
        if stats.history.shape[1] > it.sweeps:
            stats.history[w, it.sweeps] = change
        sweeps = it.sweeps + 1
        it.sweeps = sweeps
        it.change = change
        it.finished = has_converged(span, change, residual, sweeps, config)
        if anew == 1 and sweeps < config.max_sweeps:
            it.finished = 0
        if it.finished == 1 and config.acceleration == ADAPTIVE and it.stretch_method == MOMENTUM:
            follow = ANEW
        if config.acceleration != PLAIN and span.pause_at == NEVER:
            if keep_best(span, change, config, rows, it) == 1:
                follow = ANEW
        astray = 0
        if it.finished == 0 and config.acceleration == ADAPTIVE:
            astray = go_back(span, change, rows, it)
        if it.finished == 1:
            state = ENDED
        elif astray == 1:
            follow = ANEW
        else:
            inside = it.inside
            follow = accelerated(span, config, motion, rows, it)
            if follow == POSTPONED:
                state = PAUSES
            elif sweeps >= span.pause_at - 1 and (config.acceleration != AITKEN or inside + 1 < 0):
                it.step_before = it.step_last
                it.step_last = squares(rows, span.low, span.high)
                if sweeps >= span.pause_at and it.measured == sweeps - 1:
                    state = PAUSES
                else:
                    it.measured = sweeps
                    copy(rows.change, rows.before, span.low, span.low, span.high)
        return state, follow

    @ti.func
    def report(span, residual, stats: t.Stats, it: ti.template()):
        """What a solve tells of itself: sweeps, change, and where it has ended its residual."""
        w = span.world
        stats.sweeps[w] = it.sweeps
        stats.change[w] = it.change
        if it.finished == 1:
            for k in range(it.sweeps, stats.history.shape[1]):
                stats.history[w, k] = 0.0
            stats.residual[w] = residual

    return SimpleNamespace(
        start=start,
        prepare_sweep=prepare_sweep,
        end_sweep=end_sweep,
        asks_for_residual=asks_for_residual,
        conclude_sweep=conclude_sweep,
        report=report,
    )
