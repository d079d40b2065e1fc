"""Scenes with a verdict: what is checked, the value, its limit; a table of them, a picture of each that fails.

A case is a function ``case(quick) -> Iterator[Check]``, registered by ``Cases.add``; its docstring gives the formula
and its source. Tests run the same cases with ``quick=True``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dc_kernels as dc
from bench import timing


@dataclass(frozen=True)
class Check:
    """A criterion, which passes where ``value <= limit`` (NaN fails)."""

    criterion: str
    """Says what is held small, with its unit."""
    value: float
    limit: float
    sim: dc.Simulation | None = None
    """Is drawn where the check fails."""

    @property
    def passed(self) -> bool:
        """Tell whether the value lies within its limit."""
        return math.isfinite(self.value) and self.value <= self.limit

    def __str__(self) -> str:
        verdict = "passed" if self.passed else "FAILED"
        return (
            f"{self.criterion}: {timing.number(float(self.value))}, limit {timing.number(float(self.limit))}, {verdict}"
        )


Case = Callable[[bool], Iterator[Check]]


class Cases:
    """Cases by name, in the order in which they were added."""

    def __init__(self) -> None:
        self.all: dict[str, Case] = {}
        self.slow: set[str] = set()

    def add(self, case: Case) -> Case:
        """Register a case under the name of its function; with ``quick`` it checks all that it says too, but shorter.

        Raises:
            ValueError: for a name that is taken, or a case without docstring.
        """
        name = case.__name__
        if name in self.all or not case.__doc__:
            raise ValueError(f"case {name!r} is there already or says nothing of its formula and source")
        self.all[name] = case
        return case

    def add_slow(self, case: Case) -> Case:
        """Register a case that has no quick form: it runs in the full bench only."""
        self.slow.add(case.__name__)
        return self.add(case)

    def names(self, quick: bool) -> list[str]:
        """Return the names of the cases of a quick or a full run."""
        return [name for name in self.all if not (quick and name in self.slow)]


def judge(cases: Cases, quick: bool, pictures: Path) -> dict[str, Any]:
    """Run all cases; a case that raises has failed.

    Args:
        cases: which ones.
        quick: their short form.
        pictures: folder of the pictures of failed checks, made when there is one.

    Returns:
        ``count``, ``failed`` (how many cases), ``failures`` (their names), and ``rows``: case, criterion, value, limit,
        verdict, seconds of the case.
    """
    from tqdm import tqdm

    rows: list[dict[str, Any]] = []
    failures = []
    for name in (bar := tqdm(cases.names(quick), unit="case", dynamic_ncols=True)):
        bar.set_postfix_str(name)
        begin, passed = time.perf_counter(), True
        checks = []
        try:
            for check in cases.all[name](quick):
                checks.append((check.criterion, float(check.value), float(check.limit), check.passed))
                if not check.passed:
                    passed = False
                    picture(check, pictures / f"{name}_{len(checks)}.png")
        except Exception as error:  # one broken scene must not hide the verdicts of the others
            checks.append((f"{type(error).__name__}: {error}", math.nan, 0.0, False))
            passed = False
        seconds = time.perf_counter() - begin
        for criterion, value, limit, good in checks:
            rows.append(
                {"case": name, "criterion": criterion, "value": value if math.isfinite(value) else None}
                | {"limit": limit, "passed": good, "seconds": round(seconds, 2)}
            )
        if not passed or not checks:
            failures.append(name)
    return {"count": len(cases.names(quick)), "failed": len(failures), "failures": failures, "rows": rows}


def picture(check: Check, path: Path) -> None:
    """Draw the scene of a failed check, where it has one."""
    if check.sim is None:
        return
    from pipeline.plots import style
    from pipeline.plots.world import draw_world

    path.parent.mkdir(parents=True, exist_ok=True)
    with style.figure(7.0, 6.0) as figure:
        axes = figure.subplots()
        draw_world(axes, check.sim)
        axes.set_title(str(check), fontsize=8)
        style.save_figure(figure, path)


def table(rows: list[dict[str, Any]]) -> str:
    """Write case, criterion, value, limit and verdict of each check as a table."""
    header = ("case", "criterion", "value", "limit", "verdict", "s")
    cells = []
    before = None
    for row in rows:
        verdict = "passed" if row["passed"] else "FAILED"
        first = row["case"] != before
        before = row["case"]
        cells.append(
            (row["case"] if first else "", row["criterion"], row["value"], row["limit"], verdict)
            + ((row["seconds"],) if first else ("",))
        )
    return timing.table(header, cells)
