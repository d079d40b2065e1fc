"""Closed forms of mechanics: how far the simulator is off, the limit that theory sets, and orders in the time step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.accuracy import friction as accuracy_friction
from bench.accuracy import impacts as accuracy_impacts
from bench.accuracy import joints as accuracy_joints
from bench.accuracy import statics as accuracy_statics
from bench.accuracy import structures as accuracy_structures
from bench.accuracy.common import cases
from bench.verdicts import judge, table

SUMMARY = "closed forms: free fall, friction, rolling, impacts, statics, arches, joints, with orders in dt"
KEYS = ("cases", "failed")
THREADS = 1

CASES = cases
MODULES = (accuracy_friction, accuracy_impacts, accuracy_statics, accuracy_structures, accuracy_joints)


def measure(quick: bool) -> dict[str, Any]:
    """The verdicts; rows: of each case what failed, its orders, and the check that came closest to its limit."""
    found = judge(CASES, quick, Path("out/accuracy"))
    kept = []
    for name in CASES.names(quick):
        rows = [row for row in found["rows"] if row["case"] == name]
        closest = max(rows, key=closeness, default=None)
        kept += [row for row in rows if not row["passed"] or row["criterion"].startswith("order") or row is closest]
    return {
        "cases": found["count"],
        "failed": found["failed"],
        "failures": found["failures"],
        "checks": len(found["rows"]),
        "rows": kept,
    }


def closeness(row: dict[str, Any]) -> float:
    """Share of its limit that a check uses; a limit of zero can only be kept exactly."""
    return row["value"] / row["limit"] if row["value"] is not None and row["limit"] else 0.0


def report(values: dict[str, Any]) -> str:
    """The table, and how many."""
    count = f"{values['cases']} cases, {values['checks']} checks, {values['failed']} failed"
    return "\n".join((table(values["rows"]), ": ".join((count, ", ".join(values["failures"]))).removesuffix(": ")))
