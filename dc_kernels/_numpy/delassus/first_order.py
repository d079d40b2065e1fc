"""First-order solves in Delassus form from a dense W: Gauss-Seidel and its accelerations, written from the formulas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels
from dc_kernels._numpy.solve.laws import natural_map_squared
from dc_kernels.delassus.groups import Acceleration, Reason

BALLISTIC = 60
PLAIN, PLAIN_MOST = 40, 400
HUGE, TINY = 3e38, 1e-35


def kernels(dtype: str) -> Kernels:
    """The kernels by name."""
    return {"map_delassus": map_delassus, "solve_delassus": solve_delassus}


def _dense(problem: Any) -> Array:
    """W, (n, 2, n, 2)."""
    n = len(problem.mu)
    w = np.zeros((n, 2, n, 2), problem.block.dtype)
    for c in range(n):
        for k in range(problem.row_start[c], problem.row_start[c + 1]):
            w[c, :, problem.column[k], :] += problem.block[k].reshape(2, 2)
    return w


def _inside(x: Array, problem: Any) -> Array:
    """Clamp impulses (n, 2) to their bounds."""
    n = np.maximum(x[:, 0], problem.low)
    limit = np.maximum(problem.mu * n, 0.0)
    return np.stack([n, np.minimum(np.maximum(x[:, 1], -limit), limit)], axis=1)


def _natural_map(x: Array, u: Array, problem: Any) -> float:
    """Norm of r minus the projection of r - (u_n + mu |u_t|, u_t) on the cones, or on the normals of free rows."""
    total = 0.0
    for c, mu in enumerate(problem.mu):
        z = np.array([x[c, 0] - u[c, 0] - mu * abs(u[c, 1]), x[c, 1] - u[c, 1]])
        if problem.low[c] < 0.0:
            total += (x[c, 0] - z[0]) ** 2 + x[c, 1] ** 2
        else:
            total += natural_map_squared(x[c], z, mu)
    return math.sqrt(total)


def _natural_maps(w: Array, scale: float, problem: Any, x: Array) -> tuple[float, float]:
    u = np.einsum("iajb,jb->ia", w, x) + problem.q
    return _natural_map(scale * x, u, problem), _natural_map(x / problem.inverse[:, :1], u, problem)


def map_delassus(tid: int, scale: float, problem: Any, impulse: Array, maps: Array) -> None:
    """Measure the natural map and the scaled one of given impulses."""
    maps[0] = _natural_maps(_dense(problem), scale, problem, impulse)


def solve_delassus(tid: int, settings: Any, problem: Any, search: Any, memory: Any, progress: Any) -> None:
    """Sweep until both natural maps are met, or fell by no ``gain`` in ``patience`` looks, or sweeps are spent."""
    q, mu, low, inverse, couple = problem.q, problem.mu, problem.low, problem.inverse, problem.couple
    step, direction, method, omega = search.step, search.direction, settings.method, settings.omega
    n = len(q)
    w = _dense(problem)
    x = search.impulse.copy()
    looks, sweeps, reason = 0, 0, Reason.SWEEPS
    least, mark, marked = HUGE, HUGE, 0
    aitken = _Aitken(settings)
    pairs: list[tuple[Array, Array]] = []  # Anderson: changes of the ends of sweeps and of their steps
    earlier: tuple[Array, Array, float] | None = None
    last = HUGE
    momentum, moved, travelled, plain, next_plain = 1.0, 0, HUGE, 0, PLAIN
    while True:
        ballistic = method == Acceleration.HYBRID and plain == 0
        if ballistic:
            onward = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
            ahead = x + (momentum - 1.0) / onward * (x - direction)
            momentum, direction[:] = onward, x
            x = _inside(ahead, problem)
        begin = x.copy()
        for c in range(n):
            u = np.einsum("ajb,jb->a", w[c], x) + q[c]
            rn = max(x[c, 0] - omega * inverse[c, 0] * u[0], low[c])
            limit = max(mu[c] * rn, 0.0)
            ut = u[1] + couple[c] * (rn - x[c, 0])
            x[c] = rn, min(max(x[c, 1] - omega * inverse[c, 1] * ut, -limit), limit)
        step[:] = x - begin
        now = float((step * step).sum())
        sweeps += 1
        if sweeps % settings.every == 0 or sweeps >= settings.max_sweeps:
            maps = _natural_maps(w, settings.scale, problem, x)
            if looks < len(search.history):
                search.history[looks] = maps
            looks += 1
            worst = max(maps[0] / settings.tolerance, maps[1] / settings.scaled_tolerance)
            if worst < least:
                least, search.best[:] = worst, x
            if worst < settings.gain * mark:
                mark, marked = worst, looks
            if worst <= 1.0:
                reason = Reason.CONVERGED
                break
            if settings.patience > 0 and looks - marked >= settings.patience:
                reason = Reason.STALLED
                break
        if sweeps >= settings.max_sweeps:
            break
        if method == Acceleration.AITKEN or (method == Acceleration.HYBRID and plain > 0):
            x = _inside(x + aitken.length(now) * step, problem)
            if method == Acceleration.HYBRID:
                plain -= 1
                if plain == 0:
                    momentum, moved, travelled, direction[:] = 1.0, 0, HUGE, x
        elif method == Acceleration.NNCG:
            beta = now / last if sweeps > 1 and now <= last and last > TINY else 0.0
            last = now
            x, direction[:] = _inside(x + beta * direction, problem), beta * direction + step
        elif method == Acceleration.ANDERSON:
            if earlier is not None and now > settings.growth * earlier[2]:
                x, earlier, pairs = earlier[0].copy(), None, []
            else:
                if earlier is not None:
                    pairs = [*pairs, (x - earlier[0], step - earlier[1])][-settings.window :]
                earlier = (x.copy(), step.copy(), now)
                if pairs:
                    steps = np.stack([s.ravel() for _, s in pairs], axis=1)
                    combination = np.linalg.lstsq(steps, step.ravel(), rcond=None)[0]
                    x = _inside(x - sum(a * e for a, (e, _) in zip(combination, pairs, strict=True)), problem)
        elif ballistic:
            if ((-step) * (x - direction)).sum() > 0.0:
                momentum = 1.0
            moved += 1
            if moved == BALLISTIC:
                moved = 0
                if now > 0.25 * travelled:
                    plain, next_plain = next_plain, min(2 * next_plain, PLAIN_MOST)
                    aitken = _Aitken(settings)
                else:
                    next_plain = PLAIN
                travelled = now
    search.impulse[:] = x
    progress[0].sweeps, progress[0].looks, progress[0].reason = sweeps, looks, reason


class _Aitken:
    """How far to move on along a sweep's step, in periods with back-off."""

    def __init__(self, settings: Any) -> None:
        self.least, self.most = settings.aitken_period, settings.aitken_period_max
        self.cap, self.threshold = settings.aitken_cap, settings.aitken_threshold
        self.period, self.inside, self.last, self.ended = self.least, 0, HUGE, HUGE

    def length(self, now: float) -> float:
        """The multiple of the step, from its squared norm; 0 within a period."""
        self.inside += 1
        if self.inside == self.period - 1:
            self.last = now
        if self.inside < self.period:
            return 0.0
        alpha = 0.0
        if now < self.last:
            ratio = math.sqrt(now / self.last)
            alpha = min(ratio / (1.0 - ratio), self.cap) if ratio < 1.0 else self.cap
        longer = now > self.threshold**2 * self.ended
        self.period = min(2 * self.period, self.most) if longer else max(self.least, self.period // 2)
        self.ended, self.inside = now, 0
        return alpha
