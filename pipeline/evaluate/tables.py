"""Tables that compare runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.evaluate.runs import DONE_IN, Run, summaries


@dataclass(frozen=True)
class Column:
    """A column of a table: its title, and the text of a row of ``runs.summaries``."""

    title: str
    text: Callable[[dict[str, Any]], str]


def _share(sweeps: int) -> Callable[[dict[str, Any]], str]:
    """Make what writes the share of states that were done in some sweeps."""
    return lambda row: f"{100.0 * row['done_in'][str(sweeps)]:.0f} %"


def _spread(row: dict[str, Any]) -> str:
    """Write the least and the largest mean of a world."""
    means = row["world_mean_sweeps"]
    return f"{min(means):.0f}-{max(means):.0f}"


def _over(row: dict[str, Any]) -> str:
    """Write the mean sweeps over those of Builtin."""
    ratio = (row["over_builtin"] or {}).get("sweeps_ratio")
    return "-" if ratio is None else f"{ratio:.2f}"


def _calls(row: dict[str, Any]) -> str:
    """Write the calls of the network for a state."""
    return f"{row['counts']['calls'] / max(row['states'], 1):.2f}" if row["counts"] else "-"


_LABEL = Column("start, solver", lambda row: row["label"])
_MEAN = Column("mean", lambda row: f"{row['mean_sweeps']:.0f}")
_MEDIAN = Column("median", lambda row: f"{row['median_sweeps']:.0f}")
_WALL = Column("wall [s]", lambda row: f"{row['wall_s']:.2f}")
PROTOCOL_COLUMNS = (
    _LABEL,
    _MEAN,
    _MEDIAN,
    *(Column(f"<={n}", _share(n)) for n in DONE_IN),
    Column("contacts", lambda row: f"{row['contacts']:.0f}"),
    _WALL,
)
"""Columns of the protocol's table."""
EVALUATION_COLUMNS = (
    _LABEL,
    _MEAN,
    _MEDIAN,
    Column("worlds", _spread),
    Column("/builtin", _over),
    *(Column(f"<={n}", _share(n)) for n in DONE_IN),
    Column("MSE normal", lambda row: f"{row['start_error_normal']:.2g}"),
    Column("tangent", lambda row: f"{row['start_error_tangent']:.2g}"),
    Column("calls", _calls),
    _WALL,
)
"""Columns of the evaluation's table."""


def cells(runs: Sequence[Run], columns: Sequence[Column] = PROTOCOL_COLUMNS) -> list[list[str]]:
    """Return the rows of a table as text."""
    return [[column.text(row) for column in columns] for row in summaries(runs)]


def table(runs: Sequence[Run], columns: Sequence[Column] = PROTOCOL_COLUMNS) -> str:
    """Write the table for people, with the meaning of its columns below."""
    rows = [[column.title for column in columns], *cells(runs, columns)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(columns))]
    lines = []
    for row in rows:
        first = row[0].ljust(widths[0])
        lines.append("  ".join([first, *(text.rjust(width) for text, width in zip(row[1:], widths[1:]))]))
    lines.insert(1, "-" * len(lines[0]))
    worlds = runs[0].sweeps.shape[1]
    total = runs[0].sweeps.size
    counted = sorted({int(run.with_contacts.sum()) for run in runs})
    many = f"{counted[0]}" if len(counted) == 1 else f"{counted[0]} to {counted[-1]}"
    lines.append(f"sweeps per step over the states in which a contact presses ({many} of {total}, {worlds} worlds);")
    lines.append(f"<=n: share of them that reached the tolerance of {runs[0].tolerance:g} N s in n sweeps.")
    if columns is EVALUATION_COLUMNS:
        lines.append("worlds: least and largest mean of a world; /builtin: mean over that of Builtin, same solver;")
        lines.append("MSE: start against solution [N^2 s^2]; calls: of the network for a state.")
    lines.append("wall: time of all steps, networks included, without starts that need the solution (Copy)")
    return "\n".join(lines)
