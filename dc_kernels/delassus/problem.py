"""Frictional contact problems in Delassus form, u = W r + q, as other simulators exchange them (FCLIB), and solvers.

Contact c owns rows 2c (normal) and 2c + 1 (tangent) of u, q and r: u_n >= 0 where r_n = 0, u_n = 0 where r_n > 0, and
Coulomb's law |r_t| <= mu r_n, against u_t. W is kept in rows of 2x2 blocks. It may be singular, and unsymmetric by
round-off: no solver here needs more than its diagonal to be positive.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dc_kernels.model.arrays import FLOATS, check_values, kernel_array, kernel_vectors
from dc_kernels.runtime.backends import check_backend
from dc_kernels.runtime.optional import require

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

Method = Literal["auto", "pgs", "sor", "aitken", "nncg", "anderson", "hybrid", "newton"]
METHODS = {"pgs": 0, "sor": 0, "aitken": 1, "nncg": 2, "anderson": 3, "hybrid": 4}
"""Methods of one kernel; "auto" and "newton" are made of them and of ``newton``."""
FREE = -3e38  # least normal impulse of a row without bound; finite in float32


@dataclass(frozen=True, kw_only=True, eq=False)
class DelassusProblem:
    """A problem of n contacts: checked once, float64, never changed."""

    row_start: np.ndarray
    """First block of each contact's row, and the number of blocks, (n + 1,) integers."""
    column: np.ndarray
    """Contact whose impulse a block takes, (blocks,) integers."""
    block: np.ndarray
    """[[nn, nt], [tn, tt]] of each block of W, (blocks, 2, 2) [1/kg]."""
    q: np.ndarray
    """Normal and tangential velocity without impulses, (n, 2) [m/s]; restitution and gaps are part of it."""
    mu: np.ndarray
    """Coulomb coefficient, (n,) [1]."""
    bilateral: np.ndarray = None  # type: ignore[assignment]  # given as None it becomes an array
    """Rows without bound on the normal impulse and without friction: joints, (n,) bool; None: none are."""
    slot: np.ndarray | None = None
    """Where the impulses lie in the arrays of the simulation they are from: contacts, then joints, (n,)."""

    def __post_init__(self) -> None:
        """Check everything.

        Raises:
            ValueError: naming array and index: a wrong shape, NaN or inf, an index out of range, a block given twice,
                mu < 0, a diagonal that is missing or not positive.
        """
        mu = np.asarray(self.mu)
        n = len(mu) if mu.ndim == 1 else 0
        float64, int32 = np.dtype(np.float64), np.dtype(np.int32)
        column = np.asarray(self.column)
        blocks = len(column) if column.ndim == 1 else 0
        arrays = {
            "mu": check_values("mu", mu, (n,), float64),
            "q": check_values("q", self.q, (n, 2), float64),
            "row_start": check_values("row_start", self.row_start, (n + 1,), int32),
            "column": check_values("column", column, (blocks,), int32),
            "block": check_values("block", self.block, (blocks, 2, 2), float64),
        }
        free = np.zeros(n, bool) if self.bilateral is None else np.asarray(self.bilateral)
        if free.shape != (n,) or free.dtype != bool:
            raise ValueError(f"bilateral has shape {free.shape}, dtype {free.dtype}; it must be ({n},) bool")
        arrays["bilateral"] = free
        for name, value in arrays.items():
            object.__setattr__(self, name, value)
        _refuse("mu", self.mu, self.mu < 0.0, "not negative")
        _refuse("mu", self.mu, free & (self.mu != 0.0), "0 where bilateral")
        start = self.row_start
        _refuse("row_start", start, np.diff(start, prepend=0) < 0, "ascending from 0 on")
        if start[0] != 0 or start[-1] != blocks:
            raise ValueError(
                f"row_start runs from {start[0]} to {start[-1]}; it must run from 0 to {blocks}, the blocks"
            )
        _refuse("column", self.column, (self.column < 0) | (self.column >= n), f"in [0, {n})")
        row = self.row
        place = row * np.int64(max(n, 1)) + self.column
        twice = np.zeros(blocks, bool)
        order = np.argsort(place, kind="stable")
        twice[order[1:]] = place[order[1:]] == place[order[:-1]]
        if twice.any():
            k = int(np.flatnonzero(twice)[0])
            raise ValueError(f"column[{k}] is {self.column[k]} once more in row {row[k]}; a block is given once")
        diagonal = self.diagonal
        _refuse("the normal diagonal of W", diagonal[:, 0, 0], ~(diagonal[:, 0, 0] > 0.0), "> 0")
        tangent = diagonal[:, 1, 1]
        _refuse("the tangential diagonal of W", tangent, (tangent < 0.0) & ~free, ">= 0")
        _refuse("the tangential diagonal of W", tangent, (tangent == 0.0) & (self.mu > 0.0), "> 0 where mu > 0")

    @classmethod
    def from_compressed(
        cls,
        data: Any,
        indices: Any,
        pointers: Any,
        q: Any,
        mu: Any,
        *,
        layout: Literal["columns", "rows", "triplets"] = "columns",
        bilateral: Any = None,
    ) -> DelassusProblem:
        """From the scalar entries of W, as sparse libraries keep them; entries given twice are added.

        Args:
            data: values, (k,).
            indices: row of each value ("columns", "triplets") or its column ("rows"), (k,).
            pointers: first value of each column or row and k, (2n + 1,); column of each value with "triplets", (k,).
            q: (2n,) or (n, 2) [m/s].
            mu: (n,).
            layout: which of these they are.
            bilateral: see the class.

        Raises:
            ValueError: naming what is wrong, see the class.
        """
        mu = np.asarray(mu)
        n = len(mu) if mu.ndim == 1 else 0
        size = 2 * n
        data = np.asarray(data)
        count = len(data) if data.ndim == 1 else 0
        data = check_values("data", data, (count,), np.dtype(np.float64))
        first = check_values("indices", indices, (count,), np.dtype(np.int64))
        _refuse("indices", first, (first < 0) | (first >= size), f"in [0, {size})")
        if layout == "triplets":
            second = check_values("pointers", pointers, (count,), np.dtype(np.int64))
            _refuse("pointers", second, (second < 0) | (second >= size), f"in [0, {size})")
        elif layout in ("columns", "rows"):
            ends = check_values("pointers", pointers, (size + 1,), np.dtype(np.int64))
            _refuse("pointers", ends, np.diff(ends, prepend=0) < 0, "ascending from 0 on")
            if ends[0] != 0 or ends[-1] != count:
                raise ValueError(f"pointers run from {ends[0]} to {ends[-1]}; they must run from 0 to {count}")
            second = np.repeat(np.arange(size), np.diff(ends))
        else:
            raise ValueError(f"layout is {layout!r}; it must be 'columns', 'rows' or 'triplets'")
        row, column = (second, first) if layout == "rows" else (first, second)
        start, blocks, values = assemble_blocks(n, row // 2, column // 2, row % 2, column % 2, data)
        given = np.asarray(q)
        if given.shape == (size,):
            given = given.reshape(n, 2)
        return cls(row_start=start, column=blocks, block=values, q=given, mu=mu, bilateral=bilateral)

    @classmethod
    def from_simulation(cls, sim: Simulation, world: int = 0) -> DelassusProblem:
        """The contacts and joints of a world between ``collide`` and ``advance`` (see ``delassus_world.problem``)."""
        from dc_kernels.delassus.world import problem

        return problem(sim, world)

    @property
    def count(self) -> int:
        """Contacts, bilateral rows included."""
        return len(self.mu)

    @functools.cached_property
    def row(self) -> np.ndarray:
        """Row of each block, (blocks,)."""
        return np.repeat(np.arange(self.count), np.diff(self.row_start))

    @functools.cached_property
    def diagonal(self) -> np.ndarray:
        """Blocks of the diagonal, (n, 2, 2) [1/kg]; 0 where none is given."""
        diagonal = np.zeros((self.count, 2, 2))
        own = self.row == self.column
        diagonal[self.row[own]] = self.block[own]
        return diagonal

    def product(self, impulses: Any) -> np.ndarray:
        """W r, (n, 2) [m/s]."""
        x = self.check_impulses("impulses", impulses)
        terms = np.einsum("kij,kj->ki", self.block, x[self.column])
        return np.stack([np.bincount(self.row, terms[:, i], self.count) for i in (0, 1)], axis=1)

    def velocity(self, impulses: Any) -> np.ndarray:
        """Velocities u = W r + q, (n, 2) [m/s]."""
        return self.product(impulses) + self.q

    def natural_map(self, impulses: Any) -> float:
        """Relative natural map, float64: |r - P(r_n - u_n - mu |u_t|, r_t - u_t)| / |q|, P the projection on the cones.

        Nothing here has units to be told apart: impulses [N s] and velocities [m/s] are subtracted as numbers, as the
        field does it. With q = 0 it is not relative: r = 0 is the solution, with map 0.
        """
        return self.natural_maps(impulses)[0]

    def scaled_map(self, impulses: Any) -> float:
        """The same with each impulse times its normal diagonal of W, which makes it the velocity it changes.

        It does not depend on units or on how heavy the bodies are: with W times 1e6 and r by 1e6 it stays.
        """
        return self.natural_maps(impulses)[1]

    def natural_maps(self, impulses: Any) -> tuple[float, float]:
        """Both."""
        x = self.check_impulses("impulses", impulses)
        u = self.velocity(x)
        scale = float(np.linalg.norm(self.q)) or 1.0
        given, scaled = (
            float(np.linalg.norm(natural_map(y, u, self.mu, self.bilateral))) / scale
            for y in (x, self.diagonal[:, :1, 0] * x)
        )
        return given, scaled

    def check_impulses(self, name: str, impulses: Any) -> np.ndarray:
        """Impulses as (n, 2) float64, from (n, 2) or (2n,).

        Raises:
            ValueError: for another shape, NaN or inf.
        """
        x = np.asarray(impulses)
        if x.shape == (2 * self.count,):
            x = x.reshape(-1, 2)
        return check_values(name, x, (self.count, 2), np.dtype(np.float64))

    def inside(self, impulses: np.ndarray) -> np.ndarray:
        """Impulses with the normal ones not negative and friction within its bounds, (n, 2)."""
        normal = np.where(self.bilateral, impulses[:, 0], np.maximum(impulses[:, 0], 0.0))
        limit = self.mu * np.where(self.bilateral, 0.0, normal)
        return np.stack([normal, np.clip(impulses[:, 1], -limit, limit)], axis=1)

    @functools.cached_property
    def units(self) -> tuple[float, float]:
        """Units of impulse and velocity in which the diagonal of W is about 1 and |q| = 1."""
        speed = float(np.linalg.norm(self.q)) or 1.0
        inverse_mass = float(np.exp(np.mean(np.log(self.diagonal[:, 0, 0])))) if self.count else 1.0
        return speed / inverse_mass, speed

    def packed(self, dtype: str, backend: str) -> Mapping[str, Any]:
        """Arrays of the kernels by name, in ``units``; made once."""
        cache: dict[tuple[str, str], Mapping[str, Any]] = self.__dict__.setdefault("_packed", {})
        if (dtype, backend) not in cache:
            cache[dtype, backend] = self._pack(np.dtype(dtype), backend)
        return cache[dtype, backend]

    def _pack(self, real: np.dtype, backend: str) -> Mapping[str, Any]:
        impulse, speed = self.units
        with np.errstate(divide="ignore"):
            scaled = self.diagonal * (impulse / speed)
            inverse = 1.0 / np.stack([scaled[:, 0, 0], scaled[:, 1, 1]], axis=1)
        inverse[:, 1] = np.where((self.mu > 0.0) & np.isfinite(inverse[:, 1]), inverse[:, 1], 0.0)
        vectors = {
            "block": self.block.reshape(-1, 4) * (impulse / speed),
            "q": self.q / speed,
            "inverse": inverse,
        }
        scalars = {"mu": self.mu, "low": np.where(self.bilateral, FREE, 0.0), "couple": scaled[:, 1, 0]}
        return {
            "scale": impulse / speed,
            "block_start": kernel_array(self.row_start, backend),
            "block_col": kernel_array(self.column, backend),
            **{name: kernel_vectors(np.ascontiguousarray(a, real), backend) for name, a in vectors.items()},
            **{name: kernel_array(np.ascontiguousarray(a, real), backend) for name, a in scalars.items()},
        }


def _refuse(name: str, values: np.ndarray, bad: np.ndarray, limit: str) -> None:
    """Raise ValueError for the first bad entry."""
    if bad.any():
        index = int(np.flatnonzero(bad)[0])
        raise ValueError(f"{name}[{index}] is {values[index]}; it must be {limit}")


def assemble_blocks(
    n: int, row: np.ndarray, column: np.ndarray, i: Any, j: Any, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries (i, j) of blocks (row, column), added up: row_start (n + 1,), column (blocks,), block (blocks, 2, 2)."""
    key = row.astype(np.int64) * max(n, 1) + column
    found, inverse = np.unique(key, return_inverse=True)
    flat = np.bincount(inverse * 4 + i * 2 + j, values, 4 * len(found))
    start = np.concatenate([[0], np.cumsum(np.bincount(found // max(n, 1), minlength=n))])
    return start, found % max(n, 1), flat.reshape(-1, 2, 2)


def natural_map(x: np.ndarray, u: np.ndarray, mu: np.ndarray, bilateral: np.ndarray) -> np.ndarray:
    """Impulses minus the projection of (r_n - u_n - mu |u_t|, r_t - u_t) on the friction cones, (n, 2)."""
    zn, zt = x[:, 0] - u[:, 0] - mu * np.abs(u[:, 1]), x[:, 1] - u[:, 1]
    size = np.abs(zt)
    inside, behind = (zn >= 0.0) & (size <= mu * zn), mu * size <= -zn
    edge = (zn + mu * size) / (1.0 + mu * mu)
    pn = np.where(bilateral | inside, zn, np.where(behind, 0.0, edge))
    pt = np.where(inside, zt, np.where(behind, 0.0, np.sign(zt) * mu * edge))
    return np.stack([x[:, 0] - pn, x[:, 1] - np.where(bilateral, 0.0, pt)], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class DelassusSolution:
    """What a solve found: of all it looked at, the impulses whose natural maps are least."""

    impulses: np.ndarray
    """(n, 2) [N s]."""
    residual: float
    """Relative natural map (``DelassusProblem.natural_map``)."""
    scaled_residual: float
    """The same, scaled (``DelassusProblem.scaled_map``)."""
    converged: bool
    """Whether the residuals that were asked for are within the tolerance."""
    sweeps: int
    """Sweeps, those before and beside Newton's method included."""
    pivotings: int
    """Problems, whole or patches of at most 80 contacts, solved by Lemke's pivots."""
    factorizations: int
    """LU factorisations of Newton's method."""
    history: np.ndarray
    """At each look: sweeps so far, relative natural map, scaled one, (looks, 3)."""


def solve(
    problem: DelassusProblem,
    method: Method = "auto",
    *,
    tolerance: float = 1e-8,
    max_sweeps: int = 100_000,
    start: Any = None,
    scaled: bool = True,
    every: int = 5,
    omega: float = 1.4,
    dtype: Literal["float32", "float64"] = "float64",
    backend: str = "warp",
) -> DelassusSolution:
    """Solve until both natural maps are within the tolerance; one launch for each first-order solve.

    Args:
        problem: what to solve.
        method: "pgs" projected Gauss-Seidel in the order of the contacts, normal before friction; "sor" the same,
            over-relaxed; "aitken" extrapolation with back-off; "nncg" (Silcowitz et al. 2010); "anderson" with
            back-off; "hybrid" momentum, and Aitken where it does not help; "newton" from 60 sweeps on; "auto" sweeps,
            Lemke's pivots where they stall, and Newton where that fails too (not without SciPy).
        tolerance: of the relative natural maps [1].
        max_sweeps: sweeps at most, all phases together.
        start: impulses (n, 2) [N s]; None: zero.
        scaled: False: the natural map as the field has it decides alone, whatever the units.
        every: sweeps between two looks at the natural maps, each of which costs half a sweep.
        omega: relaxation of "sor", in (0, 2).
        dtype: of the sweeps; Newton's method and what is reported are float64.
        backend: "warp", or "numpy": the oracle.

    Raises:
        ValueError: for an argument out of its range, naming it.
        ImportError: "newton" without SciPy.
    """
    if method not in METHODS and method not in ("auto", "newton"):
        raise ValueError(f"method is {method!r}; it must be one of {('auto', *METHODS, 'newton')}")
    if not 0.0 < tolerance < float("inf"):
        raise ValueError(f"tolerance is {tolerance!r}; it must be finite and > 0")
    for name, value, low in (("max_sweeps", max_sweeps, 0), ("every", every, 1)):
        if not low <= value < 2**31:
            raise ValueError(f"{name} is {value!r}; it must lie in [{low}, 2^31)")
    if not 0.0 < omega < 2.0:
        raise ValueError(f"omega is {omega!r}; it must lie in (0, 2)")
    if dtype not in FLOATS:
        raise ValueError(f"dtype is {dtype!r}; it must be one of {tuple(FLOATS)}")
    check_backend(backend)
    first = np.zeros((problem.count, 2)) if start is None else problem.check_impulses("start", start)
    from dc_kernels.delassus.search import Search

    search = Search(problem, first, tolerance, scaled, max_sweeps, every, omega, dtype, backend)
    if method in METHODS:
        search.sweep(method, max_sweeps)
    else:
        from dc_kernels.delassus.newton import search_automatically

        search_automatically(search, newton_only=method == "newton")
    return search.solution()


def warmup(dtype: Literal["float32", "float64"] = "float64") -> None:
    """Load all that a solve needs, which the first one would do otherwise (seconds, if nothing is compiled yet)."""
    block = np.eye(2)[None]
    one = DelassusProblem(row_start=[0, 1], column=[0], block=block, q=[[-1.0, 0.5]], mu=[0.3])  # type: ignore[arg-type]
    solve(one, "aitken", dtype=dtype)
    with contextlib.suppress(ImportError):  # "auto" does without
        require("scipy.sparse.linalg", "pipeline")
