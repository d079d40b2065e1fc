"""First-order solves in Delassus form from a dense W: Gauss-Seidel and its accelerations, written from the formulas."""

from __future__ import annotations

import math

import numpy as np

from dc_kernels._numpy.common import Array, Kernels

AITKEN, NNCG, ANDERSON, HYBRID = 1, 2, 3, 4
SWEEPS_SPENT, CONVERGED, STALLED = 0, 1, 2
BALLISTIC = 60
HUGE, TINY = 3e38, 1e-35


def kernels(dtype: str) -> Kernels:
    """The kernels by name."""
    return {"map_delassus": map_delassus, "solve_delassus": solve_delassus}


def _dense(block_start: Array, block_col: Array, block: Array) -> Array:
    """W, (n, 2, n, 2)."""
    n = len(block_start) - 1
    w = np.zeros((n, 2, n, 2), block.dtype)
    for c in range(n):
        for k in range(block_start[c], block_start[c + 1]):
            w[c, :, block_col[k], :] += block[k].reshape(2, 2)
    return w


def _inside(x: Array, mu: Array, low: Array) -> Array:
    """Impulses (n, 2) within their bounds."""
    n = np.maximum(x[:, 0], low)
    limit = np.maximum(mu * n, 0.0)
    return np.stack([n, np.minimum(np.maximum(x[:, 1], -limit), limit)], axis=1)


def _map(x: Array, u: Array, mu: Array, low: Array) -> float:
    """Natural map: r minus the projection of (r_n - u_n - mu |u_t|, r_t - u_t) on the cones, by cases."""
    total = 0.0
    for c in range(len(x)):
        z = np.array([x[c, 0] - u[c, 0] - mu[c] * abs(u[c, 1]), x[c, 1] - u[c, 1]])
        if low[c] < 0.0:
            p = np.array([z[0], 0.0])
        elif z[0] >= 0.0 and abs(z[1]) <= mu[c] * z[0]:
            p = z
        elif mu[c] * abs(z[1]) <= -z[0]:
            p = np.zeros(2)
        else:  # the nearer edge
            edge = np.array([1.0, math.copysign(mu[c], z[1])]) / math.hypot(1.0, mu[c])
            p = (edge @ z) * edge
        total += ((x[c] - p) ** 2).sum()
    return math.sqrt(total)


def map_delassus(
    tid: int,
    scale: float,
    block_start: Array,
    block_col: Array,
    block: Array,
    q: Array,
    mu: Array,
    low: Array,
    inverse: Array,
    impulse: Array,
    maps: Array,
) -> None:
    """Both natural maps of given impulses."""
    maps[:] = _maps(_dense(block_start, block_col, block), scale, q, mu, low, inverse, impulse)


def _maps(w: Array, scale: float, q: Array, mu: Array, low: Array, inverse: Array, x: Array) -> tuple[float, float]:
    u = np.einsum("iajb,jb->ia", w, x) + q
    return _map(scale * x, u, mu, low), _map(x / inverse[:, :1], u, mu, low)


def solve_delassus(
    tid: int,
    method: int,
    max_sweeps: int,
    every: int,
    patience: int,
    gain: float,
    tolerance: float,
    scaled_tolerance: float,
    omega: float,
    period_min: int,
    period_max: int,
    cap: float,
    threshold: float,
    window: int,
    growth: float,
    scale: float,
    block_start: Array,
    block_col: Array,
    block: Array,
    q: Array,
    mu: Array,
    low: Array,
    inverse: Array,
    couple: Array,
    impulse: Array,
    step: Array,
    before: Array,
    direction: Array,
    end_change: Array,
    step_change: Array,
    gram: Array,
    weight: Array,
    best: Array,
    history: Array,
    counters: Array,
) -> None:
    """Sweeps from ``impulse`` until both natural maps are met or fell by no ``gain`` in ``patience`` looks."""
    n = len(q)
    w = _dense(block_start, block_col, block)
    x = impulse.copy()
    looks, sweeps, reason = 0, 0, SWEEPS_SPENT
    least, mark, marked = HUGE, HUGE, 0
    aitken = _Aitken(period_min, period_max, cap, threshold)
    pairs: list[tuple[Array, Array]] = []  # Anderson: changes of the ends of sweeps and of their steps
    earlier: tuple[Array, Array, float] | None = None
    last = HUGE
    momentum, moved, travelled, plain, plain_next = 1.0, 0, HUGE, 0, 40
    while True:
        ballistic = method == HYBRID and plain == 0
        if ballistic:
            onward = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
            ahead = x + (momentum - 1.0) / onward * (x - direction)
            momentum, direction[:] = onward, x
            x = _inside(ahead, mu, low)
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
        if sweeps % every == 0 or sweeps >= max_sweeps:
            maps = _maps(w, scale, q, mu, low, inverse, x)
            if looks < len(history):
                history[looks] = maps
            looks += 1
            worst = max(maps[0] / tolerance, maps[1] / scaled_tolerance)
            if worst < least:
                least, best[:] = worst, x
            if worst < gain * mark:
                mark, marked = worst, looks
            if worst <= 1.0:
                reason = CONVERGED
                break
            if patience > 0 and looks - marked >= patience:
                reason = STALLED
                break
        if sweeps >= max_sweeps:
            break
        if method == AITKEN or (method == HYBRID and plain > 0):
            x = _inside(x + aitken.length(now) * step, mu, low)
            if method == HYBRID:
                plain -= 1
                if plain == 0:
                    momentum, moved, travelled, direction[:] = 1.0, 0, HUGE, x
        elif method == NNCG:
            beta = now / last if sweeps > 1 and now <= last and last > TINY else 0.0
            last = now
            x, direction[:] = _inside(x + beta * direction, mu, low), beta * direction + step
        elif method == ANDERSON:
            if earlier is not None and now > growth * earlier[2]:
                x, earlier, pairs = earlier[0].copy(), None, []
            else:
                if earlier is not None:
                    pairs = [*pairs, (x - earlier[0], step - earlier[1])][-window:]
                earlier = (x.copy(), step.copy(), now)
                if pairs:
                    steps = np.stack([s.ravel() for _, s in pairs], axis=1)
                    combination = np.linalg.lstsq(steps, step.ravel(), rcond=None)[0]
                    x = _inside(x - sum(a * e for a, (e, _) in zip(combination, pairs, strict=True)), mu, low)
        elif ballistic:
            if ((-step) * (x - direction)).sum() > 0.0:
                momentum = 1.0
            moved += 1
            if moved == BALLISTIC:
                moved = 0
                if now > 0.25 * travelled:
                    plain, plain_next = plain_next, min(2 * plain_next, 400)
                    aitken = _Aitken(period_min, period_max, cap, threshold)
                else:
                    plain_next = 40
                travelled = now
    impulse[:] = x
    counters[:] = sweeps, looks, reason


class _Aitken:
    """How far to move on along a sweep's step, in periods with back-off."""

    def __init__(self, period_min: int, period_max: int, cap: float, threshold: float) -> None:
        self.least, self.most, self.cap, self.threshold = period_min, period_max, cap, threshold
        self.period, self.inside, self.last, self.ended = period_min, 0, HUGE, HUGE

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
