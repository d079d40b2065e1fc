"""Contact problems in Delassus form, u = W r + q: a whole first-order solve in one launch; one thread a problem.

W is in rows of 2x2 blocks, a block one vector of four (nn, nt, tn, tt), so that a contact's velocity is one pass over
its row and an extrapolation of the impulses costs nothing more. The problem comes scaled (``delassus.Packed``): the
diagonal of W about 1 and |q| = 1, so no constant here depends on its units.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.native import native_code

# methods as the kernel knows them, see delassus.METHODS
PGS, AITKEN, NNCG, ANDERSON, HYBRID = (wp.constant(i) for i in range(5))
# why a solve ended: counters[2]
SWEEPS_SPENT, CONVERGED, STALLED = (wp.constant(i) for i in range(3))
BALLISTIC = wp.constant(60)  # steps with momentum between two looks at whether they help


@cache
def sweep_function(dtype: str) -> Any:
    """Projected Gauss-Seidel, the normal of each contact before its friction; the squared norm of its step."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4

    @wp.func_native(native_code("delassus/sweep.h", dtype=dtype))
    def sweep(
        n: wp.int32,
        omega: real,
        block_start: wp.array(dtype=wp.int32),
        block_col: wp.array(dtype=wp.int32),
        block: wp.array(dtype=vec4),
        q: wp.array(dtype=vec2),
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        inverse: wp.array(dtype=vec2),
        couple: wp.array(dtype=real),
        impulse: wp.array(dtype=vec2),
        step: wp.array(dtype=vec2),
    ) -> real: ...

    return sweep


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """The kernels by name."""
    t = scalar_types(dtype)
    real, vec2, vec4 = t.real, t.vec2, t.vec4
    module = kernel_module("delassus", dtype)
    huge = real(3e38)
    tiny = real(1e-35)
    sweep = sweep_function(dtype)

    @wp.func(module=module)
    def velocity(
        c: int,
        block_start: wp.array(dtype=wp.int32),
        block_col: wp.array(dtype=wp.int32),
        block: wp.array(dtype=vec4),
        q: wp.array(dtype=vec2),
        impulse: wp.array(dtype=vec2),
    ):
        """Row c of W r + q."""
        u = q[c]
        for k in range(block_start[c], block_start[c + 1]):
            b = block[k]
            x = impulse[block_col[k]]
            u = vec2(u[0] + (b[0] * x[0] + b[1] * x[1]), u[1] + (b[2] * x[0] + b[3] * x[1]))
        return u

    @wp.func(module=module)
    def clamped(x: vec2, mu: real, low: real):
        """Normal impulse not below ``low``, then friction within its bounds."""
        n = wp.max(x[0], low)
        limit = wp.max(mu * n, real(0.0))
        return vec2(n, wp.min(wp.max(x[1], -limit), limit))

    @wp.func(module=module)
    def defect(x: vec2, u: vec2, mu: real, low: real):
        """Squared natural map of a contact: impulse minus the projection of r - (u_n + mu |u_t|, u_t) on its cone."""
        zn = x[0] - (u[0] + mu * wp.abs(u[1]))
        zt = x[1] - u[1]
        size = wp.abs(zt)
        if low < real(0.0):
            zt = real(0.0)
        elif zn < real(0.0) or size > mu * zn:
            if mu * size <= -zn:
                zn = real(0.0)
                zt = real(0.0)
            else:
                zn = (zn + mu * size) / (real(1.0) + mu * mu)
                zt = wp.sign(zt) * (mu * zn)
        return (x[0] - zn) * (x[0] - zn) + (x[1] - zt) * (x[1] - zt)

    @wp.func(module=module)
    def squared_maps(
        n: int,
        scale: real,
        block_start: wp.array(dtype=wp.int32),
        block_col: wp.array(dtype=wp.int32),
        block: wp.array(dtype=vec4),
        q: wp.array(dtype=vec2),
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        inverse: wp.array(dtype=vec2),
        impulse: wp.array(dtype=vec2),
    ):
        """Squared natural maps: of the problem as given, and with each impulse in the velocity it makes."""
        given = real(0.0)
        scaled = real(0.0)
        for c in range(n):
            u = velocity(c, block_start, block_col, block, q, impulse)
            x = impulse[c]
            given += defect(vec2(scale * x[0], scale * x[1]), u, mu[c], low[c])
            w = real(1.0) / inverse[c][0]
            scaled += defect(vec2(w * x[0], w * x[1]), u, mu[c], low[c])
        return vec2(given, scaled)

    @wp.kernel(module=module, enable_backward=False)
    def map_delassus(
        scale: real,
        block_start: wp.array(dtype=wp.int32),
        block_col: wp.array(dtype=wp.int32),
        block: wp.array(dtype=vec4),
        q: wp.array(dtype=vec2),
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        inverse: wp.array(dtype=vec2),
        impulse: wp.array(dtype=vec2),
        # out:
        maps: wp.array(dtype=real),
    ):
        """Both natural maps of given impulses."""
        n = q.shape[0]
        m = squared_maps(n, scale, block_start, block_col, block, q, mu, low, inverse, impulse)
        maps[0] = wp.sqrt(m[0])
        maps[1] = wp.sqrt(m[1])

    @wp.func(module=module)
    def move(
        n: int,
        alpha: real,
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        impulse: wp.array(dtype=vec2),
        direction: wp.array(dtype=vec2),
    ):
        """Impulses move along a direction and stop at their bounds."""
        for c in range(n):
            x = impulse[c]
            d = direction[c]
            impulse[c] = clamped(vec2(x[0] + alpha * d[0], x[1] + alpha * d[1]), mu[c], low[c])

    @wp.func(module=module)
    def anderson(
        n: int,
        window: int,
        filled: int,
        newest: int,
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        impulse: wp.array(dtype=vec2),
        step: wp.array(dtype=vec2),
        end_change: wp.array(dtype=vec2),
        step_change: wp.array(dtype=vec2),
        gram: wp.array2d(dtype=real),
        weight: wp.array(dtype=real),
    ):
        """Impulses minus the combination of their changes whose steps cancel most of the last step."""
        # the newest changes' products with the others, and all with the step
        for i in range(filled):
            total = real(0.0)
            for c in range(n):
                a = step_change[i * n + c]
                b = step_change[newest * n + c]
                total += a[0] * b[0] + a[1] * b[1]
            gram[i, newest] = total
            gram[newest, i] = total
            total = real(0.0)
            for c in range(n):
                a = step_change[i * n + c]
                s = step[c]
                total += a[0] * s[0] + a[1] * s[1]
            weight[i] = total
        # Cholesky factor beside the products, in rows window .. 2 window; what is nearly dependent is left out
        for i in range(filled):
            for j in range(i + 1):
                total = gram[i, j]
                for k in range(j):
                    total -= gram[window + i, k] * gram[window + j, k]
                if i == j:
                    if total > real(1e-10) * gram[i, i] and total > tiny:
                        gram[window + i, i] = wp.sqrt(total)
                    else:
                        gram[window + i, i] = real(0.0)
                elif gram[window + j, j] > real(0.0):
                    gram[window + i, j] = total / gram[window + j, j]
                else:
                    gram[window + i, j] = real(0.0)
        for i in range(filled):
            total = weight[i]
            for k in range(i):
                total -= gram[window + i, k] * weight[k]
            if gram[window + i, i] > real(0.0):
                weight[i] = total / gram[window + i, i]
            else:
                weight[i] = real(0.0)
        for back in range(filled):
            i = filled - 1 - back
            total = weight[i]
            for k in range(i + 1, filled):
                total -= gram[window + k, i] * weight[k]
            if gram[window + i, i] > real(0.0):
                weight[i] = total / gram[window + i, i]
            else:
                weight[i] = real(0.0)
        for c in range(n):
            x = impulse[c]
            for i in range(filled):
                d = end_change[i * n + c]
                x = vec2(x[0] - weight[i] * d[0], x[1] - weight[i] * d[1])
            impulse[c] = clamped(x, mu[c], low[c])

    @wp.kernel(module=module, enable_backward=False)
    def solve_delassus(
        method: int,
        max_sweeps: int,
        every: int,
        patience: int,
        gain: real,
        tolerance: real,
        scaled_tolerance: real,
        omega: real,
        period_min: int,
        period_max: int,
        cap: real,
        threshold: real,
        window: int,
        growth: real,
        scale: real,
        # problem:
        block_start: wp.array(dtype=wp.int32),
        block_col: wp.array(dtype=wp.int32),
        block: wp.array(dtype=vec4),
        q: wp.array(dtype=vec2),
        mu: wp.array(dtype=real),
        low: wp.array(dtype=real),
        inverse: wp.array(dtype=vec2),
        couple: wp.array(dtype=real),
        # in, out:
        impulse: wp.array(dtype=vec2),
        # scratch:
        step: wp.array(dtype=vec2),
        before: wp.array(dtype=vec2),
        direction: wp.array(dtype=vec2),
        end_change: wp.array(dtype=vec2),
        step_change: wp.array(dtype=vec2),
        gram: wp.array2d(dtype=real),
        weight: wp.array(dtype=real),
        # out:
        best: wp.array(dtype=vec2),
        history: wp.array2d(dtype=real),
        counters: wp.array(dtype=wp.int32),
    ):
        """Sweeps from ``impulse`` until both natural maps are met or fell by no ``gain`` in ``patience`` looks."""
        n = q.shape[0]
        sweeps = int(0)
        looks = int(0)
        reason = SWEEPS_SPENT
        least = huge
        mark = huge
        marked = int(0)
        # Aitken:
        inside = int(0)
        period = period_min
        last = huge
        earlier = huge
        ended = huge
        # Anderson:
        filled = int(0)
        newest = int(-1)
        fresh = int(1)
        # momentum:
        momentum = real(1.0)
        moved = int(0)
        travelled = huge
        plain = int(0)
        plain_next = int(40)
        running = int(1)
        while running == 1:
            stepping = method
            if method == HYBRID and plain > 0:
                stepping = AITKEN
            if method == HYBRID and plain == 0:
                # direction holds the impulses of the sweep before: y = x + b (x - x_before)
                onward = real(0.5) * (real(1.0) + wp.sqrt(real(1.0) + real(4.0) * momentum * momentum))
                b = (momentum - real(1.0)) / onward
                momentum = onward
                for c in range(n):
                    x = impulse[c]
                    y = direction[c]
                    direction[c] = x
                    z = clamped(vec2(x[0] + b * (x[0] - y[0]), x[1] + b * (x[1] - y[1])), mu[c], low[c])
                    impulse[c] = z
            now = sweep(n, omega, block_start, block_col, block, q, mu, low, inverse, couple, impulse, step)
            sweeps += 1
            if sweeps % every == 0 or sweeps >= max_sweeps:
                m = squared_maps(n, scale, block_start, block_col, block, q, mu, low, inverse, impulse)
                given = wp.sqrt(m[0])
                scaled = wp.sqrt(m[1])
                if looks < history.shape[0]:
                    history[looks, 0] = given
                    history[looks, 1] = scaled
                looks += 1
                worst = wp.max(given / tolerance, scaled / scaled_tolerance)
                if worst < least:
                    least = worst
                    for c in range(n):
                        best[c] = impulse[c]
                if worst < gain * mark:
                    mark = worst
                    marked = looks
                if worst <= real(1.0):
                    reason = CONVERGED
                    running = 0
                elif patience > 0 and looks - marked >= patience:
                    reason = STALLED
                    running = 0
            if sweeps >= max_sweeps:
                running = 0
            if running == 1 and stepping == AITKEN:
                inside += 1
                if inside == period - 1:
                    last = now
                if inside >= period:
                    if now < last:
                        ratio = wp.sqrt(now / last)
                        alpha = cap
                        if ratio < cap * (real(1.0) - ratio):
                            alpha = ratio / (real(1.0) - ratio)
                        move(n, alpha, mu, low, impulse, step)
                    if now > threshold * threshold * ended:
                        period = wp.min(2 * period, period_max)
                    else:
                        period = wp.max(period_min, period / 2)
                    ended = now
                    inside = 0
                if method == HYBRID:
                    plain -= 1
                    if plain == 0:
                        momentum = real(1.0)
                        moved = 0
                        travelled = huge
                        for c in range(n):
                            direction[c] = impulse[c]
            elif running == 1 and method == NNCG:
                beta = real(0.0)
                if sweeps > 1 and now <= last and last > tiny:
                    beta = now / last
                last = now
                for c in range(n):
                    x = impulse[c]
                    p = direction[c]
                    s = step[c]
                    impulse[c] = clamped(vec2(x[0] + beta * p[0], x[1] + beta * p[1]), mu[c], low[c])
                    direction[c] = vec2(beta * p[0] + s[0], beta * p[1] + s[1])
            elif running == 1 and method == ANDERSON:
                # before: end of the sweep before; direction: its step
                if fresh == 0 and now > growth * earlier:
                    # the last combination failed: go on from the better point without memory
                    filled = 0
                    newest = -1
                    fresh = 1
                    for c in range(n):
                        impulse[c] = before[c]
                    earlier = huge
                else:
                    if fresh == 0:
                        newest = (newest + 1) % window
                        filled = wp.min(filled + 1, window)
                        for c in range(n):
                            x = impulse[c]
                            y = before[c]
                            s = step[c]
                            d = direction[c]
                            end_change[newest * n + c] = vec2(x[0] - y[0], x[1] - y[1])
                            step_change[newest * n + c] = vec2(s[0] - d[0], s[1] - d[1])
                    for c in range(n):
                        before[c] = impulse[c]
                        direction[c] = step[c]
                    earlier = now
                    fresh = 0
                    if filled > 0:
                        anderson(
                            n, window, filled, newest, mu, low, impulse, step, end_change, step_change, gram, weight
                        )
            elif running == 1 and stepping == HYBRID:
                # step is x - y; (y - x) . (x - x_before) > 0: it turned round
                turn = real(0.0)
                for c in range(n):
                    x = impulse[c]
                    y = direction[c]
                    s = step[c]
                    turn -= s[0] * (x[0] - y[0]) + s[1] * (x[1] - y[1])
                if turn > real(0.0):
                    momentum = real(1.0)
                moved += 1
                if moved == BALLISTIC:
                    moved = 0
                    if now > real(0.25) * travelled:
                        plain = plain_next
                        plain_next = wp.min(2 * plain_next, 400)
                        inside = 0
                        period = period_min
                        ended = huge
                    else:
                        plain_next = 40
                    travelled = now
        counters[0] = sweeps
        counters[1] = looks
        counters[2] = reason

    return {"map_delassus": map_delassus, "solve_delassus": solve_delassus}
