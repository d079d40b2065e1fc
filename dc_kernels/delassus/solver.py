"""Solvers of Delassus problems, by name of the method."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from dc_kernels.delassus.newton import search_automatically
from dc_kernels.delassus.problem import DelassusProblem
from dc_kernels.delassus.search import METHODS, DelassusSolution, Dtype, Method, Search, SolveOptions
from dc_kernels.model.settings import checker
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.imports import require

_problem = checker(DelassusProblem)


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
    dtype: Dtype = "float64",
    backend: str = "warp",
) -> DelassusSolution:
    """Solve until the relative natural maps are within the tolerance; a first-order solve is one launch.

    Args:
        problem: the problem.
        method: "pgs" projected Gauss-Seidel in the order of the contacts, normal before friction; "sor" over-relaxed
            Gauss-Seidel; "aitken" extrapolation with back-off; "nncg" nonlinear conjugate gradients (Silcowitz et al.
            2010); "anderson" Anderson's acceleration with back-off; "hybrid" momentum, and Aitken if that does not
            help; "newton" 60 sweeps, then Newton's method; "auto" sweeps, Lemke's pivoting if they stall, and Newton
            if that fails too (with SciPy).
        tolerance: tolerance of the relative natural maps [1].
        max_sweeps: largest number of sweeps, of all phases together.
        start: impulses (n, 2) [N s]; None: zero.
        scaled: whether ``scaled_map`` must be within the tolerance too; False: ``natural_map`` alone decides.
        every: number of sweeps between two checks of the natural maps, each of which costs half a sweep.
        omega: relaxation of "sor", in (0, 2).
        dtype: scalar type of the sweeps; Newton's method and the reported errors use float64.
        backend: "warp", or "numpy": the oracle.

    Raises:
        ValueError: for an argument out of its range, naming it.
        ImportError: for "newton" without SciPy.
    """
    refuse_recording("a solve in Delassus form", "the host reads what the kernels leave")
    _problem("problem", problem)
    options = SolveOptions(
        method=method,
        tolerance=tolerance,
        max_sweeps=max_sweeps,
        scaled=scaled,
        every=every,
        omega=omega,
        dtype=dtype,
        backend=backend,  # type: ignore[arg-type]
    )
    first = np.zeros((problem.count, 2)) if start is None else problem.check_impulses("start", start)
    search = Search(problem, first, options)
    if options.method in METHODS:
        search.sweep(options.method, options.max_sweeps)
    else:
        search_automatically(search, newton_only=options.method == "newton")
    return search.solution()


def warmup(dtype: Dtype = "float64") -> None:
    """Load everything that a solve needs, instead of in the first solve (seconds, if nothing is compiled yet)."""
    block = np.eye(2)[None]
    one = DelassusProblem(row_start=[0, 1], column=[0], block=block, q=[[-1.0, 0.5]], mu=[0.3])  # type: ignore[arg-type]
    solve(one, "aitken", dtype=dtype)
    with contextlib.suppress(ImportError):  # "auto" does without
        require("scipy.sparse.linalg", "pipeline")
