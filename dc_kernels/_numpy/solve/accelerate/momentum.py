"""Nesterov's momentum with restart (Beck and Teboulle 2009; O'Donoghue and Candes 2015), without projection."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.solve.world import World


def reset(world: World) -> None:
    """Begin at the present impulses and velocities, at rest."""
    world.iteration.momentum = 1.0
    world.past[0] = world.impulse
    world.past_velocity[:] = world.motion.solved[world.bodies]


def after_sweep(world: World) -> None:
    """Move on by beta times the last move; begin anew where the sweep goes against it."""
    it, x, last = world.iteration, world.impulse, world.past[0]
    t = it.momentum
    if np.sum(world.change * (x - last)) < 0:
        t = t.dtype.type(1.0)
    it.momentum = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
    beta = x.dtype.type((t - 1.0) / it.momentum)
    for now, before in ((x, last), (world.motion.solved[world.bodies], world.past_velocity)):
        step = now - before
        before[:] = now
        now += beta * step
