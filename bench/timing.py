"""Timing for all benches: alternatives measured in turn, medians, the machine's name, a table and one JSON line."""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PACKAGES = ("warp-lang", "numpy", "torch", "pymunk", "Box2D")


def seconds(function: Callable[[], Any]) -> float:
    """Measure the wall time of one call [s]."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def interleave(
    functions: Mapping[str, Callable[[], Any]], rounds: int, *, warmup: int = 1, clock: Callable[..., float] = seconds
) -> dict[str, list[float]]:
    """Measure wall times [s] of several functions in turn, so that a slow spell of the machine meets all of them.

    Args:
        functions: what to call, by name.
        rounds: timed calls of each, at least 1.
        warmup: calls of each beforehand that are not timed (they compile, load and fill caches).
        clock: gives the seconds that a call took; by default the wall time around it.

    Raises:
        ValueError: for fewer than one round.
    """
    if rounds < 1:
        raise ValueError(f"rounds is {rounds}; it must be at least 1")
    for function in functions.values():
        for _ in range(warmup):
            function()
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            times[name].append(clock(function))
    return times


def medians(times: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Return the median of each list."""
    return {name: statistics.median(values) for name, values in times.items()}


def cpu_model() -> str:
    """Return the processor's name as the system gives it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            for line in lines:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def package_versions() -> dict[str, str]:
    """Return the versions of the installed packages that figures depend on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def machine(threads: int = 1) -> dict[str, Any]:
    """Describe the machine: processor, cores, threads used, load by others, Python and packages."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": threads,
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": package_versions(),
    }


def machine_line(facts: Mapping[str, Any]) -> str:
    """Describe the machine in one line."""
    packages = ", ".join(f"{name} {number}" for name, number in facts["packages"].items())
    return (
        f"{facts['cpu']}, {facts['cores']} cores, {facts['threads']} thread(s) used; "
        f"Python {facts['python']}, {packages}"
    )


def number(value: Any, digits: int = 3) -> str:
    """Write a figure for people: about three digits, no exponent for ordinary sizes, - where there is none."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, int) or value == 0:
        return f"{value:,d}".replace(",", " ") if isinstance(value, int) else "0"
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:,.0f}".replace(",", " ")
    if abs(value) < 1e-3:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{digits}g}"


def table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Align columns, the first to the left and the others to the right."""
    cells = [list(header)] + [[number(value) for value in row] for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = []
    for i, row in enumerate(cells):
        first, *others = row
        lines.append(
            "  ".join([first.ljust(widths[0]), *(c.rjust(w) for c, w in zip(others, widths[1:], strict=True))])
        )
        if i == 0:
            lines.append("  ".join("-" * width for width in widths))
    return "\n".join(line.rstrip() for line in lines)


def json_line(name: str, values: Mapping[str, Any], keys: Sequence[str], *, quick: bool, threads: int = 1) -> str:
    """Write the bench, the machine and all values as a JSON object on one line.

    Raises:
        ValueError: when a key that the bench promises is missing.
    """
    missing = [key for key in keys if key not in values]
    if missing:
        raise ValueError(f"bench {name} measured no {', '.join(missing)}")
    record = {"bench": name, "quick": quick, **values, "machine": machine(threads)}
    return json.dumps(record, default=plain)


def plain(value: Any) -> Any:
    """Turn a numpy scalar or array into plain Python, for JSON."""
    return value.tolist()


def progress(text: str) -> None:
    """Print a line on the error stream, so that a long bench is not silent and its output stays clean."""
    print(f"  ... {text}", file=sys.stderr, flush=True)
