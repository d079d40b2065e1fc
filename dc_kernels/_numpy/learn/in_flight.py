"""What a network reads of a solve in flight, and its correction of the impulses, a world at a time by name."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot
from dc_kernels._numpy.solve.row import by_lane
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT
from dc_kernels.solve.iteration import COUNTERS, NORMS
from dc_kernels.solve.rows import COLUMNS, LANES

TINY = 1e-20  # keeps what is divided by away from 0
UNKNOWN = 4.0  # A before the first sweep
ON_CONE = 0.999  # of the limit, from which on a contact slides
PARTS = ("step", "free", "carried")  # of the output, normal and tangential each


def kernels(dtype: str, variant: str) -> Kernels:
    """``solve_features`` and ``correct_impulses``; the arrays bring their scalar type."""
    columns = COLUMNS[variant]

    def local_step(
        rows: Array, slot: Array, axes: Array, arms: tuple[Array, Array], solved: tuple[Array, Array],
        friction: Array, x: Array,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Steps that contacts would take alone, free and stopped by their cones, (m, 2) each [N s]."""
        row = by_lane(rows, len(columns))[slot // (2 * LANES), :, slot % LANES]
        value = dict(zip(columns, row.astype(float).T))
        va, vb = (v[:, :2] + v[:, 2:3] * np.stack([-r[:, 1], r[:, 0]], axis=1) for v, r in zip(solved, arms))
        speed = _along(axes, vb - va)
        if variant == "discs":
            # the normal of a disc points at its centre, which the arms know but to rounding
            speed[:, 0] = dot(axes[:, 0], solved[1] - solved[0])
        free = -np.stack([value["en"] * (speed[:, 0] + value["bias"]), value["et"] * speed[:, 1]], axis=1)
        return free, project(x + free, friction) - x

    def solve_features(
        tid: int,
        world_offset: int,
        begin: int,
        accelerated: int,
        tolerance: float,
        cap: float,
        rate_spacing: float,
        active: Array,
        packed_start: Array,
        contact_start: Array,
        body_start: Array,
        body_a: Array,
        body_b: Array,
        normal: Array,
        arm_a: Array,
        arm_b: Array,
        friction: Array,
        age: Array,
        position: Array,
        slot: Array,
        rows: Array,
        impulse: Array,
        row_change: Array,
        row_before: Array,
        solved: Array,
        counters: Array,
        norms: Array,
        known: Array,
        grid_origin: Array,
        body_sum: Array,
        squares: Array,
        local: Array,
        image_value: Array,
        place: Array,
        place_a: Array,
        place_b: Array,
        step: Array,
        rate: Array,
        world_scale: Array,
    ) -> None:
        """Features of the contacts of a world that is asked for."""
        k = tid + world_offset
        packed = slice(packed_start[k], packed_start[k + 1])
        count = packed.stop - packed.start
        if not count:
            return
        w = active[k]
        mine = slice(contact_start[w], contact_start[w] + count)
        bodies = (body_a[mine], body_b[mine])
        n = normal[mine].astype(float)
        axes = np.stack([n, np.stack([n[:, 1], -n[:, 0]], axis=1)], axis=1)  # normal and tangent, (m, 2, 2)
        arms = (arm_a[mine].astype(float), arm_b[mine].astype(float))
        velocities = tuple(solved[b].astype(float) for b in bodies)
        mu, x = friction[mine].astype(float), impulse[mine].astype(float)
        free, stopped = local_step(rows, slot[mine], axes, arms, velocities, mu, x)

        s = stopped
        if not begin:
            s = np.stack([row_change[slot[mine]], row_change[slot[mine] + LANES]], axis=1).astype(float)
        sigma, size = _rms(s) + TINY, _rms(x) + TINY
        at = position[bodies[0]] + arm_a[mine]
        extrapolation, near = UNKNOWN, np.full(count, UNKNOWN)
        if not begin:
            extrapolation = float(_aitken(norms[w * NORMS + 5 : w * NORMS + 6], norms[w * NORMS + 4], cap)[0])
            before = np.stack([row_before[slot[mine]], row_before[slot[mine] + LANES]], axis=1).astype(float)
            node, weight = _corners((at - grid_origin[k]) / rate_spacing, squares.shape[2:])
            sums = np.zeros((2, *squares.shape[2:]))
            for total, value in zip(sums, (s, before)):
                np.add.at(total, (node[..., 1], node[..., 0]), weight * (value**2).sum(axis=1)[:, None])
            near = _aitken(*((weight * total[node[..., 1], node[..., 0]]).sum(axis=1) for total in sums), cap)
        rate[packed] = near
        wide = 1.0 + extrapolation
        world_scale[k] = sigma, size, extrapolation, sigma * wide
        step[packed] = s

        body_sum[body_start[w] : body_start[w + 1]] = 0.0
        for b, sign in zip(bodies, (-1.0, 1.0)):
            np.add.at(body_sum, b, np.column_stack([sign * _world(axes, s), np.ones(count), np.zeros(count)]))
        since = np.zeros_like(x) if begin else (x - known[mine]) / sigma
        limit = mu * x[:, 0]
        used = np.divide(x[:, 1], limit, out=np.zeros(count), where=limit > 0.0)
        masses = [v[:, 3] for v in velocities]  # inverse
        shared = {
            "closed": x[:, 0] > 0.0,
            "sliding": np.abs(used) > ON_CONE,
            "new": age[mine] == 0,
            "normal_cos": n[:, 0] ** 2 - n[:, 1] ** 2,
            "normal_sin": 2.0 * n[:, 0] * n[:, 1],
        }
        values: dict[str, Any] = {
            **_pair("step", np.arcsinh(s / sigma)),
            **_pair("local", np.arcsinh(stopped / sigma)),
            **_pair("since", 0.5 * np.arcsinh(since)),
            **_pair("impulse", 0.25 * np.arcsinh(x / sigma)),
            "cone": used,
            **shared,
            **_pair("free", np.arcsinh(free / sigma)),
            "share_a": masses[0] / (masses[0] + masses[1] + TINY),
            "rate": 0.5 * np.log(wide),
            "begin": begin,
            "sweeps": 0.25 * np.log1p(counters[w * COUNTERS]),
            "size": 0.25 * np.log(sigma / size),
            "left": 0.25 * np.log(sigma / (tolerance + TINY)),
            "accelerated": accelerated,
            "contacts": 0.25 * np.log(count),
            "rate_near": 0.5 * np.log1p(near),
        }
        place[packed] = at
        for side, b, mass, center in zip("ab", bodies, masses, (place_a, place_b)):
            moves = mass > 0.0
            total = np.where(moves[:, None], body_sum[b], 0.0)
            values |= _pair(f"body_{side}", np.arcsinh(_along(axes, total[:, :2]) / sigma))
            values[f"degree_{side}"] = 0.25 * total[:, 2]
            center[packed] = np.where(moves[:, None], position[b], at)
        local[packed] = _columns(LOCAL, values, count)

        channels: dict[str, Any] = {"contacts": 1.0, **shared}
        for name, p, weight in (("step", s / sigma, 1.0), ("since", since, 0.5), ("impulse", x / sigma, 0.25)):
            vector = _world(axes, p)
            length = np.hypot(vector[:, 0], vector[:, 1]) + TINY
            vector *= (weight * np.arcsinh(length) / length)[:, None]
            for (i, a), (j, b) in itertools.product(enumerate("xy"), repeat=2):
                channels[f"{name}_{a}{b}"] = vector[:, i] * n[:, j]
        image_value[packed] = _columns(IMAGE, channels, count)

    return {"solve_features": solve_features, "correct_impulses": correct_impulses}


def correct_impulses(
    tid: int,
    world_offset: int,
    limit_factor: float,
    active: Array,
    packed_start: Array,
    output: Array,
    step: Array,
    rate: Array,
    world_scale: Array,
    contact_start: Array,
    friction: Array,
    impulse: Array,
    before: Array,
    known: Array,
    replaced: Array,
) -> None:
    """Impulses plus (1 + A near) o_step s + (1 + A) sigma (o_free + o_carried x / RMS of x), on the friction cone."""
    k = tid + world_offset
    packed = slice(packed_start[k], packed_start[k + 1])
    if packed.start == packed.stop:
        return
    w = active[k]
    mine = slice(contact_start[w], contact_start[w] + packed.stop - packed.start)
    x = impulse[mine].astype(float)
    before[mine] = known[mine] = x
    _, size, _, expected = world_scale[k].astype(float)
    given = dict(zip(OUTPUT, output[packed].astype(float).T))
    by_step, free, carried = (np.stack([given[f"{part}_n"], given[f"{part}_t"]], axis=1) for part in PARTS)
    with np.errstate(all="ignore"):  # what is not finite is refused below
        change = (1.0 + rate[packed, None]) * by_step * step[packed] + expected * (free + carried * x / size)
        taken = _rms(change) <= limit_factor * expected
    if taken:
        impulse[mine] = known[mine] = project(x + change, friction[mine])
        replaced[w] = 1


def project(x: Array, friction: Array) -> Array:
    """The normal impulse stopped at 0, then the tangential one at its limit, as a sweep does, (m, 2)."""
    normal = np.maximum(x[:, 0], 0.0)
    limit = friction * normal
    return np.stack([normal, np.clip(x[:, 1], -limit, limit)], axis=1)


def _aitken(now: Array, before: Array, cap: float) -> Array:
    """The limit of the geometric series over its last step, from two squares, up to a cap."""
    ratio = np.sqrt(now / (before + TINY))
    with np.errstate(divide="ignore"):
        return np.where(ratio < cap * (1.0 - ratio), ratio / (1.0 - ratio), cap)


def _corners(x: Array, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """The four nodes (column, row) around places in units of the spacing, and their bilinear weights, (m, 4[, 2])."""
    x = np.clip(x, 0.0, np.array(shape[::-1]) - 1.0)
    low = np.minimum(np.floor(x), np.array(shape[::-1]) - 2.0).astype(int)
    share = x - low
    corner = np.array(list(itertools.product((0, 1), repeat=2)))
    weight = np.where(corner, share[:, None], 1.0 - share[:, None]).prod(axis=2)
    return low[:, None] + corner, weight


def _along(axes: Array, v: Array) -> Array:
    """Components of vectors (m, 2) along axes (m, 2, 2)."""
    return dot(axes, v[:, None])


def _world(axes: Array, x: Array) -> Array:
    """Vectors of components (m, 2) along axes (m, 2, 2)."""
    return dot(axes.transpose(0, 2, 1), x[:, None])


def _rms(x: Array) -> Any:
    """Root of the mean squared length of vectors (m, 2)."""
    return np.sqrt(np.mean(np.sum(x * x, axis=1)))


def _pair(name: str, x: Array) -> dict[str, Array]:
    """The columns of normal and tangential values (m, 2)."""
    return {f"{name}_n": x[:, 0], f"{name}_t": x[:, 1]}


def _columns(names: tuple[str, ...], values: dict[str, Any], count: int) -> Array:
    """Values by name as an array (count, names); a scalar counts for all."""
    return np.stack([np.broadcast_to(values[name], count) for name in names], axis=1)
