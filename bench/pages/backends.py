"""Section of the bench that sets the backends beside each other."""

from __future__ import annotations

from bench.backends.backends import KEYS, NAMES, equality
from bench.backends.figure import label
from bench.pages.markdown import Record, paragraphs, table


def backends(record: Record) -> str:
    """Show times, ratios to Warp, bits and errors of every row, then the figures that have bars."""
    rows = [
        (
            label(row),
            row["unit"],
            *(row["times"].get(engine) for engine in NAMES),
            row["over_warp"].get("taichi"),
            row["over_warp"].get("quadrants"),
            equality(row),
            row["error"].get("taichi"),
        )
        for row in record["rows"]
    ]
    header = ("what", "unit", *NAMES.values(), "Taichi over Warp", "Quadrants over Warp", "bits of Warp", "error")
    memory = {
        engine: max((row["memory_mb"].get(engine, 0.0) for row in record["rows"]), default=0.0) for engine in NAMES
    }
    reasons = {
        f"{label(row)}, {NAMES[engine]}: {why}" for row in record["rows"] for engine, why in row["empty"].items()
    }
    versions = ", ".join(f"{name} {number or 'not installed'}" for name, number in record["compilers"].items())
    return paragraphs(
        "Which to use when: Warp, unless it does not run where you are or another part of your program is Taichi's; "
        "numpy to read and to check.",
        "Steps of settled piles, at most 30 sweeps each, from one snapshot, with threads as the row says or one. A "
        "step, a stage: microseconds; a sweep: nanoseconds a contact; splat, gather, search: nanoseconds a point. Each "
        "engine has a process of its own, and they take turns; a ratio is the median of the rounds'. The error is the "
        "largest difference, in SI units, that a first call leaves to float64: to the oracle's where it is timed, else "
        "to Warp's. An empty cell is not measured: the oracle takes minutes there, and the quick form has no "
        f"Quadrants. {versions}.",
        table(header, rows),
        "![time of each backend over Warp's](../bench/results/backends.png)",
        table(("key", "Taichi", "Quadrants"), [(f"`{k}`", record[k], record.get(f"quadrants_{k}")) for k in KEYS]),
        "Largest memory of each process [MiB]: "
        + ", ".join(f"{NAMES[engine]} {value:.0f}" for engine, value in memory.items() if value)
        + ".",
        f"Cells that failed: {'; '.join(sorted(reasons))}." if reasons else "",
    )
