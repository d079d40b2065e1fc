"""Frictional contact problems in FCLIB's HDF5 layout: what other people's solvers read and write.

Layout (Acary, Bremond, Koziara, Perignon: FCLIB, Inria RT-444, 2014), the 2D local problem
u = W r + V l + q, V^T r + R l + s = 0 with Coulomb's law; normals come first:

- ``fclib_local/spacedim``: 2;
- ``fclib_local/W``, and with equations ``V``, ``R``: ``m``, ``n``, ``nzmax``, ``nz``, ``p``, ``i``, ``x``; nz is -1 in
  compressed columns, -2 in compressed rows, the number of entries in triplets (rows ``p``, columns ``i``);
- ``fclib_local/vectors/q``, ``mu``, and ``s``; ``fclib_local/info/title``, ``description``, ``math_info``;
- ``solution/r``, ``u``, and ``l``; ``guesses/number_of_guesses``, ``guesses/1/r``, ...

Scalars are written as FCLIB writes them, arrays of one element; true scalars are read too. Equations become bilateral
rows behind the contacts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.delassus import DelassusProblem, assemble_blocks
from dc_kernels.model.rules import FINITE, NOT_NEGATIVE, POSITIVE, BrokenRule, Number
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.hdf5 import image, reading
from dc_kernels.runtime.imports import require
from pipeline.files import write_bytes

ROOT = "fclib_local"
INFO = ("title", "description", "math_info")
LAYOUTS = {-1: "columns", -2: "rows"}


@dataclass(frozen=True, kw_only=True, eq=False)
class FclibProblem:
    """A contact problem, and what else a file holds."""

    problem: DelassusProblem
    """The problem: first its contacts, then equations as bilateral rows."""
    info: Mapping[str, str] = field(default_factory=dict)
    """Those of title, description and math_info that there are."""
    attributes: Mapping[str, str] = field(default_factory=dict)
    """Attributes of the file that are text."""
    solution: np.ndarray | None = None
    """Impulses that solve it, (n, 2) [N s]; equations have theirs in the first column."""
    guesses: Sequence[np.ndarray] = ()
    """Start impulses, (n, 2) [N s] each."""


class _Reader:
    """Reads datasets of an open file; an error names the file and the dataset.

    FCLIB's integers come in any width, its matrices in three layouts, and nothing has worlds: the checks of shapes and
    layouts are its own. Values are held to the rules of the field tables, with which a contact of ours agrees.
    """

    def __init__(self, path: Path, file: Any) -> None:
        self.path, self.file = path, file

    def fail(self, name: str, text: str) -> ValueError:
        """Make an error that names the file and a dataset."""
        return ValueError(f"{self.path}: {name} {text}")

    def array(self, name: str, kinds: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Read a dataset of these kinds of dtype and this shape, in which None stands for any length."""
        h5py = require("h5py", "pipeline")
        data = self.file.get(name)
        if not isinstance(data, h5py.Dataset):
            raise self.fail(name, "is missing")
        if data.dtype.kind not in kinds:
            raise self.fail(name, f"has dtype {data.dtype}; it must be of {'integers' if kinds == 'iu' else 'numbers'}")
        if len(data.shape) != len(shape) or any(want not in (None, have) for have, want in zip(data.shape, shape)):
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise self.fail(name, f"has shape {data.shape}; it must be ({wanted}{',' * (len(shape) == 1)})")
        try:
            return data[...]
        except OSError as error:
            raise self.fail(name, f"cannot be read: the file is damaged or cut short ({error})") from None

    def hold(self, name: str, values: np.ndarray, rule: Number = FINITE) -> np.ndarray:
        """Return values that keep to a rule."""
        try:
            check_rule(name, values, rule)
        except BrokenRule as error:
            raise self.fail(error.place, error.text) from None
        return values

    def vector(self, name: str, length: int, rule: Number = FINITE) -> np.ndarray:
        """Read numbers that keep to a rule, (length,) float64."""
        return self.hold(name, self.array(name, "fiu", (length,)).astype(np.float64), rule)

    def integer(self, name: str) -> int:
        """Read an integer, which is a scalar or an array of one element."""
        data = self.file.get(name)
        return int(self.array(name, "iu", (1,) if getattr(data, "shape", None) == (1,) else ()).ravel()[0])

    def matrix(self, name: str, shape: tuple[int | None, int | None]) -> tuple[tuple[int, int], np.ndarray, Any, Any]:
        """Read a matrix; returns its shape, and rows, columns and values of its entries."""
        size = (self.integer(f"{name}/m"), self.integer(f"{name}/n"))
        for what, have, want in zip("mn", size, shape, strict=True):
            if have < 0 or want not in (None, have):
                raise self.fail(f"{name}/{what}", f"is {have}; it must be {'>= 0' if want is None else want}")
        nz = self.integer(f"{name}/nz")
        if nz < -2:
            raise self.fail(f"{name}/nz", f"is {nz}; it must be -1 (columns), -2 (rows) or a number of entries")
        values = self.array(f"{name}/x", "fiu", (None,)).astype(np.float64)
        index = self.array(f"{name}/i", "iu", (None,)).astype(np.int64)
        if nz >= 0:
            first, count, limits = self.array(f"{name}/p", "iu", (None,)).astype(np.int64), nz, size
            if len(first) < count:
                raise self.fail(f"{name}/p", f"has {len(first)} entries; nz is {nz}")
        else:
            along, limits = (size[1], size) if nz == -1 else (size[0], size[::-1])
            pointer = self.array(f"{name}/p", "iu", (along + 1,)).astype(np.int64)
            falls = np.flatnonzero(np.diff(pointer, prepend=0) < 0)
            if len(falls) or pointer[0] != 0:
                k = int(falls[0]) if len(falls) else 0
                raise self.fail(f"{name}/p[{k}]", f"is {pointer[k]}; it must be ascending from 0 on")
            count = int(pointer[-1])
        for what, array in (("i", index), ("x", values)):
            if len(array) < count:
                raise self.fail(f"{name}/{what}", f"has {len(array)} entries; it must have {count}")
        if nz < 0:  # not before it is known that there are so many
            first = np.repeat(np.arange(along), np.diff(pointer))
        index, values, first = index[:count], values[:count], first[:count]
        # compressed: i runs across the pointers' axis; triplets: p are rows and i columns
        rows, columns = (first, index) if nz != -1 else (index, first)
        for what, array, limit in (
            ("i", index, limits[1 if nz >= 0 else 0]),
            ("p", first, limits[0 if nz >= 0 else 1]),
        ):
            self.hold(f"{name}/{what}", array, Number(0, limit - 1))
        return size, rows, columns, self.hold(f"{name}/x", values)

    def text(self, name: str) -> str | None:
        """Read a string; None where there is none."""
        data = self.file.get(name)
        value = data[()] if hasattr(data, "shape") and data.shape == () else None
        if isinstance(value, bytes):
            return value.rstrip(b"\0").decode("utf-8", errors="replace")
        return value if isinstance(value, str) else None


def read_fclib(path: Path) -> FclibProblem:
    """Read a 2D local problem.

    Raises:
        ValueError: naming file, dataset and limit: not HDF5 or cut short, another kind of problem or dimension, a field
            that is missing, of a wrong size or out of range.
        OSError: the file is not there or cannot be opened.
    """
    with reading(path) as file:
        return _read(_Reader(path, file))


def _read(reader: _Reader) -> FclibProblem:
    """Read the problem of an open file."""
    file = reader.file
    if ROOT not in file:
        other = [name for name in ("fclib_global", "fclib_global_rolling") if name in file]
        held = f"it holds {other[0]}" if other else f"it holds {', '.join(list(file)[:5]) or 'nothing'}"
        raise reader.fail(ROOT, f"is missing: this is no local problem of FCLIB; {held}")
    dimension = reader.integer(f"{ROOT}/spacedim")
    if dimension != 2:
        raise reader.fail(f"{ROOT}/spacedim", f"is {dimension}; it must be 2")
    size, rows, columns, values = reader.matrix(f"{ROOT}/W", (None, None))
    if size[0] != size[1] or size[0] % 2:
        raise reader.fail(f"{ROOT}/W", f"is {size[0]} x {size[1]}; it must be square, of 2 rows a contact")
    n = size[0] // 2
    q = reader.vector(f"{ROOT}/vectors/q", 2 * n)
    mu = reader.vector(f"{ROOT}/vectors/mu", n, NOT_NEGATIVE)
    equations = 0
    if f"{ROOT}/V" in file or f"{ROOT}/R" in file:
        (_, equations), v_rows, v_columns, v_values = reader.matrix(f"{ROOT}/V", (2 * n, None))
        _, r_rows, r_columns, r_values = reader.matrix(f"{ROOT}/R", (equations, equations))
        s = reader.vector(f"{ROOT}/vectors/s", equations)
        own = np.bincount(r_rows[r_rows == r_columns], r_values[r_rows == r_columns], equations)
        reader.hold(f"the diagonal of {ROOT}/R", own, POSITIVE)
        at = 2 * n + 2 * np.arange(equations)
        rows = np.concatenate([rows, v_rows, at[v_columns], at[r_rows]])
        columns = np.concatenate([columns, at[v_columns], v_rows, at[r_columns]])
        values = np.concatenate([values, v_values, v_values, r_values])
        q = np.concatenate([q, np.stack([s, np.zeros(equations)], axis=1).ravel()])
        mu = np.concatenate([mu, np.zeros(equations)])
    start, column, block = assemble_blocks(n + equations, rows // 2, columns // 2, rows % 2, columns % 2, values)
    bilateral = np.arange(n + equations) >= n
    try:
        problem = DelassusProblem(
            row_start=start, column=column, block=block, q=q.reshape(-1, 2), mu=mu, bilateral=bilateral
        )
    except ValueError as error:
        raise ValueError(f"{reader.path}: {ROOT}: {error}") from None

    def impulses(group: str) -> np.ndarray:
        found = np.zeros((n + equations, 2))
        found[:n] = reader.vector(f"{group}/r", 2 * n).reshape(-1, 2)
        if equations:
            found[n:, 0] = reader.vector(f"{group}/l", equations)
        return found

    guesses = reader.integer("guesses/number_of_guesses") if "guesses/number_of_guesses" in file else 0
    texts = {name: reader.text(f"{ROOT}/info/{name}") for name in INFO}
    return FclibProblem(
        problem=problem,
        info={name: text for name, text in texts.items() if text is not None},
        attributes={name: value for name, value in file.attrs.items() if isinstance(value, str)},
        solution=impulses("solution") if "solution" in file else None,
        guesses=[impulses(f"guesses/{k + 1}") for k in range(guesses)],
    )


def write_fclib(path: Path, content: FclibProblem) -> None:
    """Write a problem, in one go; W in compressed columns, with the zeros of its blocks.

    Raises:
        ValueError: bilateral rows that do not stand behind the contacts, or impulses of a wrong shape.
    """
    problem = content.problem
    n = int((~problem.bilateral).sum())
    equations = problem.count - n
    if problem.bilateral[:n].any():
        raise ValueError(f"bilateral[{int(np.argmax(problem.bilateral))}] is True; bilateral rows stand last")
    for name, given in (("solution", content.solution), *((f"guesses[{k}]", g) for k, g in enumerate(content.guesses))):
        if given is not None:
            problem.check_impulses(name, given)
    rows = (2 * problem.row[:, None, None] + np.array([[0, 0], [1, 1]])).ravel()
    columns = (2 * problem.column[:, None, None] + np.array([[0, 1], [0, 1]])).ravel()
    values = problem.block.ravel()
    # a bilateral row is its even line; the odd one has no meaning
    low, high = 2 * n, 2 * problem.count
    kept = ((rows < low) | (rows % 2 == 0)) & ((columns < low) | (columns % 2 == 0))

    def part(file: Any, name: str, first: tuple[int, int], last: tuple[int, int]) -> None:
        k = kept & (rows >= first[0]) & (rows < last[0]) & (columns >= first[1]) & (columns < last[1])
        row = rows[k] if last[0] <= low else (rows[k] - low) // 2
        column = columns[k] if last[1] <= low else (columns[k] - low) // 2
        shape = tuple(b - a if b <= low else (b - a) // 2 for a, b in zip(first, last, strict=True))
        _write_matrix(file, f"{ROOT}/{name}", shape, row, column, values[k])

    def fill(file: Any) -> None:
        file.attrs.update(content.attributes)
        file[f"{ROOT}/spacedim"] = np.array([2], np.int32)
        part(file, "W", (0, 0), (low, low))
        file[f"{ROOT}/vectors/q"] = problem.q[:n].ravel()
        file[f"{ROOT}/vectors/mu"] = problem.mu[:n]
        if equations:
            part(file, "V", (0, low), (low, high))
            part(file, "R", (low, low), (high, high))
            file[f"{ROOT}/vectors/s"] = problem.q[n:, 0]
        for name in INFO:
            if name in content.info:
                data = content.info[name].encode() + b"\0"  # as a C string
                file[f"{ROOT}/info/{name}"] = np.array(data, dtype=f"S{len(data)}")

        def impulses(group: str, r: np.ndarray) -> None:
            file[f"{group}/r"] = np.asarray(r, np.float64)[:n].ravel()
            file[f"{group}/u"] = problem.velocity(r)[:n].ravel()
            if equations:
                file[f"{group}/l"] = np.asarray(r, np.float64)[n:, 0]

        if content.solution is not None:
            impulses("solution", content.solution)
        if content.guesses:
            file["guesses/number_of_guesses"] = np.array([len(content.guesses)], np.int32)
            for k, guess in enumerate(content.guesses):
                impulses(f"guesses/{k + 1}", guess)

    write_bytes(path, image(fill))


def _write_matrix(
    file: Any, name: str, shape: tuple[int, ...], rows: np.ndarray, columns: np.ndarray, values: np.ndarray
) -> None:
    """Write a matrix in compressed columns."""
    order = np.lexsort((rows, columns))
    pointer = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=shape[1]))])
    for what, number in (("nzmax", len(values)), ("m", shape[0]), ("n", shape[1]), ("nz", -1)):
        file[f"{name}/{what}"] = np.array([number], np.int32)
    file[f"{name}/p"] = pointer.astype(np.int32)
    file[f"{name}/i"] = rows[order].astype(np.int32)
    file[f"{name}/x"] = values[order]


def problem_files(path: Path) -> list[Path]:
    """Return the file, or the .hdf5 and .h5 files of a folder by name.

    Raises:
        ValueError: where there is none.
    """
    if not path.is_dir():
        if not path.exists():
            raise ValueError(f"{path}: there is no such file or folder")
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix in (".hdf5", ".h5") and not file.name.startswith("."))
    if not found:
        raise ValueError(f"{path}: there is no .hdf5 or .h5 file in this folder")
    return found
