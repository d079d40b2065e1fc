"""Adaptive acceleration: Aitken extrapolation, momentum or Anderson's update, whichever has paid most."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.solve.accelerate import aitken, anderson, momentum
from dc_kernels._numpy.solve.world import World
from dc_kernels.solve.iteration import NEVER, Stretch

UNTRIED = 1e9


def reset(world: World) -> None:
    """Nothing tried yet; the first stretch will be Aitken's."""
    aitken.reset(world)
    anderson.forget(world)
    it = world.iteration
    it.stretch_sweeps, it.stretch_method, it.stretch_length = 0, Stretch.AITKEN, 0
    it.rate = UNTRIED


def forbid(world: World) -> None:
    """Never again the method of this stretch, and the next one at once."""
    it = world.iteration
    rates = it.rate.copy()
    rates[it.stretch_method] = -UNTRIED
    it.rate = rates
    it.stretch_sweeps = it.stretch_length = 0


def begin_stretch(world: World) -> None:
    """Judge the stretch before by the squared step of the sweep after it, and choose the next method."""
    it = world.iteration
    now = world.squared_step
    rates = it.rate.copy()
    if it.stretch_length > 0:
        chosen = it.stretch_method
        gained = 0.5 * np.log(it.stretch_step / now) / it.stretch_length if now > 0 else 0.0
        rates[chosen] = min(gained, 0.5 * UNTRIED)
        best = max([1e-4, *rates[rates < UNTRIED]])
        for i in range(3):
            if i != chosen and rates[i] < UNTRIED:
                rates[i] = min(rates[i] + 0.15 * best, 0.5 * UNTRIED)
        it.rate = rates
    it.stretch_method = int(np.argmax(rates))
    it.inside = 0 if rates.max() > -UNTRIED else -NEVER  # none is left: plain sweeps
    it.stretch_step = now
    if it.stretch_method == Stretch.MOMENTUM:
        momentum.reset(world)
    if it.stretch_method == Stretch.ANDERSON:
        anderson.reset(world)


def after_sweep(world: World) -> bool:
    """Let the method of the stretch follow the sweep, and end the stretch when its time has come; never a pause."""
    it = world.iteration
    it.stretch_sweeps += 1
    if it.stretch_sweeps == 1:
        begin_stretch(world)
    if it.stretch_method == Stretch.MOMENTUM:
        ended = it.stretch_sweeps >= world.config.stretch
        if ended:
            world.refresh()
        else:
            momentum.after_sweep(world)
    else:
        it.inside += 1
        if it.inside == it.period - 1:
            it.before_end = world.squared_step
        if it.inside >= it.period and not (it.stretch_method == Stretch.ANDERSON and anderson.end_period(world)):
            aitken.end_period(world, NEVER)
        ended = it.stretch_sweeps >= world.config.stretch and it.inside == 0
    if ended:
        it.stretch_length, it.stretch_sweeps = it.stretch_sweeps, 0
    return False
