"""Do the scenes that break solvers stand, stop, or stay bounded? A verdict each, and a picture of each that fails."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from bench.verdicts import Cases, judge, table

SUMMARY = "stacks, arches, mass ratios, bullets, overlaps, tumbler, invariance: criterion, value, verdict of each scene"
KEYS = ("scenes", "failed")
THREADS = 2
PICTURES = Path("out/stability")
MODULES = (
    "structures",
    "extremes",
    "starts",
    "scale",
    "input",
    "invariance",
    "fuzz",
)


def cases() -> Cases:
    """The scenes of all modules."""
    merged = Cases()
    for name in MODULES:
        module = importlib.import_module(f"bench.stability.{name}")
        for case in module.cases.all.values():
            (merged.add_slow if case.__name__ in module.cases.slow else merged.add)(case)
    return merged


def measure(quick: bool) -> dict[str, Any]:
    """Scenes, how many failed, and a row for each criterion."""
    verdicts = judge(cases(), quick, PICTURES)
    return {"scenes": verdicts["count"], "failed": verdicts["failed"]} | {
        name: verdicts[name] for name in ("failures", "rows")
    }


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    failures = ", ".join(values["failures"]) or "none"
    return f"{table(values['rows'])}\n{values['scenes']} scenes, {values['failed']} failed: {failures}"
