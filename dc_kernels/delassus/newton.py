"""Delassus problems on which first-order methods stall: pivots (``lemke``), then Newton's method, which needs SciPy.

Newton's is a proximal point method: from x_k solve the problem with W + reg D and q - reg D x_k, D the diagonal of W,
and let reg fall while that is easy. Each of these problems is regular, whatever W; it is solved by semismooth Newton on
the nonsymmetric formulation of Alart and Curnier (1991) with a line search, and by sweeps where that gets nowhere: they
find active sets, Newton the long modes of a fixed one. Where piles are hyperstatic, impulses drift along null vectors
of W until some contact slips or opens; a small reg takes such ways in one step, which no descent method does.
"""

from __future__ import annotations

import numpy as np

from dc_kernels.delassus.first_order import FirstOrder
from dc_kernels.delassus.groups import PROBLEM, Acceleration, PackedProblem
from dc_kernels.delassus.lemke import WHOLE, lemke, solve_patch
from dc_kernels.delassus.search import HUGE, LEAST, Search
from dc_kernels.runtime.imports import require

FIRST_SWEEPS = 60  # before Newton: active sets are roughly known then
PATIENCE = 100  # sweeps without a map halved, after which they have stalled
PATCHES = 4  # that may fail to halve the map before others try
WORSE = 100.0  # times the map: a patch that leaves more elsewhere is taken back
AFTER_PATCH = 30  # sweeps after each: what a patch moves its neighbours follow
SLOW = 3000  # sweeps that may follow while they gain a little: they are cheaper than what comes next
SMALL, LARGE = 40, 400  # contacts between which a few factorisations come before pivots, which take milliseconds below
FEW = 15  # of them; above, one place mostly holds up all others
FACTORIZATIONS = 1000  # at most in a solve
REG_FIRST, REG_LEAST, REG_MOST = 1e-3, 1e-13, 1e3
STEPS = (1.0, 0.5, 0.25, 0.1)  # of the line search
INNER = 15  # Newton steps for one regularised problem
FAILURES = 3  # line searches that may fail in it, each followed by sweeps
QUICK = 4  # Newton steps of an easy one, after which reg falls
ACCURACY = 0.1  # to which it is solved, relative to the map it started from: 1e-3 costs a fifth more
SWEEPS, SWEEPS_MOST = 100, 3000  # beside a failed line search; twice as many after each failed problem
AFTER = 10  # sweeps without regularisation after each problem


def search_automatically(search: Search, *, newton_only: bool = False) -> None:
    """Sweep; pivot where sweeps stall, take Newton's method where that fails too, and sweep again.

    With ``newton_only`` Newton's method follows 60 sweeps.

    Raises:
        ImportError: ``newton_only`` without SciPy.
    """
    if newton_only:
        require("scipy", "pipeline")
        search.sweep("anderson", FIRST_SWEEPS)
        _newton(search, patches=False)
        return
    looks = max(1, PATIENCE // search.options.every)
    search.sweep("anderson", FIRST_SWEEPS)
    search.sweep("anderson", search.options.max_sweeps, patience=looks)
    search.sweep("hybrid", SLOW, patience=looks, gain=0.9)
    if SMALL < search.problem.count <= LARGE and _has_scipy():
        _newton(search, patches=False, most=FEW)
    _pivots(search)
    if search.done:
        return
    if _has_scipy():
        _newton(search, patches=True)
    else:
        search.sweep("hybrid", search.options.max_sweeps, patience=10 * looks)
    search.sweep("aitken", search.options.max_sweeps)


def _has_scipy() -> bool:
    try:
        require("scipy", "pipeline")
    except ImportError:
        return False
    return True


def _pivots(search: Search) -> None:
    """Solve small problems by pivots and sweeps that round them off; large ones patch by patch, while that helps."""
    patience = PATCHES
    x = search.best
    while not search.done and patience > 0 and search.sweeps < search.options.max_sweeps:
        patience -= 1
        whole = search.problem.count <= WHOLE
        y = lemke(search.problem) if whole else solve_patch(search.problem, x)
        search.pivotings += 1
        if y is None:
            return
        before = search.worst(search.maps)
        search.offer(y)
        x = search.sweep("aitken", AFTER_PATCH, start=y)
        if whole:
            return
        if search.worst(search.maps) < 0.5 * before:
            patience = PATCHES


def _newton(search: Search, patches: bool, most: int = FACTORIZATIONS) -> None:
    if not search.done and search.problem.count:
        Newton(search, patches, most).run()


class Newton:
    """Newton's method on one problem, in the units in which it is of order 1; impulses are flat, (2n,)."""

    def __init__(self, search: Search, patches: bool, most: int) -> None:
        """Set up W as a sparse matrix.

        Args:
            search: what is solved.
            patches: use pivots too, where a regularised problem is not solved.
            most: factorisations.
        """
        self.most = search.factorizations + most
        sparse = require("scipy.sparse", "pipeline")
        problem = search.problem
        self.search, self.problem, self.patches = search, problem, patches
        self.unit, speed = problem.units
        factor = self.unit / speed
        n = self.n = problem.count
        row = problem.row
        self.own = row == problem.column
        block = problem.block * factor
        rows = (2 * row[:, None, None] + np.array([[0, 0], [1, 1]])).ravel()
        columns = (2 * problem.column[:, None, None] + np.array([[0, 1], [0, 1]])).ravel()
        entries = sparse.csc_matrix((block.ravel(), (rows, columns)), shape=(2 * n, 2 * n))
        entries.eliminate_zeros()
        self.matrix = entries.tocsr()
        triplets = entries.tocoo()
        self.rows, self.columns, self.values = triplets.row, triplets.col, triplets.data
        self.q = (problem.q / speed).ravel()
        diagonal = np.stack([problem.diagonal[:, 0, 0], problem.diagonal[:, 1, 1]], axis=1) * factor
        self.diagonal = np.where(diagonal > 0.0, diagonal, 1.0).ravel()
        self.rubs = (problem.mu > 0.0) & ~problem.bilateral
        # the launch is kept: to make it anew takes a millisecond
        self.blocks, self.packed_reg = block.reshape(-1, 4), -1.0
        self.packed = problem.packed(search.options.dtype, search.options.backend)
        self.regular = PackedProblem(self.packed.sizes, search.options.dtype, backend=search.options.backend)
        for name in PROBLEM:
            self.regular.numpy(name)[...] = self.packed.numpy(name)
        self.regular.scale = factor
        self.first_order = FirstOrder(self.regular, Acceleration.ANDERSON, 1)
        self.kernel_block, self.kernel_inverse, self.kernel_q = (
            self.regular.numpy(name) for name in ("block", "inverse", "q")
        )

    # ------------------------------------------------------------------ the outer iteration

    def run(self) -> None:
        """Solve regularised problems until the search is done, or all factorisations or sweeps are spent."""
        search = self.search
        x = search.best.ravel() / self.unit
        now = search.worst(search.maps)
        reg, sweeps, wait = REG_FIRST, SWEEPS, 0
        while not search.done and search.factorizations < self.most and search.sweeps < search.options.max_sweeps:
            goal = max(ACCURACY * now, 0.1 * search.options.tolerance)
            y, solved, steps = self.proximal(x, reg, goal, sweeps)
            then = self.offer(y)
            if solved:
                x, now = y, then
                wait -= 1
                if steps <= QUICK and wait <= 0:
                    reg = max(0.1 * reg, REG_LEAST)
                sweeps = max(SWEEPS, sweeps // 2)
            else:
                reg, wait = min(10.0 * reg, REG_MOST), 2
                sweeps = min(2 * sweeps, SWEEPS_MOST)
                if then < now:
                    x, now = y, then
                y = self.patched(x)
                then = self.offer(y)
                if then < WORSE * now:
                    x, now = y, then
            y = self.sweep(x, x, 0.0, AFTER, 0.0)
            then = self.offer(y)
            if then < now or not solved:
                x, now = y, then

    def patched(self, x: np.ndarray) -> np.ndarray:
        """Solve the worst patch by pivots and sweep after it; with Newton's method alone, change nothing."""
        if not self.patches:
            return x
        self.search.pivotings += 1
        found = solve_patch(self.problem, x.reshape(-1, 2) * self.unit)
        return x if found is None else self.sweep(found.ravel() / self.unit, x, 0.0, AFTER_PATCH, 0.0)

    def offer(self, x: np.ndarray) -> float:
        """Keep impulses if they are the best, and return their natural map."""
        impulses = x.reshape(-1, 2) * self.unit
        self.search.offer(impulses)
        return self.search.worst((float(self.search.rows[-1][0, 1]), float(self.search.rows[-1][0, 2])))

    def proximal(self, start: np.ndarray, reg: float, goal: float, sweeps: int) -> tuple[np.ndarray, bool, int]:
        """Solve the problem regularised about ``start``.

        Returns:
            Impulses, whether they solve it to ``goal``, and the Newton steps taken.
        """
        x = start
        u = self.matrix @ x + self.q
        error, failures = self.residual(x, u), 0
        for step in range(INNER):
            if error <= goal:
                return x, True, step
            if self.search.factorizations >= self.most:
                break
            target = self.newton_point(x, u, reg)
            moved = False
            for length in STEPS if target is not None else ():
                y = self.problem.inside((x + length * (target - x)).reshape(-1, 2)).ravel()
                v = self.regular_velocity(y, start, reg)
                then = self.residual(y, v)
                if then < error * (1.0 - 1e-3 * length):
                    x, u, error, moved = y, v, then, True
                    break
            if not moved or length < 0.3:
                failures += not moved
                if failures > FAILURES:
                    return x, False, step
                x = self.sweep(x, start, reg, sweeps * max(failures, 1), goal)
                u = self.regular_velocity(x, start, reg)
                error = self.residual(x, u)
        return x, error <= goal, INNER

    def regular_velocity(self, x: np.ndarray, start: np.ndarray, reg: float) -> np.ndarray:
        """Compute the velocity in the problem that is regularised about ``start``."""
        return self.matrix @ x + self.q + reg * self.diagonal * (x - start)

    # ------------------------------------------------------------------ one regularised problem

    def residual(self, x: np.ndarray, u: np.ndarray) -> float:
        """Compute the norm of the function of Alart and Curnier (1991), each impulse as the velocity it changes."""
        d = self.diagonal
        z = x - u / d
        normal = np.where(self.problem.bilateral, z[::2], np.maximum(z[::2], 0.0))
        limit = self.problem.mu * np.maximum(x[::2], 0.0)
        wrong = np.empty_like(x)
        wrong[::2] = x[::2] - normal
        wrong[1::2] = x[1::2] - np.clip(z[1::2], -limit, limit)
        return float(np.linalg.norm(d * wrong))

    def newton_point(self, x: np.ndarray, u: np.ndarray, reg: float) -> np.ndarray | None:
        """Find where all equations hold on the present active sets; None where the factorisation fails.

        Unknown are the normal impulses of contacts that press and the tangential ones of those that stick; the friction
        of a contact that slips is +-mu times its normal impulse, all others are 0.
        """
        sparse, linalg = require("scipy.sparse", "pipeline"), require("scipy.sparse.linalg", "pipeline")
        n, mu = self.n, self.problem.mu
        z = x - u / self.diagonal
        presses = (z[::2] > 0.0) | self.problem.bilateral
        limit = mu * np.maximum(x[::2], 0.0)
        over, under = z[1::2] > limit, z[1::2] < -limit
        sticks = presses & self.rubs & ~over & ~under
        unknown = np.stack([presses, sticks], axis=1).ravel()
        place = np.flatnonzero(unknown)
        if not len(place):
            return np.zeros_like(x)
        index = np.full(2 * n, -1)
        index[place] = np.arange(len(place))
        source, weight = index.copy(), np.ones(2 * n)  # each impulse is a multiple of an unknown one
        slips = presses & ~sticks
        source[1::2][slips] = index[::2][slips]
        weight[1::2] = np.where(slips, mu * (over.astype(float) - under), 1.0)
        used = (index[self.rows] >= 0) & (source[self.columns] >= 0)
        row, column = index[self.rows[used]], source[self.columns[used]]
        values = self.values[used] * weight[self.columns[used]]
        own = np.arange(len(place))
        entries = (np.r_[values, reg * self.diagonal[place]], (np.r_[row, own], np.r_[column, own]))
        matrix = sparse.csc_matrix(entries, shape=(len(place), len(place)))
        near = np.where(source >= 0, weight * x[place][source], 0.0)  # the impulses on these sets
        wanted = -(u + self.matrix @ (near - x) + reg * self.diagonal * (near - x))[place]
        self.search.factorizations += 1
        try:
            with np.errstate(all="ignore"):
                change = linalg.splu(
                    matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options={"SymmetricMode": True}
                ).solve(wanted)
        except RuntimeError:  # exactly singular
            return None
        found = x[place] + change
        return np.where(source >= 0, weight * found[source], 0.0) if np.isfinite(found).all() else None

    def sweep(self, x: np.ndarray, start: np.ndarray, reg: float, sweeps: int, goal: float) -> np.ndarray:
        """Sweep on the problem regularised about ``start`` by Anderson's acceleration, or Aitken's where reg is 0."""
        search = self.search
        sweeps = min(sweeps, search.options.max_sweeps - search.sweeps)
        if sweeps <= 0:
            return x
        if reg != self.packed_reg:
            block, inverse = self.kernel_block, self.kernel_inverse
            block[...] = self.blocks
            block[self.own, 0] += reg * self.diagonal[::2]
            block[self.own, 3] += reg * self.diagonal[1::2]
            inverse[...] = self.packed.numpy("inverse") / inverse.dtype.type(1.0 + reg)
            self.packed_reg = reg
        self.kernel_q[...] = (self.q - reg * self.diagonal * start).reshape(-1, 2)
        progress = self.first_order(
            x.reshape(-1, 2),
            method=int(Acceleration.ANDERSON if reg else Acceleration.AITKEN),
            max_sweeps=sweeps,
            every=max(20, search.options.every) if goal else sweeps,
            tolerance=HUGE if goal else LEAST,
            scaled_tolerance=0.5 * goal if goal else HUGE,
        )
        search.sweeps += int(progress["sweeps"])
        return self.first_order.impulse.astype(np.float64).ravel()
