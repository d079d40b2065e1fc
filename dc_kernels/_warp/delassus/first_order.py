"""Contact problems in Delassus form, u = W r + q: a whole first-order solve in one launch; one thread a problem.

W is in rows of 2x2 blocks, a block one vector of four (nn, nt, tn, tt), so that a contact's velocity is one pass over
its row and an extrapolation of the impulses costs nothing more. The problem is in its own units
(``dc_kernels.delassus.groups``), so that no constant here depends on those of the user.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import is_set, kernel_module
from dc_kernels._warp.delassus import accelerate
from dc_kernels._warp.delassus.groups import search_types
from dc_kernels._warp.groups import contiguity
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.laws import natural_map_squared
from dc_kernels.delassus.groups import MEMORY, PROBLEM, SEARCH, Acceleration, Reason


@cache
def sweep_function(dtype: str) -> Any:
    """Projected Gauss-Seidel, the normal of each contact before its friction; the squared norm of its step."""
    t = search_types(dtype)
    real = t.real

    @wp.func_native(native_code("delassus/sweep.h", dtype=dtype))
    def sweep(omega: real, problem: t.Problem, search: t.Search) -> real: ...

    return sweep


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``map_delassus`` and ``solve_delassus`` by name."""
    t = search_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("delassus", dtype)
    between = accelerate.functions(dtype)
    reset, onward, end_plain = between.reset, between.onward, between.end_plain
    aitken, nncg, anderson, momentum = between.aitken, between.nncg, between.anderson, between.momentum
    sweep = sweep_function(dtype)
    huge, zero, one = real(3e38), real(0.0), real(1.0)

    @wp.func_native(contiguity(PROBLEM))
    def contiguous_problem(group: t.Problem): ...

    @wp.func_native(contiguity(SEARCH))
    def contiguous_search(group: t.Search): ...

    @wp.func_native(contiguity(MEMORY))
    def contiguous_memory(group: t.Memory): ...

    @wp.func(module=module)
    def velocity(c: int, problem: t.Problem, impulse: wp.array(dtype=vec2)):
        """Contact c's part of W r + q."""
        u = problem.q[c]
        for k in range(problem.row_start[c], problem.row_start[c + 1]):
            b = problem.block[k]
            x = impulse[problem.column[k]]
            u = vec2(u[0] + (b[0] * x[0] + b[1] * x[1]), u[1] + (b[2] * x[0] + b[3] * x[1]))
        return u

    @wp.func(module=module)
    def defect(x: vec2, u: vec2, mu: real, low: real):
        """Squared natural map of a contact, or of a row without bound: r against r - (u_n + mu |u_t|, u_t)."""
        zn = x[0] - (u[0] + mu * wp.abs(u[1]))
        if low < zero:
            return (x[0] - zn) * (x[0] - zn) + x[1] * x[1]
        return natural_map_squared(x, vec2(zn, x[1] - u[1]), mu)

    @wp.func(module=module)
    def natural_maps(scale: real, problem: t.Problem, impulse: wp.array(dtype=vec2)):
        """Natural maps: of the problem as given, and with each impulse as the velocity it makes."""
        given = zero
        scaled = zero
        for c in range(problem.mu.shape[0]):
            u = velocity(c, problem, impulse)
            x = impulse[c]
            given += defect(scale * x, u, problem.mu[c], problem.low[c])
            w = one / problem.inverse[c][0]
            scaled += defect(w * x, u, problem.mu[c], problem.low[c])
        return vec2(wp.sqrt(given), wp.sqrt(scaled))

    @wp.kernel(module=module, enable_backward=False)
    def map_delassus(
        scale: real,
        problem: t.Problem,
        impulse: wp.array(dtype=vec2),
        # out:
        maps: wp.array(dtype=vec2),
    ):
        """Measure the natural map and the scaled one of given impulses."""
        maps[0] = natural_maps(scale, problem, impulse)

    @wp.func(module=module)
    def begin(settings: t.Settings, progress: wp.array(dtype=t.Progress)):
        progress[0].sweeps = 0
        progress[0].looks = 0
        progress[0].reason = Reason.SWEEPS
        progress[0].least = huge
        progress[0].mark = huge
        progress[0].marked = 0
        reset(settings, progress)

    @wp.func(module=module)
    def look(settings: t.Settings, problem: t.Problem, search: t.Search, progress: wp.array(dtype=t.Progress)):
        """Measure the natural maps and keep the best impulses; 0 where the solve ends by them."""
        maps = natural_maps(settings.scale, problem, search.impulse)
        if progress[0].looks < search.history.shape[0]:
            search.history[progress[0].looks] = maps
        progress[0].looks += 1
        worst = wp.max(maps[0] / settings.tolerance, maps[1] / settings.scaled_tolerance)
        if worst < progress[0].least:
            progress[0].least = worst
            for c in range(problem.mu.shape[0]):
                search.best[c] = search.impulse[c]
        if worst < settings.gain * progress[0].mark:
            progress[0].mark = worst
            progress[0].marked = progress[0].looks
        if worst <= one:
            progress[0].reason = Reason.CONVERGED
            return 0
        if settings.patience > 0 and progress[0].looks - progress[0].marked >= settings.patience:
            progress[0].reason = Reason.STALLED
            return 0
        return 1

    @wp.kernel(module=module, enable_backward=False)
    def solve_delassus(
        settings: t.Settings,
        problem: t.Problem,
        # in, out:
        search: t.Search,
        memory: t.Memory,
        # out:
        progress: wp.array(dtype=t.Progress),
    ):
        """Sweep until both natural maps are met, or fell by no ``gain`` in ``patience`` looks, or sweeps are spent."""
        contiguous_problem(problem)
        contiguous_search(search)
        contiguous_memory(memory)
        begin(settings, progress)
        running = int(1)
        while running == 1:
            moving = settings.method == Acceleration.HYBRID and progress[0].plain == 0
            if moving:
                onward(problem, search, progress)
            now = sweep(settings.omega, problem, search)
            sweeps = progress[0].sweeps + 1
            progress[0].sweeps = sweeps
            if sweeps % settings.every == 0 or sweeps >= settings.max_sweeps:
                running = look(settings, problem, search, progress)
            if sweeps >= settings.max_sweeps or is_set(settings.cut) == 1:
                running = 0
            if running == 1:
                if moving:
                    momentum(now, settings, problem, search, progress)
                elif settings.method == Acceleration.AITKEN:
                    aitken(now, settings, problem, search, progress)
                elif settings.method == Acceleration.HYBRID:
                    aitken(now, settings, problem, search, progress)
                    end_plain(search, progress)
                elif settings.method == Acceleration.NNCG:
                    nncg(now, problem, search, progress)
                elif settings.method == Acceleration.ANDERSON:
                    anderson(now, settings, problem, search, memory, progress)

    return {"map_delassus": map_delassus, "solve_delassus": solve_delassus}
