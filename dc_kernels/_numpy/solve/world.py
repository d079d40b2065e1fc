"""What is done to all rows of a world: a sweep, a change of velocities, the residual."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array
from dc_kernels._numpy.solve.row import Row, by_lane, jacobi_row, natural_map_row, read_row, sweep_row
from dc_kernels._numpy.solve.trees import Tree
from dc_kernels.model.config import ACCELERATIONS, JOINT_SOLVERS, METHODS, STOPS
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.solve.iteration import ALIKE, APART, ASKEW, FALL, FAR, FARTHEST, MOVING, NEVER, PAST, RISE, SCARCE
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, OWN

JACOBI = METHODS["jacobi"]
DIRECT = JOINT_SOLVERS["direct"]
SOR = ACCELERATIONS["sor"]
BY_RESIDUAL = STOPS["residual"]
BY_MOTION = STOPS["motion"]
TINY = 1e-30


def relaxation(config: Any) -> float:
    """Relaxation factor of a sweep: omega, or 1 for all accelerations but "sor"."""
    return config.omega if config.acceleration == SOR else 1.0


@dataclass
class World:
    """One world's part of the arrays, as the functions of its solve see it."""

    w: int
    variant: str
    past_at: int
    config: Any
    model: Any
    motion: Any
    rows: Any
    stats: Any
    pause_at: int = NEVER

    @property
    def iteration(self) -> Any:
        """The iteration in flight: writing a field changes it."""
        return self.stats.iteration[self.w]

    @property
    def blocks(self) -> slice:
        """Blocks of its rows."""
        ends = self.rows.color_block[self.w * (COLORS + 1) : (self.w + 1) * (COLORS + 1)]
        return slice(int(ends[0]), int(ends[-1]))

    @property
    def bodies(self) -> slice:
        """Its bodies."""
        return slice(self.model.body_start[self.w], self.model.body_start[self.w + 1])

    @cached_property
    def own_rows(self) -> list[Row]:
        """Its rows in the order of a sweep."""
        lanes = ((b, lane) for b in range(self.blocks.start, self.blocks.stop) for lane in range(LANES))
        read = (read_row(self.variant, b, lane, self.rows, self.motion.predicted) for b, lane in lanes)
        return [row for row in read if row is not None]

    @property
    def impulse(self) -> Array:
        """Impulses of its rows, by lane."""
        return by_lane(self.rows.impulse)[self.blocks]

    @property
    def change(self) -> Array:
        """What the last sweep changed them by."""
        return by_lane(self.rows.change)[self.blocks]

    @property
    def past(self) -> Array:
        """What an accelerated solve looks back on: ``PAST`` arrays like ``impulse``."""
        size = self.impulse.size
        return self.rows.past[self.past_at :][: PAST * size].reshape(PAST, *self.impulse.shape)

    @property
    def past_velocity(self) -> Array:
        """Velocities that it looks back on, like those of its bodies."""
        at = self.past_at + PAST * self.impulse.size
        return self.rows.past[at:][: self.motion.solved[self.bodies].size].reshape(-1, 4)

    @property
    def squared_step(self) -> Any:
        """Sum of squares of the last change."""
        return np.sum(self.change**2)

    @property
    def bound(self) -> Any:
        """What the stop is compared with: without weight only the tolerance counts, or the motion."""
        config, w = self.config, self.w
        relative = config.relative_tolerance * self.motion.weight[w] * self.motion.step_dt[w]
        rods = self.rows.line_start[w + 1] > self.rows.line_start[w]
        if config.stop == BY_MOTION and self.motion.weight[w] == 0 and self.still > 0 and not rods:
            return self.motion.weight[w]
        return min(config.tolerance, relative) if config.stop != BY_RESIDUAL and relative > 0 else config.tolerance

    @property
    def is_still(self) -> bool:
        """Whether the last sweep has moved at most one row in MOVING, one in SCARCE far, and none farthest.

        Nor one far whose bodies are not ALIKE; and the residual is not ASKEW.
        """
        config, motion, model, w = self.config, self.motion, self.model, self.w
        if self.rows.line_start[w + 1] > self.rows.line_start[w]:
            return False  # what a rod lacks shows as stretch: such a world is solved to the tolerances
        real, dt, still = motion.step_dt.dtype.type, motion.step_dt[w], self.still
        fall = real(FALL) * np.sqrt(np.sum(model.gravity[w] ** 2)) * dt
        given = np.abs(motion.solved[:, :2] - motion.predicted[:, :2]).max(axis=1)
        rise = real(RISE) * np.abs(motion.predicted[self.bodies, :2]).max(initial=0)
        share, least = real(config.motion_share), real(config.motion_mean) * min(self.beyond(given, fall), rise)
        farthest = FARTHEST if config.motion_mean > 0 else FAR
        moving = far = movable = 0
        for row in self.own_rows:
            mass = row.effective_mass
            limit = still + max(min(share * (max(given[row.a], given[row.b]) - fall), share * rise), least)
            moved = np.abs(by_lane(self.rows.change)[row.at])
            heavier, lighter = sorted((motion.solved[row.a, 3], motion.solved[row.b, 3]))
            unlike = heavier > 0 and lighter > real(ALIKE) * heavier
            if not (moved <= real(FAR if unlike else farthest) * (limit * mass)).all():
                return False
            far += int(not (moved <= real(FAR) * (limit * mass)).all())
            moving += int(not (moved <= limit * mass).all())
            movable += int(mass[0] > 0)
        return MOVING * moving + SCARCE * far <= movable and not self.lacks(APART) and bool(self.natural_map() < ASKEW)

    @property
    def still(self) -> Any:
        """Change of a row's speed in a sweep that counts as none."""
        config, motion, real = self.config, self.motion, self.motion.step_dt.dtype.type
        length = self.model.length_scale[self.w]
        return real(config.motion_tolerance) * real(config.slop) * length / motion.step_dt[self.w]

    def lacks(self, times: float) -> bool:
        """Whether a row without bounds lacked more of its speed, as the last sweep came to it, than ``times`` still.

        Rows of trees that were solved after it hold exactly.
        """
        change, still = by_lane(self.rows.change), self.motion.step_dt.dtype.type(times) * self.still
        solved = (tree for tree in self.own_trees if self.rows.tree_used[tree] == self.iteration.sweeps)
        exact = {(row.at[0], row.at[2]) for tree in solved for row in self.trees[tree].rows}
        held = (row for row in self.own_rows if row.low < -UNBOUNDED and row.high > UNBOUNDED)
        held = (row for row in held if (row.at[0], row.at[2]) not in exact)
        return any(not abs(change[row.at][0]) <= still * row.effective_mass[0] for row in held)

    def beyond(self, given: Array, fall: Any) -> Any:
        """Mean of what the bodies were given beyond ``fall``, over the mass of those that were given anything [m/s]."""
        given = given[self.bodies]
        touched = given > 0
        mass = 1 / self.motion.solved[self.bodies, 3][touched]
        return np.sum(mass * np.maximum(given[touched] - fall, 0)) / np.sum(mass) if touched.any() else 0

    @property
    def omega(self) -> float:
        """Relaxation factor of a sweep."""
        return relaxation(self.config)

    def sweep(self) -> Any:
        """One sweep over all rows in colour order; the largest impulse change [N s]."""
        by_lane(self.rows.change)[self.blocks] = 0.0  # of empty lanes too
        if self.config.method == JACOBI:
            return max(jacobi_row(row, self.rows, self.motion, self.omega) for row in self.own_rows)
        return max(sweep_row(row, self.rows, self.motion.solved, self.omega) for row in self.own_rows)

    @cached_property
    def trees(self) -> dict[int, Tree]:
        """Its trees of joints by number."""
        return {tree: Tree(tree, self.variant, self.rows, self.motion.predicted) for tree in self.own_trees}

    def follow(self, change: Any) -> bool:
        """Solve the trees of joints that the sweeps have left apart; whether that was first found of one."""
        config, rows, sweeps = self.config, self.rows, self.iteration.sweeps
        if config.joint_solver != DIRECT or config.method == JACOBI:
            return False
        late, found = sweeps >= config.min_sweeps, False
        looks = (sweeps + 1) % min(config.residual_every, config.max_sweeps) == 0 or (late and change < self.bound)
        still = self.motion.step_dt.dtype.type(FAR if sweeps + 1 < config.min_sweeps else APART) * self.still
        unsolved = config.stop != BY_MOTION and not change < self.bound
        for tree in self.own_trees:
            used = bool(rows.tree_used[tree])
            if not (looks or (late and used)):
                continue
            if unsolved or self.trees[tree].lacks(still, rows):
                found = found or not used
                rows.tree_used[tree] = sweeps
                self.trees[tree].solve(rows, self.motion.solved)
        return found

    @property
    def own_trees(self) -> range:
        """Its trees of joints."""
        start = self.rows.tree_start
        return range(start[self.w], start[self.w + 1]) if self.variant in OWN else range(0)

    def apply(self, delta: Array) -> None:
        """Velocities follow a change of all impulses: V += M^-1 J^T delta (Wu 2018, equation 2.26)."""
        for row in self.own_rows:
            row.change(self.motion.solved, by_lane(delta)[row.at])

    def refresh(self) -> None:
        """Velocities anew from the impulses."""
        self.motion.solved[self.bodies] = self.motion.predicted[self.bodies]
        self.apply(self.rows.impulse)

    def load_impulses(self, joints: Any, contacts: Any) -> None:
        """Impulses of contacts and joints to the rows; predicted velocities plus what they add.

        A row along which nothing can move has none.
        """
        rows, w = self.rows, self.w
        for tree in self.own_trees:
            rows.tree_used[tree] = 0
        self.impulse[:] = 0.0
        own = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
        columns = COLUMNS[self.variant]
        block, lane = np.divmod(rows.slot[own], 2 * LANES)
        moves = by_lane(rows.column, len(columns))[block, :, lane] > 0
        rows.impulse[rows.slot[own]] = contacts.impulse[own, 0] * moves[:, columns.index("en")]
        rows.impulse[rows.slot[own] + LANES] = contacts.impulse[own, 1] * moves[:, columns.index("et")]
        own = slice(self.rows.line_start[w], self.rows.line_start[w + 1])
        rows.impulse[rows.joint_slot[own]] = joints.joint_impulse[own]
        own = np.arange(rows.row_start[w], rows.row_start[w + 1])
        own = own[rows.row_slot[own] >= 0]  # else it can carry nothing
        block, lane = np.divmod(rows.row_slot[own], 2 * LANES)
        moves = by_lane(rows.column, len(columns))[block, columns.index("en"), lane] > 0
        rows.impulse[rows.row_slot[own]] = rows.row_impulse[own] * moves
        if len(rows.roll_slot):
            own = np.arange(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
            own = own[rows.roll_slot[own] >= 0]
            rows.impulse[rows.roll_slot[own]] = contacts.rolling_impulse[own]
            self.bound_rolling()
        self.refresh()

    @property
    def rolling(self) -> list[Row]:
        """Its rows of rolling resistance."""
        return [row for row in self.own_rows if row.roll > 0]

    def bound_rolling(self) -> None:
        """Bounds of the rows of rolling resistance follow the normal impulses of their contacts."""
        columns = COLUMNS[self.variant]
        for row in self.rolling:
            block, _, lane = row.at
            row.high = row.roll * self.rows.impulse[self.rows.limit_slot[block * LANES + lane]]
            row.low = -row.high
            for name, value in (("lo", row.low), ("hi", row.high)):
                by_lane(self.rows.column, len(columns))[block, columns.index(name), lane] = value

    def extrapolate(self, alpha: Any) -> None:
        """Move on: x <- clamp(x + alpha change); change is then what x moved by, and velocities follow."""
        for row in self.own_rows:
            impulse, step = by_lane(self.rows.impulse)[row.at], by_lane(self.rows.change)[row.at]
            new = impulse + alpha * step
            new[0] = row.within(new[0])
            limit = row.friction * new[0]
            new[1] = min(max(new[1], -limit), limit)
            step[:] = new - impulse
            impulse[:] = new
            row.change(self.motion.solved, step)

    def natural_map(self) -> Any:
        """Relative natural map."""
        total = np.sqrt(sum(natural_map_row(row, self.rows, self.motion.solved) for row in self.own_rows))
        scale = self.rows.scale[self.w]
        return total / scale if scale > TINY else total
