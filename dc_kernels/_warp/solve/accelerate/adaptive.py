"""Adaptive acceleration: Aitken extrapolation, momentum or Anderson's update, whichever has paid most.

A solve is cut into stretches. The step of the first sweep after a stretch tells by how much a sweep of it shrank the
error; the next stretch goes to the method with the best rate, and one that rests gains on it, so that it is tried again
when the active set has changed. The first stretch is Aitken's: most solves end in it and cost no more than with Aitken.

Momentum is Nesterov's with restart, as in FISTA, but without projection between sweeps, which project anyway: so the
velocities follow by linearity, without a pass over the contacts, and a sweep with it costs a fifth more. Anderson's
update looks back on two periods of three sweeps; where the next step grew it rests, and Aitken's stands in.

Tried on 460 states of piles of discs (100 and 1 000), mixed bodies, mass ratios of 1e4, a stack and a pyramid; sweeps
to a natural map of 1e-4, geometric mean of the scenes' means, of which this takes 203 and Aitken 299:

- Momentum, Aitken in between where it stalls: 202, by the stack (5 times fewer than Aitken); on discs no fewer sweeps,
  each dearer. Anderson alone, safeguarded: 243, by the stack; mixed bodies and mass ratios take more than with Aitken.
- Anderson without a safeguard (3, 5 or 8 back, every 3 to 5 sweeps): up to a sixth of the states hit the cap.
- SOR with a factor chosen by the rate (Young): between fixed factors. 1.7 stalls on 13 of 71 states of 100 discs, 1.9
  on 54: with friction a pile's active set cycles.
- The methods in turns without a choice: 218, and twice as many states at the cap. Stretches of 30: 227, of 80 to 240:
  203-221. One iterate to look back on: 219; three: 202; five: 209.
- Sweeping only blocks of rows that still move, or one of whose bodies does, by more than the default stop's tolerance:
  while 1 000 discs hit each other these are 99 % of the blocks after 32 sweeps and 85 % after 96 (rows: 45 and 18 %),
  of 10 000 discs 98 % after 96. The rows of a block lie apart, and what moves is everywhere.
- Plain sweeps, up to ``min_sweeps``, once a sweep changes no impulse by more than the tolerance: a step of ten boxes at
  rest takes 6 % less, and they creep 13 times as fast, a pyramid of 1 275 boxes a thousand times (0.06 mm/s at most).
- Newton's method on the states that hit a cap: see ``delassus.newton``; worth its factorisations for 1e-6 and less.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.accelerate import aitken, anderson, momentum
from dc_kernels._warp.solve.ranges import range_functions
from dc_kernels._warp.solve.world import ENDS, world_functions
from dc_kernels.solve.iteration import NEVER, Stretch

AITKEN = wp.constant(int(Stretch.AITKEN))
MOMENTUM = wp.constant(int(Stretch.MOMENTUM))
ANDERSON = wp.constant(int(Stretch.ANDERSON))
ALWAYS = wp.constant(NEVER)


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``; ``forbid`` where a method has led astray."""
    t = group_types(dtype)
    real = t.real
    vec3 = wp.types.vector(3, real)
    module = kernel_module("solver", dtype, variant)
    squares = range_functions(dtype).squares
    refresh = world_functions(dtype, variant).refresh
    of_aitken, of_momentum, of_anderson = (file.functions(dtype, variant) for file in (aitken, momentum, anderson))
    reset_aitken, end_aitken = of_aitken.reset, of_aitken.end_period
    reset_momentum, with_momentum = of_momentum.reset, of_momentum.after_sweep
    forget_anderson, reset_anderson, end_anderson = of_anderson.forget, of_anderson.reset, of_anderson.end_period
    untried = real(1e9)
    half = real(0.5)
    zero = real(0.0)
    # of the best rate, gained by a method with each stretch of another: it is tried again after some
    optimism = real(0.15)
    least_rate = real(1e-4)

    @wp.func(module=module)
    def reset(w: int, config: t.Config, iteration: wp.array(dtype=t.Iteration)):
        """Nothing tried yet; the first stretch will be Aitken's."""
        reset_aitken(w, config, iteration)
        forget_anderson(w, iteration)
        iteration[w].stretch_sweeps = 0
        iteration[w].stretch_method = AITKEN
        iteration[w].stretch_length = 0
        iteration[w].rate = vec3(untried, untried, untried)

    @wp.func(module=module)
    def forbid(w: int, iteration: wp.array(dtype=t.Iteration)):
        """Never again the method of this stretch, and the next one at once."""
        rates = iteration[w].rate
        rates[iteration[w].stretch_method] = -untried
        iteration[w].rate = rates
        iteration[w].stretch_sweeps = 0
        iteration[w].stretch_length = 0

    @wp.func(module=module)
    def begin_stretch(
        span: t.Span,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Judge the stretch before by the squared step of the sweep after it, and choose the next method."""
        w = span.world
        now = squares(rows.change, rows.color_block, w * ENDS, span.team)
        length = iteration[w].stretch_length
        chosen = iteration[w].stretch_method
        rates = iteration[w].rate
        if length > 0:
            rate = zero
            if now > zero:
                rate = wp.min(half * wp.log(iteration[w].stretch_step / now) / real(length), half * untried)
            rates[chosen] = rate
            best = least_rate
            for i in range(3):
                if rates[i] < untried:
                    best = wp.max(best, rates[i])
            for i in range(3):
                if i != chosen and rates[i] < untried:
                    rates[i] = wp.min(rates[i] + optimism * best, half * untried)
            iteration[w].rate = rates
        chosen = int(0)
        for i in range(1, 3):
            if rates[i] > rates[chosen]:
                chosen = i
        iteration[w].stretch_method = chosen
        iteration[w].inside = 0
        if rates[chosen] <= -untried:
            iteration[w].inside = -ALWAYS  # none is left: plain sweeps
        iteration[w].stretch_step = now
        if chosen == MOMENTUM:
            reset_momentum(span, motion, rows, iteration)
        if chosen == ANDERSON:
            reset_anderson(w, iteration)

    @wp.func(module=module)
    def after_sweep(
        span: t.Span,
        config: t.Config,
        motion: t.Motion,
        rows: t.Rows,
        iteration: wp.array(dtype=t.Iteration),
    ):
        """Let the method of the stretch follow the sweep, and end the stretch when it has lasted; 0: never a pause."""
        w = span.world
        done = iteration[w].stretch_sweeps + 1
        iteration[w].stretch_sweeps = done
        if done == 1:
            begin_stretch(span, motion, rows, iteration)
        chosen = iteration[w].stretch_method
        if chosen == MOMENTUM:
            ended = done >= config.stretch
            if ended:
                refresh(span, motion, rows)
            else:
                with_momentum(span, motion, rows, iteration)
        else:
            inside = iteration[w].inside + 1
            iteration[w].inside = inside
            period = iteration[w].period
            if inside == period - 1:
                iteration[w].before_end = squares(rows.change, rows.color_block, w * ENDS, span.team)
            if inside >= period:
                updated = int(0)
                if chosen == ANDERSON:
                    updated = end_anderson(span, config, motion, rows, iteration)
                if updated == 0:
                    end_aitken(span, ALWAYS, 1, config, motion, rows, iteration)
            ended = done >= config.stretch and iteration[w].inside == 0
        if ended:
            iteration[w].stretch_length = done
            iteration[w].stretch_sweeps = 0
        return 0

    return SimpleNamespace(reset=reset, after_sweep=after_sweep, forbid=forbid)
