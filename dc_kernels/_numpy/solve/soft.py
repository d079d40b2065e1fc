"""Substeps with soft contacts and joints, each with a sweep that relaxes them (Catto 2024, "Solver2D"; Box2D 3)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, dot, rotate, rotation
from dc_kernels._numpy.solve.constraints.jacobian import make_jacobian_row
from dc_kernels._numpy.solve.laws import direction
from dc_kernels._numpy.solve.row import Row, by_lane, effective_mass, velocities
from dc_kernels._numpy.solve.world import World
from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.iteration import NEVER
from dc_kernels.solve.joints import PAIRED
from dc_kernels.solve.rows import COLUMNS, LANES, OWN, TOUCH


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
        """Substeps of a world: velocities, displacements, and the impulses of the whole step."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        n, dt = config.substeps, motion.step_dt[w]
        h, size, f = dt / n, model.length_scale[w], config.soft_frequency
        kinds = softness(f, config.soft_damping, h), softness(2 * f, config.soft_damping, h), softness(2 * f, 2.0, h)
        sweep = Sweep(variant, h, config.slop * size, config.max_correction * size / dt, motion, rows)
        pairs = Pairs(w, variant, model, joints, motion, rows)
        bodies = slice(model.body_start[w], model.body_start[w + 1])
        solved, displacement = motion.solved, motion.displacement
        before = np.concatenate([state.velocity[bodies], state.angular_velocity[bodies, None]], axis=1)
        before[model.body_type[bodies] == BodyType.STATIC] = 0
        for k in range(launch.resume, n + 1 if launch.pause == NEVER else launch.resume + launch.pause):
            if k == 0:
                world = World(w, variant, 0, config, model, motion, rows, stats)
                world.load_impulses(joints, contacts)
                solved[bodies, :3], solved[bodies, 3] = before, motion.predicted[bodies, 3]
                displacement[bodies], displacement[bodies, 3] = 0, motion.predicted[bodies, 3]
                world.impulse[:] /= n
                world.change[:] = 0
            else:
                pairs.join(rows.impulse)
                pairs.renew()
            pairs.part()
            turn_rods(w, variant, model, state, joints, motion, rows)
            world = World(w, variant, 0, config, model, motion, rows, stats)
            if k > 0:
                world.bound_rolling()
                changes = [sweep.row(row, RIGID, RIGID, RIGID, relaxes=True) for row in world.own_rows]
                stats.change[w] = world.iteration.change = max(changes, default=0.0)
                made = rows.impulse.copy()
                pairs.join(made)
                world.change[:] += by_lane(made)[world.blocks]
            if k == n:
                bounce(world, state, contacts)
                world.impulse[:] = world.change
                for j in range(rows.line_start[w], rows.line_start[w + 1]):  # rods of sleepers keep every bit
                    if solved[[joints.joint_body_a[j], joints.joint_body_b[j]], 3].min() < 0:
                        rows.impulse[rows.joint_slot[j]] = joints.joint_impulse[j]
                stats.sweeps[w] = world.iteration.sweeps = 2 * n if world.own_rows else 0
                world.iteration.finished, stats.residual[w] = 1, 0.0
                return
            solved[bodies, :3] += (motion.predicted[bodies, :3] - before) / n
            world.apply(rows.impulse)
            world.bound_rolling()
            for row in world.own_rows:
                sweep.row(row, *kinds)
            displacement[bodies, :3] += solved[bodies, :3] * h

    return {"solve_soft": solve_soft}


def turn_rods(w: int, variant: str, model: Any, state: Any, joints: Any, motion: Any, rows: Any) -> None:
    """Rows of rods that are packed as they are made, where the substeps have brought their bodies."""
    names = COLUMNS[variant]
    columns, moved = by_lane(rows.column, len(names)), motion.displacement
    for j in range(rows.line_start[w], rows.line_start[w + 1]):
        a, b = joints.joint_body_a[j], joints.joint_body_b[j]
        if moved[[a, b], 3].min() < 0:  # asleep
            continue
        ra = rotate(rotation(state.angle[a] + moved[a, 2]), joints.joint_anchor_a[j])
        rb = rotate(rotation(state.angle[b] + moved[b, 2]), joints.joint_anchor_b[j])
        d = (state.position[b] + moved[b, :2] + rb) - (state.position[a] + moved[a, :2] + ra)
        length = np.sqrt(dot(d, d))
        if not length > 0:
            continue
        block, lane = divmod(int(rows.joint_slot[j]), 2 * LANES)
        column = columns[block, :, lane]
        jn = direction(d / length, ra, rb)
        mass = effective_mass(jn, a, b, model, motion, column[[names.index("iA"), names.index("iB")]])
        gap = length - joints.joint_length[j] - jn @ np.concatenate([moved[a, :3], moved[b, :3]])
        values = {
            "nx": jn[3],
            "ny": jn[4],
            "ax": jn[3],
            "ay": jn[4],
            "rAn": -jn[2],
            "rBn": jn[5],
            "en": mass,
            "gap": gap,
        }
        for name in set(values) & set(names):
            column[names.index(name)] = values[name]


class Pairs:
    """Two rows each that hold a joint, of which the second is taken without what the first does of it.

    So a sweep over both solves them as one block, whatever the direction that they pull in.
    """

    def __init__(self, w: int, variant: str, model: Any, joints: Any, motion: Any, rows: Any) -> None:
        self.variant, self.model, self.motion, self.rows = variant, model, motion, rows
        self.own = np.arange(rows.row_start[w], rows.row_start[w + 1])
        found = np.arange(model.joint_start[w], model.joint_start[w + 1])
        paired = np.isin(joints.joint_kind[found], PAIRED) & (variant in OWN)
        self.first = joints.joint_row_start[found[paired]]

    def _at(self, k: int) -> tuple[int, int]:
        block, lane = divmod(int(self.rows.row_slot[k]), 2 * LANES)
        return block, lane

    def renew(self) -> None:
        """The columns of the rows, whose joints the substeps have moved since they were packed."""
        columns = by_lane(self.rows.column, len(COLUMNS[self.variant]))
        for k in self.own[self.rows.row_slot[self.own] >= 0]:
            block, lane = self._at(k)
            row = make_jacobian_row(k, self.model, self.motion, self.rows)
            moved = np.concatenate([self.motion.displacement[body, :3] for body in (row.a, row.b)])
            row = row._replace(gap=row.gap - row.jn @ moved)  # from which a sweep adds it
            columns[block, :, lane] = row.columns(self.variant, self.model)

    def part(self) -> None:
        """Take the second row of each pair without the first."""
        if not len(self.first):
            return
        names = COLUMNS[self.variant]
        columns, impulse = by_lane(self.rows.column, len(names)), by_lane(self.rows.impulse)
        *jacobian, _, _ = at = [names.index(name) for name in ("ax", "ay", "rAn", "nx", "ny", "rBn", "gap", "bias")]
        for k in self.first:
            (b1, l1), (b2, l2) = self._at(k), self._at(k + 1)
            one, two = columns[b1, :, l1], columns[b2, :, l2]
            a, b = (int(body) for body in by_lane(self.rows.body)[b1, :, l1])
            (ma, mb), (ia, ib) = self.motion.predicted[[a, b], 3], one[[names.index("iA"), names.index("iB")]]
            weight = np.array([ma, ma, ia, mb, mb, ib])
            share = (weight * one[jacobian]) @ two[jacobian] * one[names.index("en")]
            two[at] -= share * one[at]
            inverse = weight @ two[jacobian] ** 2
            two[names.index("en")] = 1 / inverse if inverse > 0 else 0
            by_lane(self.rows.before)[b2, 1, l2] = share
            impulse[b1, 0, l1] += share * impulse[b2, 0, l2]

    def join(self, impulse: Array) -> None:
        """Impulses along the rows as they were made."""
        impulse = by_lane(impulse)
        for k in self.first:
            (b1, l1), (b2, l2) = self._at(k), self._at(k + 1)
            impulse[b1, 0, l1] -= by_lane(self.rows.before)[b2, 1, l2] * impulse[b2, 0, l2]


class Sweep(NamedTuple):
    """What the sweeps of a step have in common."""

    variant: str
    h: Any  # substep [s]
    slop: Any  # [m]
    limit: Any  # largest bias [m/s]
    motion: Any
    rows: Any

    def row(self, row: Row, both: Softness, fixed: Softness, held: Softness, relaxes: bool = False) -> Any:
        """One row, whose gap follows the displacements to first order; the larger impulse change [N s].

        Args:
            row: of the world.
            both: softness of contacts of two moving bodies.
            fixed: of those with a fixed one.
            held: of joints.
            relaxes: whether the bodies have moved, and the sweep takes back what the softness gave.
        """
        motion, rows = self.motion, self.rows
        off = row.gap + row.jacobian[0] @ row.velocity(motion.displacement)
        impulse = by_lane(rows.impulse)[row.at]
        before = impulse.copy()
        if self.variant in OWN and not row.effective_mass[1] > 0:
            if not relaxes:
                by_lane(rows.before)[row.at][0] = off
            soft, bias = self._of_joint(row, held, off, before[0])
        elif row.low < 0:
            soft, bias = held, np.clip(held.rate * off, -self.limit, self.limit)
        elif off - self.slop > -TOUCH * self.slop:
            soft, bias = RIGID, max(off - self.slop, 0.0) / self.h
        else:
            soft = both if min(motion.solved[row.a, 3], motion.solved[row.b, 3]) > 0 else fixed
            bias = max(soft.rate * min(off, 0.0), -self.limit)
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

    def _of_joint(self, row: Row, held: Softness, off: Any, impulse: Any) -> tuple[Softness, Any]:
        """How a row that is no contact gives way, and its bias."""
        if row.held > 0:
            rigid = row.low < -UNBOUNDED and row.high > UNBOUNDED
            if not rigid and (off < 0 if row.low < 0 else off > 0):
                return RIGID, off / self.h  # within its range: up to the end of it
            return held, np.clip(held.rate * off, -self.limit, self.limit)
        if row.softness > 0:
            return RIGID, row.bias * by_lane(self.rows.before)[row.at][0] + row.softness * impulse
        return RIGID, row.bias


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
