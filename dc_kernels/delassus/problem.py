"""Frictional contact problems in Delassus form, u = W r + q, as other simulators exchange them (FCLIB).

Contact c owns rows 2c (normal) and 2c + 1 (tangent) of u, q and r: u_n >= 0 where r_n = 0, u_n = 0 where r_n > 0, and
Coulomb's law |r_t| <= mu r_n, against u_t. W is kept in rows of 2x2 blocks. It may be singular, and unsymmetric by
round-off: no solver here needs more than its diagonal to be positive.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dc_kernels.delassus.groups import PackedProblem
from dc_kernels.model.checks import check_values
from dc_kernels.model.rules import refuse
from dc_kernels.model.settings import numeric
from dc_kernels.model.validate.arrays import check_start
from dc_kernels.runtime.interop import host_view

FREE = -3e38  # least normal impulse of a row without bound; finite in float32


@dataclass(frozen=True, kw_only=True, eq=False)
class DelassusProblem:
    """A problem of n contacts, checked once; float64, in read-only copies of the arrays given: it never changes."""

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
        mu = numeric("mu", self.mu)
        n = len(mu) if mu.ndim == 1 else 0
        float64, int32 = np.dtype(np.float64), np.dtype(np.int32)
        column = numeric("column", self.column)
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
        if self.slot is not None:
            arrays["slot"] = np.asarray(self.slot)
        for name, value in arrays.items():
            own = value.copy()
            own.flags.writeable = False
            object.__setattr__(self, name, own)
        refuse("mu", self.mu, self.mu < 0.0, "not negative")
        refuse("mu", self.mu, free & (self.mu != 0.0), "0 where bilateral")
        start = self.row_start
        check_start("row_start", start, blocks)
        refuse("column", self.column, (self.column < 0) | (self.column >= n), f"in [0, {n})")
        row = self.row
        place = row * np.int64(max(n, 1)) + self.column
        twice = np.zeros(blocks, bool)
        if not (place[1:] > place[:-1]).all():  # in order none is; to sort them takes longer than all other checks
            order = np.argsort(place, kind="stable")
            twice[order[1:]] = place[order[1:]] == place[order[:-1]]
        if twice.any():
            k = int(np.flatnonzero(twice)[0])
            raise ValueError(f"column[{k}] is {self.column[k]} once more in row {row[k]}; a block is given once")
        diagonal = self.diagonal
        refuse("the normal diagonal of W", diagonal[:, 0, 0], ~(diagonal[:, 0, 0] > 0.0), "> 0")
        tangent = diagonal[:, 1, 1]
        refuse("the tangential diagonal of W", tangent, (tangent < 0.0) & ~free, ">= 0")
        refuse("the tangential diagonal of W", tangent, (tangent == 0.0) & (self.mu > 0.0), "> 0 where mu > 0")

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
        """Make a problem from the scalar entries of W, as sparse libraries keep them; entries given twice are added.

        Args:
            data: values, (k,).
            indices: row of each value ("columns", "triplets") or its column ("rows"), (k,).
            pointers: first value of each column or row and k, (2n + 1,); column of each value with "triplets", (k,).
            q: (2n,) or (n, 2) [m/s].
            mu: (n,).
            layout: whether ``data`` lies column by column, row by row, or in any order.
            bilateral: rows without bound and friction, (n,) bool; None: none are.

        Raises:
            ValueError: naming array and index, as the class does, or for an unknown layout.
        """
        mu = np.asarray(mu)
        n = len(mu) if mu.ndim == 1 else 0
        size = 2 * n
        data = np.asarray(data)
        count = len(data) if data.ndim == 1 else 0
        data = check_values("data", data, (count,), np.dtype(np.float64))
        first = check_values("indices", indices, (count,), np.dtype(np.int64))
        refuse("indices", first, (first < 0) | (first >= size), f"in [0, {size})")
        if layout == "triplets":
            second = check_values("pointers", pointers, (count,), np.dtype(np.int64))
            refuse("pointers", second, (second < 0) | (second >= size), f"in [0, {size})")
        elif layout in ("columns", "rows"):
            ends = check_values("pointers", pointers, (size + 1,), np.dtype(np.int64))
            check_start("pointers", ends, count)
            second = np.repeat(np.arange(size), np.diff(ends))
        else:
            raise ValueError(f"layout is {layout!r}; it must be 'columns', 'rows' or 'triplets'")
        row, column = (second, first) if layout == "rows" else (first, second)
        start, blocks, values = assemble_blocks(n, row // 2, column // 2, row % 2, column % 2, data)
        given = np.asarray(q)
        if given.shape == (size,):
            given = given.reshape(n, 2)
        return cls(row_start=start, column=blocks, block=values, q=given, mu=mu, bilateral=bilateral)

    @property
    def count(self) -> int:
        """Number of contacts, bilateral rows included."""
        return len(self.mu)

    @functools.cached_property
    def row(self) -> np.ndarray:
        """Contact whose velocity each block is part of, (blocks,)."""
        return np.repeat(np.arange(self.count), np.diff(self.row_start))

    @functools.cached_property
    def diagonal(self) -> np.ndarray:
        """The blocks of the diagonal of W, (n, 2, 2) [1/kg]; 0 where none is given."""
        diagonal = np.zeros((self.count, 2, 2))
        own = self.row == self.column
        diagonal[self.row[own]] = self.block[own]
        return diagonal

    def product(self, impulses: Any) -> np.ndarray:
        """Multiply W by impulses: W r, (n, 2) [m/s]."""
        return self._product(self.check_impulses("impulses", impulses))

    def _product(self, x: np.ndarray) -> np.ndarray:
        terms = np.einsum("kij,kj->ki", self.block, x[self.column])
        product = np.empty((self.count, 2))
        for i in (0, 1):
            product[:, i] = np.bincount(self.row, terms[:, i], self.count)
        return product

    def velocity(self, impulses: Any) -> np.ndarray:
        """Compute the velocities u = W r + q, (n, 2) [m/s]."""
        return self.product(impulses) + self.q

    def natural_map(self, impulses: Any) -> float:
        """Measure the error |r - P(r_n - u_n - mu |u_t|, r_t - u_t)| / |q|, where P projects on the friction cones.

        Problems in FCLIB's form (Acary et al. 2014) are judged by it. It depends on units: impulses [N s] and
        velocities [m/s] are subtracted as numbers. With q = 0 it is not divided; r = 0 is the solution then.
        """
        return self.natural_maps(impulses)[0]

    def scaled_map(self, impulses: Any) -> float:
        """Measure the natural map with each impulse multiplied by its normal diagonal of W, the velocity it makes.

        It does not depend on units or on the mass of the bodies: W times 1e6 and r over 1e6 give the same value.
        """
        return self.natural_maps(impulses)[1]

    def natural_maps(self, impulses: Any) -> tuple[float, float]:
        """Measure both errors: ``natural_map`` and ``scaled_map``."""
        x = self.check_impulses("impulses", impulses)
        both = np.stack([x, self.diagonal[:, :1, 0] * x])
        errors = natural_map(both, self._product(x) + self.q, self.mu, self.bilateral)
        scale = self.units[1]
        return float(np.linalg.norm(errors[0])) / scale, float(np.linalg.norm(errors[1])) / scale

    def check_impulses(self, name: str, impulses: Any) -> np.ndarray:
        """Return impulses given as (n, 2) or (2n,) as (n, 2) float64.

        Raises:
            ValueError: for another shape, NaN or inf.
        """
        x = numeric(name, host_view(name, impulses))
        if x.shape == (2 * self.count,):
            x = x.reshape(-1, 2)
        return check_values(name, x, (self.count, 2), np.dtype(np.float64))

    def inside(self, impulses: np.ndarray) -> np.ndarray:
        """Clamp impulses (n, 2): normal ones not negative, then friction within +-mu times them."""
        normal = np.where(self.bilateral, impulses[:, 0], np.maximum(impulses[:, 0], 0.0))
        limit = self.mu * np.where(self.bilateral, 0.0, normal)
        return np.stack([normal, np.clip(impulses[:, 1], -limit, limit)], axis=1)

    @functools.cached_property
    def units(self) -> tuple[float, float]:
        """Units of impulse and velocity in which the diagonal of W is about 1 and |q| = 1."""
        speed = float(np.linalg.norm(self.q)) or 1.0
        inverse_mass = float(np.exp(np.mean(np.log(self.diagonal[:, 0, 0])))) if self.count else 1.0
        return speed / inverse_mass, speed

    def packed(self, dtype: str, backend: str) -> PackedProblem:
        """Return the arrays that kernels take, in ``units``; they are made once."""
        cache: dict[tuple[str, str], PackedProblem] = self.__dict__.setdefault("_packed", {})
        if (dtype, backend) not in cache:
            cache[dtype, backend] = self._pack(dtype, backend)
        return cache[dtype, backend]

    def _pack(self, dtype: str, backend: str) -> PackedProblem:
        impulse, speed = self.units
        with np.errstate(divide="ignore"):
            scaled = self.diagonal * (impulse / speed)
            inverse = 1.0 / np.stack([scaled[:, 0, 0], scaled[:, 1, 1]], axis=1)
        inverse[:, 1] = np.where((self.mu > 0.0) & np.isfinite(inverse[:, 1]), inverse[:, 1], 0.0)
        sizes = {"contact": self.count, "contact+1": self.count + 1, "block": len(self.column)}
        packed = PackedProblem(sizes, dtype, backend=backend)
        packed.scale = impulse / speed
        for name, values in {
            "row_start": self.row_start,
            "column": self.column,
            "block": self.block.reshape(-1, 4) * (impulse / speed),
            "q": self.q / speed,
            "mu": self.mu,
            "low": np.where(self.bilateral, FREE, 0.0),
            "inverse": inverse,
            "couple": scaled[:, 1, 0],
        }.items():
            packed.numpy(name)[...] = values
        return packed


def assemble_blocks(
    n: int, row: np.ndarray, column: np.ndarray, i: Any, j: Any, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add up entries (i, j) of blocks (row, column) of W.

    Args:
        n: contacts.
        row: of the blocks, (p,).
        column: of the blocks, (p,).
        i: rows of the entries within their blocks; with j of the shape of ``values``, or to be broadcast to it.
        j: columns of the entries within their blocks.
        values: of the entries, (p,), or of whole blocks, (p, 2, 2).

    Returns:
        row_start (n + 1,), column (blocks,) and block (blocks, 2, 2) of a ``DelassusProblem``.
    """
    key = row.astype(np.int64) * max(n, 1) + column
    found, inverse = np.unique(key, return_inverse=True)
    place = inverse.reshape(-1, *(1,) * (values.ndim - 1)) * 4 + i * 2 + j
    flat = np.bincount(place.ravel(), values.ravel(), 4 * len(found))
    start = np.concatenate([[0], np.cumsum(np.bincount(found // max(n, 1), minlength=n))])
    return start, found % max(n, 1), flat.reshape(-1, 2, 2)


def natural_map(x: np.ndarray, u: np.ndarray, mu: np.ndarray, bilateral: np.ndarray) -> np.ndarray:
    """Return impulses minus the projection of (r_n - u_n - mu |u_t|, r_t - u_t) on the friction cones.

    What a solve reports is measured by this function, in float64 and apart from the kernels, whose law it checks.

    Args:
        x: impulses (..., n, 2).
        u: velocities (n, 2).
        mu: Coulomb coefficients (n,).
        bilateral: rows whose normal impulse has no bound, and which have no friction, (n,) bool.

    Returns:
        Shape of ``x``.
    """
    zn, zt = x[..., 0] - u[:, 0] - mu * np.abs(u[:, 1]), x[..., 1] - u[:, 1]
    size = np.abs(zt)
    inside, behind = (zn >= 0.0) & (size <= mu * zn), mu * size <= -zn
    edge = (zn + mu * size) / (1.0 + mu * mu)
    pn = np.where(bilateral | inside, zn, np.where(behind, 0.0, edge))
    pt = np.where(inside, zt, np.where(behind, 0.0, np.sign(zt) * mu * edge))
    return x - np.stack([pn, np.where(bilateral, 0.0, pt)], axis=-1)
