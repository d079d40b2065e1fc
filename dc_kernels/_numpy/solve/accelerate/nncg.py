"""Nonsmooth nonlinear conjugate gradients (Silcowitz, Niebe and Erleben 2010): Fletcher and Reeves over the sweeps."""

from __future__ import annotations

import numpy as np

from dc_kernels._numpy.solve.row import by_lane
from dc_kernels._numpy.solve.world import World


def reset(world: World) -> None:
    """Begin with the steepest direction."""
    world.iteration.at_end = 0.0


def after_sweep(world: World) -> bool:
    """Move on along the conjugate direction; start anew where the step has grown. It never pauses."""
    it, change = world.iteration, world.change
    now = world.squared_step
    beta = change.dtype.type(0)
    if it.sweeps > 1 and now <= it.at_end and it.at_end > 0:
        beta = now / it.at_end
    it.at_end = now
    direction = by_lane(world.rows.direction)[world.blocks]
    step = beta * direction if beta > 0 else np.zeros_like(direction)
    direction[:] = step + change
    world.impulse[:] += step
    change[:] = step
    if beta > 0:
        world.apply(world.rows.change)
    return False
