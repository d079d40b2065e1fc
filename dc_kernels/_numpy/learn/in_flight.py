"""What a network reads of a solve in flight, and its correction of the impulses, a world at a time by name."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot
from dc_kernels._numpy.solve.row import by_lane
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT, RUNAWAY, Answer
from dc_kernels.solve.rows import COLUMNS, LANES

TINY = 1e-20  # keeps what is divided by away from 0
UNKNOWN = 4.0  # A before the first sweep
ON_CONE = 0.999  # of the limit, from which on a contact slides
PARTS = ("step", "free", "carried")  # of the output, normal and tangential each


class _Seen(NamedTuple):
    """The contacts of a world in float64, (m,) and (m, 2); of both bodies where there are two."""

    mine: slice
    slot: Array
    bodies: tuple[Array, Array]
    axes: Array
    """Normal and tangent, (m, 2, 2)."""
    arms: tuple[Array, Array]
    velocities: tuple[Array, Array]
    mu: Array
    x: Array


def _see(first: int, count: int, contacts: Any, rows: Any, motion: Any) -> _Seen:
    mine = slice(first, first + count)
    bodies = contacts.body_a[mine], contacts.body_b[mine]
    n = contacts.normal[mine].astype(float)
    return _Seen(
        mine=mine,
        slot=rows.slot[mine],
        bodies=bodies,
        axes=np.stack([n, np.stack([n[:, 1], -n[:, 0]], axis=1)], axis=1),
        arms=(contacts.arm_a[mine].astype(float), contacts.arm_b[mine].astype(float)),
        velocities=(motion.solved[bodies[0]].astype(float), motion.solved[bodies[1]].astype(float)),
        mu=contacts.friction[mine].astype(float),
        x=contacts.impulse[mine].astype(float),
    )


def _by_row(values: Array, slot: Array) -> Array:
    """Normal and tangential values of contacts at their slots, (m, 2)."""
    return np.stack([values[slot], values[slot + LANES]], axis=1).astype(float)


def kernels(dtype: str, variant: str) -> Kernels:
    """``solve_features`` and ``correct_impulses``; the arrays bring their scalar type."""
    columns = COLUMNS[variant]

    def local_step(seen: _Seen, rows: Any) -> tuple[Array, Array]:
        """Steps that contacts would take alone, free and stopped by their cones, (m, 2) each [N s]."""
        row = by_lane(rows.column, len(columns))[seen.slot // (2 * LANES), :, seen.slot % LANES]
        value = dict(zip(columns, row.astype(float).T))
        turned = (np.stack([-r[:, 1], r[:, 0]], axis=1) for r in seen.arms)
        va, vb = (v[:, :2] + v[:, 2:3] * r for v, r in zip(seen.velocities, turned))
        speed = _along(seen.axes, vb - va)
        if variant == "discs":
            # the normal of a disc points at its centre, which the arms know but to rounding
            speed[:, 0] = dot(seen.axes[:, 0], seen.velocities[1] - seen.velocities[0])
        free = -np.stack([value["en"] * (speed[:, 0] + value["bias"]), value["et"] * speed[:, 1]], axis=1)
        return free, project(seen.x + free, seen.mu) - seen.x

    def solve_features(
        tid: int,
        world_offset: int,
        settings: Any,
        model: Any,
        state: Any,
        contacts: Any,
        rows: Any,
        motion: Any,
        stats: Any,
        reading: Any,
    ) -> None:
        """Read the contacts of a world that is asked for."""
        k = tid + world_offset
        packed = slice(reading.packed_start[k], reading.packed_start[k + 1])
        count = packed.stop - packed.start
        if not count or reading.answer[k] == Answer.NOTHING:
            return
        w = reading.active[k]
        seen = _see(contacts.contact_start[w], count, contacts, rows, motion)
        free, stopped = local_step(seen, rows)
        s = stopped if settings.begin else _by_row(rows.change, seen.slot)
        sigma, size = _rms(s) + TINY, _rms(seen.x) + TINY
        at = state.position[seen.bodies[0]] + contacts.arm_a[seen.mine]
        extrapolation, near = UNKNOWN, np.full(count, UNKNOWN)
        if not settings.begin:
            steps = stats.iteration[w]
            extrapolation = float(_aitken(np.array([steps.step_last]), steps.step_before, settings.cap)[0])
            node, weight = _corners((at - reading.grid_origin[k]) / settings.rate_spacing, reading.squares.shape[2:])
            sums = np.zeros((2, *reading.squares.shape[2:]))
            for total, value in zip(sums, (s, _by_row(rows.before, seen.slot))):
                np.add.at(total, (node[..., 1], node[..., 0]), weight * (value**2).sum(axis=1)[:, None])
            near = _aitken(*((weight * total[node[..., 1], node[..., 0]]).sum(axis=1) for total in sums), settings.cap)
        reading.rate[packed] = near
        reading.least[w] = min(reading.least[w], max(sigma, size))
        wide = 1.0 + extrapolation
        reading.scale[k] = sigma, size, extrapolation, sigma * wide
        reading.step[packed] = s
        if reading.answer[k] != Answer.NETWORK:
            return

        reading.body_sum[model.body_start[w] : model.body_start[w + 1]] = 0.0
        for b, sign in zip(seen.bodies, (-1.0, 1.0)):
            sums = np.column_stack([sign * _world(seen.axes, s), np.ones(count), np.zeros(count)])
            np.add.at(reading.body_sum, b, sums)
        since = np.zeros_like(seen.x) if settings.begin else (seen.x - reading.known[seen.mine]) / sigma
        n, limit = seen.axes[:, 0], seen.mu * seen.x[:, 0]
        used = np.divide(seen.x[:, 1], limit, out=np.zeros(count), where=limit > 0.0)
        masses = [v[:, 3] for v in seen.velocities]  # inverse
        shared = {
            "closed": seen.x[:, 0] > 0.0,
            "sliding": np.abs(used) > ON_CONE,
            "new": contacts.age[seen.mine] == 0,
            "normal_cos": n[:, 0] ** 2 - n[:, 1] ** 2,
            "normal_sin": 2.0 * n[:, 0] * n[:, 1],
        }
        values: dict[str, Any] = {
            **_pair("step", np.arcsinh(s / sigma)),
            **_pair("local", np.arcsinh(stopped / sigma)),
            **_pair("since", 0.5 * np.arcsinh(since)),
            **_pair("impulse", 0.25 * np.arcsinh(seen.x / sigma)),
            "cone": used,
            **shared,
            **_pair("free", np.arcsinh(free / sigma)),
            "share_a": masses[0] / (masses[0] + masses[1] + TINY),
            "rate": 0.5 * np.log(wide),
            "begin": settings.begin,
            "sweeps": 0.25 * np.log1p(stats.iteration[w].sweeps),
            "size": 0.25 * np.log(sigma / size),
            "left": 0.25 * np.log(sigma / (settings.tolerance + TINY)),
            "accelerated": settings.accelerated,
            "contacts": 0.25 * np.log(count),
            "rate_near": 0.5 * np.log1p(near),
        }
        reading.place[packed] = at
        for side, b, mass, center in zip("ab", seen.bodies, masses, (reading.place_a, reading.place_b)):
            moves = mass > 0.0
            total = np.where(moves[:, None], reading.body_sum[b], 0.0)
            values |= _pair(f"body_{side}", np.arcsinh(_along(seen.axes, total[:, :2]) / sigma))
            values[f"degree_{side}"] = 0.25 * total[:, 2]
            center[packed] = np.where(moves[:, None], state.position[b], at)
        reading.local[packed] = _columns(LOCAL, values, count)

        channels: dict[str, Any] = {"contacts": 1.0, **shared}
        for name, p, weight in (("step", s / sigma, 1.0), ("since", since, 0.5), ("impulse", seen.x / sigma, 0.25)):
            vector = _world(seen.axes, p)
            length = np.hypot(vector[:, 0], vector[:, 1]) + TINY
            vector *= (weight * np.arcsinh(length) / length)[:, None]
            for (i, a), (j, b) in itertools.product(enumerate("xy"), repeat=2):
                channels[f"{name}_{a}{b}"] = vector[:, i] * n[:, j]
        reading.image_value[packed] = _columns(IMAGE, channels, count)

    return {"solve_features": solve_features, "correct_impulses": correct_impulses}


def correct_impulses(
    tid: int, world_offset: int, settings: Any, output: Array, contacts: Any, reading: Any, stats: Any
) -> None:
    """Add (1 + A near) o_step s + (1 + A) sigma (o_free + o_carried x / RMS of x), and stop at the friction cone."""
    k = tid + world_offset
    packed = slice(reading.packed_start[k], reading.packed_start[k + 1])
    if packed.start == packed.stop or reading.answer[k] == Answer.NOTHING:
        return
    w = reading.active[k]
    first = contacts.contact_start[w]
    mine = slice(first, first + packed.stop - packed.start)
    x = contacts.impulse[mine].astype(float)
    reading.before[mine] = reading.known[mine] = x
    _, size, _, expected = reading.scale[k].astype(float)
    even = np.full((packed.stop - packed.start, len(OUTPUT)), [settings.share] * 2 + [0.0] * 4)
    answer = even if reading.answer[k] == Answer.EVEN else output[packed].astype(float)
    given = dict(zip(OUTPUT, answer.T))
    by_step, free, carried = (np.stack([given[f"{part}_n"], given[f"{part}_t"]], axis=1) for part in PARTS)
    with np.errstate(all="ignore"):  # what is not finite is refused below
        by_step = (1.0 + reading.rate[packed, None]) * by_step * reading.step[packed]
        change = by_step + expected * (free + carried * x / size)
        most = settings.limit * expected
        taken = _rms(change) <= most <= RUNAWAY * reading.least[w]
    if taken:
        contacts.impulse[mine] = reading.known[mine] = project(x + change, contacts.friction[mine])
        stats.replaced[w] = 1


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
