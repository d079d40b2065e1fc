"""Lemke's pivoting for small Delassus problems: exact, and ends on any positive semidefinite W (Anitescu, Potra 1997).

A 2D problem is a linear complementarity problem w = M z + b, w and z >= 0, w . z = 0 with z = (r_n, r_t+, r_t-, l) of
each contact, r_t = r_t+ - r_t-: u_n; u_t + l, -u_t + l; mu r_n - r_t+ - r_t-. Rows without friction have r_n alone, and
bilateral ones r+ and r- against u and -u. Where many contacts carry what few could, methods that descend or smooth
crawl along null vectors of W; pivots go from vertex to vertex instead. In large problems it is one place that holds up
the others: ``solve_patch`` solves that alone.
"""

from __future__ import annotations

import numpy as np

from dc_kernels.delassus.problem import DelassusProblem, assemble_blocks, natural_map

PIVOT = 1e-11  # smallest element to pivot on: the table is of order 1
SHIFT = 1e-9  # by which right-hand sides are moved to make vertices simple: taken back at the end


WHOLE = 120  # contacts up to which a problem is solved at once: 0.1 s, and four times that for twice as many
PATCH = 80  # contacts of a patch


def lemke(problem: DelassusProblem, max_pivots: int | None = None) -> np.ndarray | None:
    """Solve a problem by pivots on dense tables of up to (4n)^2.

    Args:
        problem: of up to some hundred contacts.
        max_pivots: at most; None: 20 for each unknown.

    Returns:
        Impulses (n, 2) [N s]; None where a ray or the last pivot is met.
    """
    n = problem.count
    impulse, speed = problem.units
    # each contact in the unit of impulse that makes its normal diagonal 1; W stays symmetric
    size = 1.0 / np.sqrt(problem.diagonal[:, 0, 0] * impulse / speed)
    blocks = np.zeros((n, 2, n, 2))
    blocks[problem.row, :, problem.column] = (
        problem.block * (impulse / speed) * (size[problem.row] * size[problem.column])[:, None, None]
    )
    w = blocks.reshape(2 * n, 2 * n)
    q = (problem.q / speed * size[:, None]).ravel()
    rubs = np.flatnonzero((problem.mu > 0.0) & ~problem.bilateral)
    free = np.flatnonzero(problem.bilateral)
    # unknowns: signed rows of (w, q), then the l of contacts with friction
    line = np.concatenate([2 * np.arange(n), 2 * rubs + 1, 2 * rubs + 1, 2 * free])
    sign = np.concatenate([np.ones(n), np.ones(len(rubs)), -np.ones(len(rubs)), -np.ones(len(free))])
    k, m = len(line), len(line) + len(rubs)
    table = np.zeros((m, m))
    table[:k, :k] = sign[:, None] * w[np.ix_(line, line)] * sign
    plus, minus, bound = n + np.arange(len(rubs)), n + len(rubs) + np.arange(len(rubs)), k + np.arange(len(rubs))
    table[plus, bound] = table[minus, bound] = 1.0
    table[bound, plus] = table[bound, minus] = -1.0
    table[bound, rubs] = problem.mu[rubs]
    right = np.concatenate([sign * q[line], np.zeros(len(rubs))])
    basis = _pivot(table, right, 20 * m if max_pivots is None else max_pivots)
    if basis is None:
        return None
    z = np.zeros(m)
    chosen = np.flatnonzero(basis)
    z[chosen] = np.linalg.lstsq(table[np.ix_(chosen, chosen)], -right[chosen], rcond=None)[0]
    r = np.zeros(2 * n)
    np.add.at(r, line, sign * z[:k])
    return problem.inside(r.reshape(n, 2) * (size[:, None] * impulse))


def _pivot(matrix: np.ndarray, right: np.ndarray, max_pivots: int) -> np.ndarray | None:
    """Run Lemke's method with a covering vector of ones; return which of z are basic in the end, (m,) bool, or None."""
    m = len(right)
    if m == 0 or right.min() >= 0.0:
        return np.zeros(m, bool)
    draw = np.random.default_rng(0)
    # basic = a @ nonbasic + b; columns: z, z_0, and last b
    a = np.concatenate([matrix, np.ones((m, 1)), (right + SHIFT * draw.uniform(0.5, 1.0, m))[:, None]], axis=1)
    basic = np.arange(m)  # w
    nonbasic = np.arange(m, 2 * m + 1)  # z and z_0, which is 2 m
    row, column = int(np.argmin(a[:, -1])), m
    for _ in range(max_pivots):
        leaving = int(basic[row])
        # the row solved for the entering variable, and put into all others
        entering_row = -a[row] / a[row, column]
        entering_row[column] = 1.0 / a[row, column]
        factor = a[:, column].copy()
        a += np.outer(factor, entering_row)
        a[:, column] = factor * entering_row[column]
        a[row] = entering_row
        basic[row], nonbasic[column] = nonbasic[column], leaving
        if leaving == 2 * m:
            found = np.zeros(m, bool)
            found[basic[basic >= m] - m] = True
            return found
        column = int(np.flatnonzero(nonbasic == (leaving + m) % (2 * m))[0])
        falls = a[:, column] < -PIVOT
        if not falls.any():
            return None
        rows = np.flatnonzero(falls)
        ratio = np.maximum(a[rows, -1], 0.0) / -a[rows, column]
        near = rows[ratio <= ratio.min() * (1.0 + 1e-9)]
        zero = near[basic[near] == 2 * m]
        row = int(zero[0] if len(zero) else near[np.argmin(a[near, column])])
    return None


def solve_patch(problem: DelassusProblem, impulses: np.ndarray) -> np.ndarray | None:
    """Solve the contact with the largest natural map and those around it by pivots, with all others held.

    Args:
        problem: of any size.
        impulses: (n, 2) [N s].

    Returns:
        Impulses (n, 2) [N s]; None where ``lemke`` finds none.
    """
    n, u = problem.count, problem.velocity(impulses)
    wrong = natural_map(problem.diagonal[:, :1, 0] * impulses, u, problem.mu, problem.bilateral)
    chosen = [int(np.argmax((wrong * wrong).sum(axis=1)))]
    place = np.full(n, -1)
    place[chosen[0]] = 0
    for c in chosen:  # breadth first; grows while it runs
        for j in problem.column[problem.row_start[c] : problem.row_start[c + 1]]:
            if place[j] < 0 and len(chosen) < PATCH:
                place[j] = len(chosen)
                chosen.append(int(j))
    inside = np.flatnonzero((place[problem.row] >= 0) & (place[problem.column] >= 0))
    row, column = place[problem.row[inside]], place[problem.column[inside]]
    entry = np.tile(np.arange(4), len(inside))
    start, columns, block = assemble_blocks(
        len(chosen), np.repeat(row, 4), np.repeat(column, 4), entry // 2, entry % 2, problem.block[inside].ravel()
    )
    own = np.einsum("kij,kj->ki", problem.block[inside], impulses[problem.column[inside]])
    within = np.stack([np.bincount(row, own[:, i], len(chosen)) for i in (0, 1)], axis=1)
    found = lemke(
        DelassusProblem(
            row_start=start,
            column=columns,
            block=block,
            q=u[chosen] - within,
            mu=problem.mu[chosen],
            bilateral=problem.bilateral[chosen],
        )
    )
    if found is None:
        return None
    result = impulses.copy()
    result[chosen] = found
    return result
