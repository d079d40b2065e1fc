"""Anderson's update (1965) from two remembered iterates, every few sweeps; it rests where it did harm."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels._numpy.solve.world import World
from dc_kernels.solve.iteration import ANDERSON_PERIOD, ANDERSON_REST, ANDERSON_REST_MAX

DAMPING = 1e-5


def forget(world: World) -> None:
    """Nothing tried: the first rest will be the shortest."""
    reset(world)
    world.iteration.next_rest = ANDERSON_REST


def reset(world: World) -> None:
    """Begin a stretch: no iterate is remembered, none is resting."""
    it = world.iteration
    it.rest = it.remembered = it.updated = 0


def coefficients(s: Array, kept: int) -> tuple[Any, Any]:
    """A and b of the least squares ||change - a (change - change_1) - b (change - change_2)|| -> min."""
    zero = s.dtype.type(0)
    trace = s[0] + s[2]
    if not trace > 0:
        return zero, zero
    g11, g12, g22, r1, r2 = s[:5] / trace
    g11, g22 = g11 + s.dtype.type(DAMPING), g22 + s.dtype.type(DAMPING)
    if kept == 1:
        return r1 / g11, zero
    det = g11 * g22 - g12 * g12
    return (r1 * g22 - r2 * g12) / det, (r2 * g11 - r1 * g12) / det


def end_period(world: World) -> bool:
    """The end of a period: an update from this and two remembered iterates; false while that rests."""
    it, x, change, past = world.iteration, world.impulse, world.change, world.past
    now = world.squared_step
    if it.updated and now > it.before_update:
        it.remembered = 0
        it.rest = it.next_rest
        it.next_rest = min(2 * it.next_rest, ANDERSON_REST_MAX)
    elif now < 0.25 * it.at_end:
        it.next_rest = max(ANDERSON_REST, it.next_rest // 2)
    it.updated = 0
    kept, rest = int(it.remembered), int(it.rest)
    it.rest = max(rest - 1, 0)
    it.remembered = min(kept + 1, 2)
    if rest or not kept:
        remember(past, x, change)
        return False
    e1, e2 = x - past[0], x - past[2]
    f1, f2 = change - past[1], change - past[3]
    if kept < 2:
        e2, f2 = np.zeros_like(e1), np.zeros_like(f1)
    pairs = ((f1, f1), (f1, f2), (f2, f2), (f1, change), (f2, change), (e1, e1), (e1, e2), (e2, e2))
    it.products = [np.sum(p * q) for p, q in pairs]
    e11, e12, e22 = it.products[5:]
    a, b = coefficients(it.products, kept)
    length = a * a * e11 + 2 * a * b * e12 + b * b * e22
    cap = world.config.aitken_cap
    scale = cap * np.sqrt(now / length) if length > cap * cap * now else 1.0
    move = x.dtype.type(a * scale) * e1 + x.dtype.type(b * scale) * e2
    remember(past, x, change)
    change[:] = -move
    it.before_update = it.at_end = now
    it.updated = 1
    world.extrapolate(1.0)
    it.period = max(ANDERSON_PERIOD, world.config.aitken_period)
    it.inside = 0
    return True


def remember(past: Array, x: Array, change: Array) -> None:
    """The latest iterate and its step go in front."""
    past[2:4] = past[:2].copy()
    past[0], past[1] = x, change
