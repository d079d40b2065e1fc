"""Does the solver behave as in the theses' experiment? Sweeps from None, Builtin and Copy, beside the 2026 study.

The study's figures are those of another implementation (float64, one point after the other in body-pair order,
tangent before normal), so agreement within some 20 % is all that can be asked for.
"""

from __future__ import annotations

from typing import Any

from bench import timing

SUMMARY = "thesis protocol: median sweeps of None and Builtin, share of Copy done in 10, beside the 2026 study"
KEYS = ("none_median", "builtin_median", "copy_done_10")
THREADS = 1

# (start, acceleration): mean, median and share done in 10 of the 2026 study, None where it gives no figure
STUDY: dict[tuple[str, str], tuple[float | None, float | None, float | None]] = {
    ("none", "none"): (457, 408, None),
    ("builtin", "none"): (311, 215, None),
    ("copy", "none"): (111, 1, 0.80),
    ("none", "aitken"): (175, 120, None),
    ("builtin", "aitken"): (115, 68, None),
}


def prefix(start: str, acceleration: str) -> str:
    """Of a pair's keys: none, builtin, copy, none_aitken, ..."""
    return start if acceleration == "none" else f"{start}_{acceleration}"


def measure(quick: bool) -> dict[str, Any]:
    """Mean, median and share done in 10 sweeps of each pair, over all states with contacts; never more than seconds."""
    from pipeline.evaluate.comparison import protocol
    from pipeline.evaluate.options import ProtocolOptions

    options = ProtocolOptions(history=False)
    values: dict[str, Any] = {"worlds": options.worlds}
    for (start, acceleration), run in zip(STUDY, protocol(options, pairs=list(STUDY)), strict=True):  # type: ignore
        row, key = run.summary(), prefix(start, acceleration)
        values[f"{key}_mean"] = row["mean_sweeps"]
        values[f"{key}_median"] = row["median_sweeps"]
        values[f"{key}_done_10"] = row["done_in"]["10"]
        values[f"{key}_states"] = row["states"]
        values[f"{key}_contacts"] = row["contacts"]
        values[f"{key}_wall_s"] = row["wall_s"]
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = []
    for (start, acceleration), (mean, median, done) in STUDY.items():
        key = prefix(start, acceleration)
        label = f"{start.capitalize()}, {'plain' if acceleration == 'none' else acceleration}"
        ours = {name: values[f"{key}_{name}"] for name in ("median", "mean", "done_10", "contacts")}
        rows.append((label, ours["median"], median, ours["mean"], mean, ours["done_10"], done, ours["contacts"]))
    header = (
        "sweeps to 1e-4 N s",
        "median",
        "2026 study",
        "mean",
        "2026 study",
        "done in 10",
        "2026 study",
        "contacts",
    )
    return timing.table(header, rows)
