"""What is done between two sweeps of a Delassus problem: extrapolation, conjugate directions, combinations, momentum.

The impulses stop at their bounds after each move, and velocities are those of a product with W, so that a move costs
one pass over the contacts. Periods and restarts differ from those of the contact solver, whose velocities follow.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.delassus.groups import search_types
from dc_kernels._warp.solve.accelerate.aitken import series_limit
from dc_kernels._warp.solve.accelerate.momentum import nesterov

BALLISTIC = wp.constant(60)  # sweeps with momentum between two looks at whether it helps
PLAIN, PLAIN_MOST = wp.constant(40), wp.constant(400)  # sweeps without it after it did not


@wp.func
def clamped(x: Any, mu: Any, low: Any):
    """The normal impulse not below ``low``, then friction within its bounds."""
    n = wp.max(x[0], low)
    limit = wp.max(mu * n, type(n)(0.0))
    return type(x)(n, wp.min(wp.max(x[1], -limit), limit))


@cache
def functions(dtype: str) -> SimpleNamespace:
    """``reset``, and what follows a sweep: ``aitken``, ``nncg``, ``anderson``, ``momentum`` (``onward`` before it)."""
    t = search_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("delassus", dtype)
    huge, tiny = real(3e38), real(1e-35)
    zero, one = real(0.0), real(1.0)

    @wp.func(module=module)
    def copy(source: wp.array(dtype=vec2), target: wp.array(dtype=vec2)):
        for c in range(source.shape[0]):
            target[c] = source[c]

    @wp.func(module=module)
    def reset(settings: t.Settings, progress: wp.array(dtype=t.Progress)):
        """No sweep is known."""
        progress[0].period = settings.aitken_period
        progress[0].inside = 0
        progress[0].before_end = huge
        progress[0].at_end = huge
        progress[0].last_step = huge
        progress[0].filled = 0
        progress[0].newest = -1
        progress[0].fresh = 1
        progress[0].kept_step = huge
        progress[0].momentum = one
        progress[0].moved = 0
        progress[0].travelled = huge
        progress[0].plain = 0
        progress[0].next_plain = PLAIN

    # ------------------------------------------------------------------ Aitken

    @wp.func(module=module)
    def aitken(
        now: real, settings: t.Settings, problem: t.Problem, search: t.Search, progress: wp.array(dtype=t.Progress)
    ):
        """At the end of a period, move on along the step as far as a geometric series would."""
        inside = progress[0].inside + 1
        period = progress[0].period
        if inside == period - 1:
            progress[0].before_end = now
        if inside >= period:
            before = progress[0].before_end
            if now < before:
                alpha = series_limit(wp.sqrt(now / before), settings.aitken_cap)
                for c in range(problem.mu.shape[0]):
                    x = search.impulse[c] + alpha * search.step[c]
                    search.impulse[c] = clamped(x, problem.mu[c], problem.low[c])
            if now > settings.aitken_threshold * settings.aitken_threshold * progress[0].at_end:
                progress[0].period = wp.min(2 * period, settings.aitken_period_max)
            else:
                progress[0].period = wp.max(settings.aitken_period, period / 2)
            progress[0].at_end = now
            inside = 0
        progress[0].inside = inside

    # ------------------------------------------------------------------ nonlinear conjugate gradients

    @wp.func(module=module)
    def nncg(now: real, problem: t.Problem, search: t.Search, progress: wp.array(dtype=t.Progress)):
        """Move on along the direction before and turn it (Silcowitz et al. 2010); begin anew where steps grow."""
        beta = zero
        before = progress[0].last_step
        if progress[0].sweeps > 1 and now <= before and before > tiny:
            beta = now / before
        progress[0].last_step = now
        for c in range(problem.mu.shape[0]):
            p = beta * search.direction[c]
            search.impulse[c] = clamped(search.impulse[c] + p, problem.mu[c], problem.low[c])
            search.direction[c] = p + search.step[c]

    # ------------------------------------------------------------------ Anderson

    @wp.func(module=module)
    def scalar_product(n: int, a: wp.array(dtype=vec2), a_at: int, b: wp.array(dtype=vec2), b_at: int):
        """Sum of the scalar products of n vectors of ``a``, from ``a_at`` on, with n of ``b``, from ``b_at`` on."""
        total = zero
        for c in range(n):
            x = a[a_at + c]
            y = b[b_at + c]
            total += x[0] * y[0] + x[1] * y[1]
        return total

    @wp.func(module=module)
    def factorize(filled: int, memory: t.Memory):
        """Cholesky factor of the products; 0 on the diagonal for a change that nearly depends on those before."""
        for i in range(filled):
            for j in range(i + 1):
                total = memory.product[i, j]
                for k in range(j):
                    total -= memory.factor[i, k] * memory.factor[j, k]
                value = zero
                if i == j:
                    if total > real(1e-10) * memory.product[i, i] and total > tiny:
                        value = wp.sqrt(total)
                elif memory.factor[j, j] > zero:
                    value = total / memory.factor[j, j]
                memory.factor[i, j] = value

    @wp.func(module=module)
    def solve_weights(filled: int, memory: t.Memory):
        """The weights from their right-hand sides, by the factor and its transpose; 0 for what is left out."""
        for i in range(filled):
            total = memory.weight[i]
            for k in range(i):
                total -= memory.factor[i, k] * memory.weight[k]
            if memory.factor[i, i] > zero:
                memory.weight[i] = total / memory.factor[i, i]
            else:
                memory.weight[i] = zero
        for back in range(filled):
            i = filled - 1 - back
            total = memory.weight[i]
            for k in range(i + 1, filled):
                total -= memory.factor[k, i] * memory.weight[k]
            if memory.factor[i, i] > zero:
                memory.weight[i] = total / memory.factor[i, i]
            else:
                memory.weight[i] = zero

    @wp.func(module=module)
    def combine(filled: int, newest: int, problem: t.Problem, search: t.Search, memory: t.Memory):
        """Subtract the combination of changes of the impulses whose steps cancel most of the last step.

        Unlike the contact solver's update of two iterates in closed form, it looks back on ``window`` changes.
        """
        n = problem.mu.shape[0]
        for i in range(filled):
            total = scalar_product(n, memory.step_change, i * n, memory.step_change, newest * n)
            memory.product[i, newest] = total
            memory.product[newest, i] = total
            memory.weight[i] = scalar_product(n, memory.step_change, i * n, search.step, 0)
        factorize(filled, memory)
        solve_weights(filled, memory)
        for c in range(n):
            x = search.impulse[c]
            for i in range(filled):
                x = x - memory.weight[i] * memory.end_change[i * n + c]
            search.impulse[c] = clamped(x, problem.mu[c], problem.low[c])

    @wp.func(module=module)
    def anderson(
        now: real,
        settings: t.Settings,
        problem: t.Problem,
        search: t.Search,
        memory: t.Memory,
        progress: wp.array(dtype=t.Progress),
    ):
        """Remember the sweep and combine; where the last combination failed, go back and forget."""
        n = problem.mu.shape[0]
        known = progress[0].fresh == 0
        if known and now > settings.growth * progress[0].kept_step:
            copy(memory.end, search.impulse)
            progress[0].filled = 0
            progress[0].newest = -1
            progress[0].fresh = 1
            progress[0].kept_step = huge
            return
        if known:
            newest = (progress[0].newest + 1) % settings.window
            progress[0].newest = newest
            progress[0].filled = wp.min(progress[0].filled + 1, settings.window)
            for c in range(n):
                memory.end_change[newest * n + c] = search.impulse[c] - memory.end[c]
                memory.step_change[newest * n + c] = search.step[c] - memory.end_step[c]
        copy(search.impulse, memory.end)
        copy(search.step, memory.end_step)
        progress[0].kept_step = now
        progress[0].fresh = 0
        if progress[0].filled > 0:
            combine(progress[0].filled, progress[0].newest, problem, search, memory)

    # ------------------------------------------------------------------ momentum

    @wp.func(module=module)
    def start_moving(search: t.Search, progress: wp.array(dtype=t.Progress)):
        """Begin at the present impulses, at rest; ``direction`` holds the impulses of the sweep before."""
        progress[0].momentum = one
        progress[0].moved = 0
        progress[0].travelled = huge
        copy(search.impulse, search.direction)

    @wp.func(module=module)
    def onward(problem: t.Problem, search: t.Search, progress: wp.array(dtype=t.Progress)):
        """Before a sweep, move on by beta times the last move: x + beta (x - x_before)."""
        before = progress[0].momentum
        after = nesterov(before)
        beta = (before - one) / after
        progress[0].momentum = after
        for c in range(problem.mu.shape[0]):
            x = search.impulse[c]
            y = search.direction[c]
            search.direction[c] = x
            search.impulse[c] = clamped(x + beta * (x - y), problem.mu[c], problem.low[c])

    @wp.func(module=module)
    def momentum(
        now: real, settings: t.Settings, problem: t.Problem, search: t.Search, progress: wp.array(dtype=t.Progress)
    ):
        """Stop the momentum where a sweep goes against it; go without for a while where the steps do not shrink."""
        turn = zero
        for c in range(problem.mu.shape[0]):
            x = search.impulse[c]
            y = search.direction[c]
            s = search.step[c]
            turn -= s[0] * (x[0] - y[0]) + s[1] * (x[1] - y[1])
        if turn > zero:
            progress[0].momentum = one
        progress[0].moved += 1
        if progress[0].moved == BALLISTIC:
            progress[0].moved = 0
            if now > real(0.25) * progress[0].travelled:
                progress[0].plain = progress[0].next_plain
                progress[0].next_plain = wp.min(2 * progress[0].next_plain, PLAIN_MOST)
                progress[0].inside = 0
                progress[0].period = settings.aitken_period
                progress[0].at_end = huge
            else:
                progress[0].next_plain = PLAIN
            progress[0].travelled = now

    @wp.func(module=module)
    def end_plain(search: t.Search, progress: wp.array(dtype=t.Progress)):
        """Count a sweep without momentum; after the last one it begins anew."""
        progress[0].plain -= 1
        if progress[0].plain == 0:
            start_moving(search, progress)

    return SimpleNamespace(
        reset=reset, aitken=aitken, nncg=nncg, anderson=anderson, momentum=momentum, onward=onward, end_plain=end_plain
    )
