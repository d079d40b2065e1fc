"""The iteration of a world's solve: warm start, sweep, stop, acceleration. Shared by both schedules."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels._numpy.solve.adaptive import MOMENTUM, Adaptive, reset_adaptive
from dc_kernels._numpy.solve.row import Row, by_lane, natural_map_row, read_row
from dc_kernels.model.config import ACCELERATIONS, METHODS, STOPS
from dc_kernels.solve.iteration import BEST, COUNTERS, HISTORY, NEVER, NORMS, RETREAT
from dc_kernels.solve.rows import COLORS, LANES

JACOBI = METHODS["jacobi"]
AITKEN = ACCELERATIONS["aitken"]
NNCG = ACCELERATIONS["nncg"]
PLAIN = ACCELERATIONS["none"]
ADAPTIVE = ACCELERATIONS["adaptive"]
BY_RESIDUAL = STOPS["residual"]
HUGE = 3e38
TINY = 1e-30


def blocks_of(w: int, color_block: Array) -> slice:
    ends = color_block[w * (COLORS + 1) : (w + 1) * (COLORS + 1)]
    return slice(int(ends[0]), int(ends[-1]))


def world_rows(variant: str, w: int, color_block: Array, rows: Array, row_body: Array, bodies: Array) -> list[Row]:
    """Rows of a world in the order of a sweep."""
    used = blocks_of(w, color_block)
    lanes = ((block, lane) for block in range(used.start, used.stop) for lane in range(LANES))
    read = (read_row(variant, block, lane, rows, row_body, bodies) for block, lane in lanes)
    return [row for row in read if row is not None]


def natural_map(world: list[Row], bodies: Array, row_impulse: Array, scale: Any) -> Any:
    """Relative natural map of a world."""
    total = np.sqrt(sum(natural_map_row(row, bodies, row_impulse) for row in world))
    return total / scale if scale > TINY else total


def refresh(w: int, world: list[Row], body_start: Array, predicted: Array, solved: Array, row_impulse: Array) -> None:
    """Velocities anew from the impulses."""
    bodies = slice(body_start[w], body_start[w + 1])
    solved[bodies] = predicted[bodies]
    for row in world:
        row.change(solved, by_lane(row_impulse)[row.at])


def load_impulses(
    w: int,
    world: list[Row],
    body_start: Array,
    joint_start: Array,
    joint_slot: Array,
    joint_impulse: Array,
    contact_start: Array,
    contact_count: Array,
    slot: Array,
    impulse: Array,
    predicted: Array,
    color_block: Array,
    solved: Array,
    row_impulse: Array,
) -> None:
    """Impulses of contacts and joints to the rows; predicted velocities plus what they add."""
    by_lane(row_impulse)[blocks_of(w, color_block)] = 0.0
    contacts = slice(contact_start[w], contact_start[w] + contact_count[w])
    row_impulse[slot[contacts]] = impulse[contacts, 0]
    row_impulse[slot[contacts] + LANES] = impulse[contacts, 1]
    joints = slice(joint_start[w], joint_start[w + 1])
    row_impulse[joint_slot[joints]] = joint_impulse[joints]
    refresh(w, world, body_start, predicted, solved, row_impulse)


def start_world(
    w: int,
    period: int,
    period_max: int,
    world: list[Row],
    body_start: Array,
    joint_start: Array,
    joint_slot: Array,
    joint_impulse: Array,
    contact_start: Array,
    contact_count: Array,
    slot: Array,
    impulse: Array,
    predicted: Array,
    color_block: Array,
    solved: Array,
    row_impulse: Array,
    counters: Array,
    norms: Array,
) -> None:
    """Warm start: the iteration from the beginning."""
    load_impulses(
        w, world, body_start, joint_start, joint_slot, joint_impulse, contact_start, contact_count, slot, impulse,
        predicted, color_block, solved, row_impulse,
    )  # fmt: skip
    counters[w * COUNTERS : w * COUNTERS + 8] = 0, 0, period, 0, 0, 2 * period_max, 0, -1
    norms[w * NORMS : (w + 1) * NORMS] = 0.0, *(HUGE,) * (NORMS - 1)
    reset_adaptive(counters[w * COUNTERS : (w + 1) * COUNTERS], norms[w * NORMS : (w + 1) * NORMS])


def change_bound(tolerance: float, relative: Any, stop: int) -> Any:
    """What a world's stop is compared with: without weight only the tolerance counts."""
    return min(tolerance, relative) if stop != BY_RESIDUAL and relative > 0 else tolerance


def prepare_sweep(w: int, method: int, body_start: Array, solved: Array, summed: Array) -> None:
    """A place to sum up Jacobi's changes."""
    if method == JACOBI:
        bodies = slice(body_start[w], body_start[w + 1])
        summed[bodies] = solved[bodies]


def extrapolate(world: list[Row], alpha: Any, solved: Array, row_impulse: Array, row_change: Array) -> None:
    """Move on: x <- clamp(x + alpha change); change is then what x moved by, and velocities follow."""
    for row in world:
        impulse, step = by_lane(row_impulse)[row.at], by_lane(row_change)[row.at]
        new = impulse + alpha * step
        new[0] = max(new[0], row.low)
        limit = row.friction * new[0]
        new[1] = min(max(new[1], -limit), limit)
        step[:] = new - impulse
        impulse[:] = new
        row.change(solved, step)


def end_period(
    w: int,
    world: list[Row],
    period_min: int,
    period_max: int,
    cap: float,
    threshold: float,
    patience: int,
    color_block: Array,
    solved: Array,
    row_impulse: Array,
    row_change: Array,
    counters: Array,
    norms: Array,
    move: bool,
) -> None:
    """The end of an Aitken period: extrapolate, unless ``move`` is false, and choose the length of the next."""
    counter = counters[w * COUNTERS : (w + 1) * COUNTERS]
    norm = norms[w * NORMS : (w + 1) * NORMS]
    now = np.sum(by_lane(row_change)[blocks_of(w, color_block)] ** 2)
    if now < norm[1] and move:
        ratio = np.sqrt(now / norm[1])
        # the limit of the geometric series, if it is not too far away
        alpha = ratio / (1.0 - ratio) if ratio < cap * (1.0 - ratio) else cap
        extrapolate(world, alpha, solved, row_impulse, row_change)
    if now > threshold * threshold * norm[2]:
        counter[2] = min(2 * counter[2], period_max)
    else:
        counter[2] = max(period_min, counter[2] // 2)
    norm[2] = now
    counter[1] = 0
    counter[4] += 1
    if now < norm[3]:
        norm[3] = now
        counter[4] = 0
    if counter[4] >= patience:  # the extrapolation cycles: plain sweeps, each time twice as many
        counter[1] = -counter[5]
        counter[5] *= 2
        counter[4] = 0


def conclude_sweep(
    w: int,
    largest: Any,
    world: list[Row],
    method: int,
    acceleration: int,
    max_sweeps: int,
    min_sweeps: int,
    tolerance: float,
    stop: int,
    residual_every: int,
    period_min: int,
    period_max: int,
    cap: float,
    threshold: float,
    patience: int,
    stretch: int,
    history_at: int,
    pause_at: int,
    body_start: Array,
    color_block: Array,
    row_scale: Array,
    predicted: Array,
    solved: Array,
    summed: Array,
    row_impulse: Array,
    row_change: Array,
    row_before: Array,
    row_direction: Array,
    row_history: Array,
    counters: Array,
    norms: Array,
    history: Array,
) -> bool:
    """Stop (counter 3 then is 1), pause (true), or accelerate; see the Warp kernel."""
    if method == JACOBI:
        bodies = slice(body_start[w], body_start[w + 1])
        solved[bodies] = summed[bodies]
    counter = counters[w * COUNTERS : (w + 1) * COUNTERS]
    norm = norms[w * NORMS : (w + 1) * NORMS]
    if history.shape[1] > counter[0]:
        history[w, counter[0]] = largest
    counter[0] += 1
    norm[0] = largest
    last = counter[0] >= max_sweeps
    if counter[0] < min_sweeps:
        converged = False
    elif stop == BY_RESIDUAL:
        look = last or counter[0] % residual_every == 0
        converged = look and natural_map(world, solved, row_impulse, row_scale[w]) < tolerance
    else:
        converged = largest < tolerance
    counter[3] = int(last or converged)
    used = blocks_of(w, color_block)
    anew = bool(counter[3]) and acceleration == ADAPTIVE and counter[9] == MOMENTUM
    if acceleration != PLAIN and pause_at == NEVER:
        first = acceleration == ADAPTIVE and counter[8] == 0
        x = by_lane(row_impulse)[used]
        best = row_history[history_at + BEST * x.size :][: x.size].reshape(x.shape)
        if (first or 2 * counter[0] > max_sweeps) and largest < x.dtype.type(0.9) * norm[20]:
            norm[20] = largest
            best[:] = x
        if last and norm[20] < HUGE and not largest <= RETREAT * norm[20]:
            x[:] = best
            norm[0] = norm[20]
            anew = True
    if counter[3]:
        if anew:
            refresh(w, world, body_start, predicted, solved, row_impulse)
        return False
    x, change = by_lane(row_impulse)[used], by_lane(row_change)[used]
    inside = counter[1] + 1
    if acceleration == AITKEN:
        counter[1] = inside
        if counter[1] == counter[2] - 1:
            norm[1] = np.sum(change**2)
            if counter[0] >= pause_at - 1:
                by_lane(row_before)[used] = change
        if counter[1] >= counter[2]:
            if counter[0] >= pause_at:  # the extrapolation waits: it is made when the solve goes on
                counter[6] = 1
                norm[4:6] = norm[1], np.sum(change**2)
                return True
            end_period(
                w, world, period_min, period_max, cap, threshold, patience, color_block, solved, row_impulse,
                row_change, counters, norms, True,
            )  # fmt: skip
    if acceleration == ADAPTIVE:
        bodies = slice(body_start[w], body_start[w + 1])
        past = row_history[history_at:]
        Adaptive(
            counter,
            norm,
            x,
            change,
            past[: HISTORY * x.size].reshape(HISTORY, *x.shape),
            solved[bodies],
            past[HISTORY * x.size :][: solved[bodies].size].reshape(-1, 4),
            end_period=lambda: end_period(
                w, world, period_min, period_max, cap, threshold, NEVER, color_block, solved, row_impulse,
                row_change, counters, norms, True,
            ),
            extrapolate=lambda: extrapolate(world, 1.0, solved, row_impulse, row_change),
            refresh=lambda: refresh(w, world, body_start, predicted, solved, row_impulse),
        ).adapt(stretch, period_min, cap)  # fmt: skip
    if acceleration == NNCG:
        now = np.sum(change**2)
        beta = x.dtype.type(0)
        if counter[0] > 1 and now <= norm[2] and norm[2] > 0:
            beta = now / norm[2]
        norm[2] = now
        direction = by_lane(row_direction)[used]
        step = beta * direction if beta > 0 else np.zeros_like(direction)
        direction[:] = step + change
        x += step
        change[:] = step
        if beta > 0:
            for row in world:
                row.change(solved, by_lane(row_change)[row.at])
    if counter[0] >= pause_at - 1 and (acceleration != AITKEN or inside < 0):
        norm[4:6] = norm[5], np.sum(change**2)
        if counter[0] >= pause_at and counter[7] == counter[0] - 1:
            return True
        counter[7] = counter[0]
        by_lane(row_before)[used] = change
    return False
