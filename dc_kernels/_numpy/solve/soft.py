"""Substeps with soft contacts, each followed by a sweep that relaxes them (Catto 2024, "Solver2D"; Box2D 3)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot
from dc_kernels._numpy.solve.row import Row, by_lane, velocities
from dc_kernels._numpy.solve.world import World
from dc_kernels.model.enums import BodyType
from dc_kernels.solve.rows import LANES, TOUCH


class Softness(NamedTuple):
    """How a row gives way."""

    rate: Any  # of the bias [1/s]
    mass: Any  # share of the effective mass
    give: Any  # share of the impulse that is given back


RIGID = Softness(0.0, 1.0, 0.0)


def softness(frequency: Any, damping: Any, h: Any) -> Softness:
    """Softness of a spring and damper over a substep h (Catto 2011); the frequency is times h."""
    turn = 2 * np.pi * frequency
    drag = 2 * damping + turn
    return Softness(turn / drag / h, turn * drag / (1 + turn * drag), 1 / (1 + turn * drag))


def kernels(dtype: str, variant: str) -> Kernels:
    """``solve_soft``; the arrays bring their scalar type."""

    def solve_soft(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        joints: Any,
        contacts: Any,
        motion: Any,
        rows: Any,
        stats: Any,
    ) -> None:
        """All substeps of a world: velocities, displacements, and the impulses of the whole step."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        world = World(w, variant, 0, config, model, motion, rows, stats)
        world.load_impulses(joints, contacts)
        n, dt = config.substeps, motion.step_dt[w]
        h, size, f = dt / n, model.length_scale[w], config.soft_frequency
        both, fixed = softness(f, config.soft_damping, h), softness(2 * f, config.soft_damping, h)
        rods, limit = softness(2 * f, 2.0, h), config.max_correction * size / dt

        def kind(row: Row) -> Softness:
            if row.low < 0:
                return rods
            return both if min(motion.solved[row.a, 3], motion.solved[row.b, 3]) > 0 else fixed

        bodies = np.arange(model.body_start[w], model.body_start[w + 1])
        solved, displacement = motion.solved, motion.displacement
        before = np.concatenate([state.velocity[bodies], state.angular_velocity[bodies, None]], axis=1)
        before[model.body_type[bodies] == BodyType.STATIC] = 0
        gained = (motion.predicted[bodies, :3] - before) / n
        solved[bodies, :3], solved[bodies, 3] = before, motion.predicted[bodies, 3]
        displacement[bodies], displacement[bodies, 3] = 0, motion.predicted[bodies, 3]
        world.impulse[:] /= n
        total = np.zeros_like(world.impulse)
        change = 0.0
        for _ in range(n):
            solved[bodies, :3] += gained
            world.apply(rows.impulse)
            for row in world.own_rows:
                sweep_soft(row, kind(row), h, config.slop * size, limit, motion, rows)
            displacement[bodies, :3] += solved[bodies, :3] * h
            change = 0.0
            for row in world.own_rows:
                change = max(change, sweep_soft(row, RIGID, h, config.slop * size, limit, motion, rows))
            total += world.impulse
        world.change[:] = total
        bounce(world, state, contacts)
        world.impulse[:] = world.change
        stats.sweeps[w] = world.iteration.sweeps = 2 * n if world.own_rows else 0
        stats.change[w] = world.iteration.change = change
        world.iteration.finished, stats.residual[w] = 1, 0.0

    return {"solve_soft": solve_soft}


def sweep_soft(row: Row, soft: Softness, h: Any, slop: Any, limit: Any, motion: Any, rows: Any) -> Any:
    """One row, whose gap follows the displacements to first order; the larger impulse change [N s]."""
    off = row.gap + row.jacobian[0] @ row.velocity(motion.displacement)
    if row.low < 0:
        bias = np.clip(soft.rate * off, -limit, limit)
    elif off - slop > -TOUCH * slop:
        soft, bias = RIGID, max(off - slop, 0.0) / h
    else:
        bias = max(soft.rate * min(off, 0.0), -limit)
    impulse = by_lane(rows.impulse)[row.at]
    before = impulse.copy()
    change = np.zeros_like(before)
    speed = row.jacobian[0] @ row.velocity(motion.solved) + bias
    impulse[0] = row.within(before[0] - row.effective_mass[0] * soft.mass * speed - soft.give * before[0])
    change[0] = impulse[0] - before[0]
    speed = row.jacobian[1] @ (row.velocity(motion.solved) + row.response[0] * change[0]) + row.slip
    most = row.friction * impulse[0]
    impulse[1] = min(max(before[1] - row.effective_mass[1] * speed, -most), most)
    change[1] = impulse[1] - before[1]
    row.change(motion.solved, change)
    return abs(change).max()


def bounce(world: World, state: Any, contacts: Any) -> None:
    """Let contacts that were hit leave with the share of their speed before the step that restitution says."""
    config, model, motion, rows, w = world.config, world.model, world.motion, world.rows, world.w
    hardly = config.restitution_threshold * np.sqrt(
        np.sqrt(dot(model.gravity[w], model.gravity[w])) * model.length_scale[w]
    )
    at = {(row.at[0], row.at[2]): row for row in world.own_rows}
    change: Array = by_lane(rows.change)
    first = contacts.contact_start[w]
    for c in range(first, first + contacts.contact_count[w]):
        e = contacts.restitution[c]
        row = at[divmod(int(rows.slot[c]), 2 * LANES)]
        if not (e > 0 and change[row.at][0] > 0):
            continue
        before = row.jacobian[0] @ velocities(state, row.a, row.b)
        if before < -(hardly if e < 1 else 0.0):
            now = row.jacobian[0] @ row.velocity(motion.solved)
            x = by_lane(rows.impulse)[row.at][0]
            more = max(x - row.effective_mass[0] * (now + e * before), 0.0) - x
            row.change(motion.solved, np.array([more, 0.0], x.dtype))
            by_lane(rows.impulse)[row.at][0] = x + more
            change[row.at][0] += more
