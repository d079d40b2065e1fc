"""Adaptive acceleration: Aitken extrapolation, momentum or Anderson's update, whichever has paid most.

A solve is cut into stretches. The step of the first sweep after a stretch tells by how much a sweep of it shrank the
error; the next stretch goes to the method with the best rate, and one that rests gains on it, so that it is tried again
when the active set has changed. The first stretch is Aitken's: most solves end in it and cost no more than with Aitken.
What was tried beside it is written in Warp's file.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.accelerate import aitken, anderson, momentum
from dc_kernels._taichi.solve.lanes import lane_functions
from dc_kernels._taichi.solve.world import ANEW, CHANGE
from dc_kernels.solve.iteration import NEVER, Stretch

AITKEN = int(Stretch.AITKEN)
MOMENTUM = int(Stretch.MOMENTUM)
ANDERSON = int(Stretch.ANDERSON)
UNTRIED = 1e9
OPTIMISM = 0.15  # of the best rate, gained by a method with each stretch of another: it is tried again after some
LEAST_RATE = 1e-4


@cache
def functions(dtype: str, variant: str) -> SimpleNamespace:
    """``reset`` and ``after_sweep``; ``forbid`` where a method has led astray."""
    t = group_types(dtype)
    real, vec3 = t.real, t.vec3
    extrapolate = lane_functions(dtype, variant).extrapolate
    of_aitken, of_momentum, of_anderson = (file.functions(dtype, variant) for file in (aitken, momentum, anderson))
    reset_aitken, end_aitken, measured_by_aitken = of_aitken.reset, of_aitken.end_period, of_aitken.measures
    reset_momentum, with_momentum = of_momentum.reset, of_momentum.after_sweep
    forget_anderson, reset_anderson, end_anderson = of_anderson.forget, of_anderson.reset, of_anderson.end_period

    @ti.func
    def reset(config: t.Config, it: ti.template()):
        """Nothing tried yet; the first stretch will be Aitken's."""
        reset_aitken(config, it)
        forget_anderson(it)
        it.stretch_sweeps = 0
        it.stretch_method = AITKEN
        it.stretch_length = 0
        it.rate = vec3(UNTRIED, UNTRIED, UNTRIED)

    @ti.func
    def forbid(it: ti.template()):
        """Never again the method of this stretch, and the next one at once."""
        for i in ti.static(range(3)):
            if i == it.stretch_method:
                it.rate[i] = -UNTRIED
        it.stretch_sweeps = 0
        it.stretch_length = 0

    @ti.func
    def begin_stretch(span, now, motion: t.Motion, rows: t.Rows, it: ti.template()):
        """Judge the stretch before by the squared step of the sweep after it, and choose the next method."""
        if it.stretch_length > 0:
            rate = 0.0
            if now > 0.0:
                rate = ti.min(0.5 * ti.log(it.stretch_step / now) / real(it.stretch_length), 0.5 * UNTRIED)
            for i in ti.static(range(3)):
                if i == it.stretch_method:
                    it.rate[i] = rate
            best = LEAST_RATE
            for i in ti.static(range(3)):
                if it.rate[i] < UNTRIED:
                    best = ti.max(best, it.rate[i])
            for i in ti.static(range(3)):
                if i != it.stretch_method and it.rate[i] < UNTRIED:
                    it.rate[i] = ti.min(it.rate[i] + OPTIMISM * best, 0.5 * UNTRIED)
        chosen = 0
        highest = it.rate[0]
        for i in ti.static(range(1, 3)):
            if it.rate[i] > highest:
                chosen = i
                highest = it.rate[i]
        it.stretch_method = chosen
        it.inside = 0
        if highest <= -UNTRIED:
            it.inside = -NEVER  # none is left: plain sweeps
        it.stretch_step = now
        if chosen == MOMENTUM:
            reset_momentum(span, motion, rows, it)
        if chosen == ANDERSON:
            reset_anderson(it)

    @ti.func
    def measures(it):
        """Whether ``after_sweep`` asks for the squared step of this sweep."""
        return it.stretch_sweeps == 0 or (it.stretch_method != MOMENTUM and measured_by_aitken(it))

    @ti.func
    def after_sweep(span, now, config: t.Config, motion: t.Motion, rows: t.Rows, it: ti.template()):
        """Let the method of the stretch follow the sweep, and end the stretch when it has lasted; never a pause."""
        follow = 0
        done = it.stretch_sweeps + 1
        it.stretch_sweeps = done
        if done == 1:
            begin_stretch(span, now, motion, rows, it)
        ended = done >= config.stretch
        if it.stretch_method == MOMENTUM:
            if ended:
                follow = ANEW
            else:
                with_momentum(span, motion, rows, it)
        else:
            it.inside += 1
            if it.inside == it.period - 1:
                it.before_end = now
            if it.inside >= it.period:
                updated = 0
                if it.stretch_method == ANDERSON:
                    updated = end_anderson(span, now, config, rows, it)
                if updated == 0:
                    follow = end_aitken(span, now, NEVER, 1, config, rows, it)
                else:
                    extrapolate(rows, span.first, span.last, 1.0)
                    follow = CHANGE
            ended = ended and it.inside == 0
        if ended:
            it.stretch_length = done
            it.stretch_sweeps = 0
        return follow

    return SimpleNamespace(reset=reset, measures=measures, after_sweep=after_sweep, forbid=forbid)
