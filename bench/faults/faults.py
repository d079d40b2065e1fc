"""What must neither crash, nor go wrong in silence: bad calls, hostile files, kills, threads, flush tiles.

Everything that may crash runs in a process of its own, which is counted.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from bench import timing

SUMMARY = "bad calls, hostile files, kills, threads and processes at once, flush tiles: what crashes or goes on unseen"
THREADS = 2

PARTS = ("calls", "files", "threads", "kills", "tiles")
BARS: dict[str, tuple[str, float]] = {
    "bad_calls": (">=", 5000),
    "unclear": ("<=", 0),
    "silent": ("<=", 0),
    "hostile_files": (">=", 1000),
    "crashed": ("<=", 0),
    "hung": ("<=", 0),
    "accepted_wrong": ("<=", 0),
    "kills": (">=", 50),
    "lost": ("<=", 0),
    "thread_runs": (">=", 50),
    "thread_failures": ("<=", 0),
    "tiles_worst_speed": (">=", 0.999),
}
"""Keys, and the bars of the full form."""
KEYS = tuple(BARS)
LABELS = {
    "bad_calls": "bad calls",
    "unclear": "refused without naming the field",
    "silent": "accepted",
    "hostile_files": "hostile files",
    "crashed": "crashed the process",
    "hung": "hung",
    "accepted_wrong": "accepted with a value that none may have",
    "kills": "kills by SIGKILL",
    "lost": "worlds, frames, steps lost that were complete",
    "thread_runs": "runs of threads and processes",
    "thread_failures": "failed, or with other bits",
    "tiles_worst_speed": "least share of its speed that a body keeps on flush tiles",
}


def measure(quick: bool) -> dict[str, Any]:
    """Run all parts, each ``measure`` of a module of this folder; a part that is not there has no values."""
    values: dict[str, Any] = dict.fromkeys(KEYS)
    for part in PARTS:
        if importlib.util.find_spec(f"bench.faults.{part}") is None:
            continue
        timing.progress(part)
        values |= importlib.import_module(f"bench.faults.{part}").measure(quick)
    return values


def report(values: dict[str, Any]) -> str:
    """Counts beside their bars, and what is behind each that is no 0."""
    rows = [(LABELS[key], values[key], f"{sign} {bar:g}") for key, (sign, bar) in BARS.items()]
    lines = [timing.table(("faults", "found", "bar of the full form"), rows)]
    for key, found in values.items():
        if key.endswith("_faults") and found:
            named = found.items() if isinstance(found, dict) else [(key, found)]
            lines += [f"{name}: {text}" for name, texts in named for text in texts]
    return "\n".join(lines)
