"""Acceleration "adaptive": Aitken extrapolation, momentum or Anderson's update, whichever has paid most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels.solve.iteration import (
    ADAPT_AITKEN,
    ADAPT_ANDERSON,
    ADAPT_MOMENTUM,
    ANDERSON_PERIOD,
    ANDERSON_REST,
    ANDERSON_REST_MAX,
)

AITKEN, MOMENTUM, ANDERSON = ADAPT_AITKEN, ADAPT_MOMENTUM, ADAPT_ANDERSON
UNTRIED = 1e9
DAMPING = 1e-5


def reset_adaptive(counter: Array, norm: Array) -> None:
    """Nothing tried yet."""
    counter[8:] = 0
    counter[12] = ANDERSON_REST
    norm[6:9] = UNTRIED


@dataclass
class Adaptive:
    """What follows a sweep of one world that did not end its solve; see the Warp functions."""

    counter: Array
    norm: Array
    x: Array
    """Impulses of the rows, by lane; ``change``: the sweep's; ``history``: x1, change1, x2, change2."""
    change: Array
    history: Array
    solved: Array
    before: Array
    end_period: Callable[[], None]
    extrapolate: Callable[[], None]
    refresh: Callable[[], None]

    def adapt(self, stretch: int, period_min: int, cap: float) -> None:
        """The next move of the method whose stretch it is."""
        counter, norm = self.counter, self.norm
        counter[8] += 1
        if counter[8] == 1:
            self.begin_stretch()
        if counter[9] == MOMENTUM:
            ended = counter[8] >= stretch
            if ended:
                self.refresh()
            else:
                self.momentum()
        else:
            counter[1] += 1
            if counter[1] == counter[2] - 1:
                norm[1] = np.sum(self.change**2)
            if counter[1] >= counter[2]:
                if counter[9] == AITKEN:
                    self.end_period()
                else:
                    self.anderson_period(period_min, cap)
            ended = counter[8] >= stretch and counter[1] == 0
        if ended:
            counter[10] = counter[8]
            counter[8] = 0

    def begin_stretch(self) -> None:
        """Judge the stretch before, and choose the next method."""
        counter, norm = self.counter, self.norm
        now = np.sum(self.change**2)
        chosen = counter[9]
        rates = norm[6:9]
        if counter[10] > 0:
            gained = 0.5 * np.log(norm[9] / now) / counter[10] if now > 0 else 0.0
            rates[chosen] = min(gained, 0.5 * UNTRIED)
            best = max([1e-4, *rates[rates < UNTRIED]])
            for i in range(3):
                if i != chosen and rates[i] < UNTRIED:
                    rates[i] = min(rates[i] + 0.15 * best, 0.5 * UNTRIED)
        chosen = int(np.argmax(rates))
        counter[9] = chosen
        counter[1] = 0
        norm[9] = now
        if chosen == MOMENTUM:
            norm[10] = 1.0
            self.history[0] = self.x
            self.before[:] = self.solved
        if chosen == ANDERSON:
            counter[11] = counter[13] = counter[14] = 0

    def momentum(self) -> None:
        """Nesterov's step, begun anew where the sweep goes against it."""
        norm, last = self.norm, self.history[0]
        t = norm[10]
        if np.sum(self.change * (self.x - last)) < 0:
            t = 1.0
        norm[10] = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        beta = self.x.dtype.type((t - 1.0) / norm[10])
        for now, before in ((self.x, last), (self.solved, self.before)):
            step = now - before
            before[:] = now
            now += beta * step

    def anderson_period(self, period_min: int, cap: float) -> None:
        """The end of a period: Anderson's update, or Aitken's while that rests."""
        counter, norm, history = self.counter, self.norm, self.history
        now = np.sum(self.change**2)
        if counter[14] and now > norm[11]:
            counter[13] = 0
            counter[11] = counter[12]
            counter[12] = min(2 * counter[12], ANDERSON_REST_MAX)
        elif now < 0.25 * norm[2]:
            counter[12] = max(ANDERSON_REST, counter[12] // 2)
        counter[14] = 0
        kept, rest = counter[13], counter[11]
        counter[11] = max(rest - 1, 0)
        counter[13] = min(kept + 1, 2)
        if rest or not kept:
            self.remember()
            self.end_period()
            return
        e1, e2 = self.x - history[0], self.x - history[2]
        f1, f2 = self.change - history[1], self.change - history[3]
        if kept < 2:
            e2, f2 = np.zeros_like(e1), np.zeros_like(f1)
        pairs = ((f1, f1), (f1, f2), (f2, f2), (f1, self.change), (f2, self.change), (e1, e1), (e1, e2), (e2, e2))
        norm[12:20] = [np.sum(p * q) for p, q in pairs]
        e11, e12, e22 = norm[17:20]
        a = b = norm.dtype.type(0)
        trace = norm[12] + norm[14]
        if trace > 0:
            g11, g12, g22, r1, r2 = norm[12:17] / trace
            g11, g22 = g11 + norm.dtype.type(DAMPING), g22 + norm.dtype.type(DAMPING)
            if kept == 1:
                a = r1 / g11
            else:
                det = g11 * g22 - g12 * g12
                a, b = (r1 * g22 - r2 * g12) / det, (r2 * g11 - r1 * g12) / det
        length = a * a * e11 + 2 * a * b * e12 + b * b * e22
        scale = cap * np.sqrt(now / length) if length > cap * cap * now else 1.0
        move = self.x.dtype.type(a * scale) * e1 + self.x.dtype.type(b * scale) * e2
        self.remember()
        self.change[:] = -move
        norm[11] = norm[2] = now
        counter[14] = 1
        self.extrapolate()
        counter[2] = max(ANDERSON_PERIOD, period_min)
        counter[1] = 0

    def remember(self) -> None:
        """The latest iterate and its step go in front."""
        self.history[2:4] = self.history[:2].copy()
        self.history[0], self.history[1] = self.x, self.change
