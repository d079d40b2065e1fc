"""Sections of what solves cost and how right they are: error over time, problems of others, closed forms, stability."""

from __future__ import annotations

import math
from typing import Any

from bench.faults.faults import BARS, LABELS
from bench.pages.markdown import Record, figure, paragraphs, span, table

LEVEL = "0.0001"  # of the relative natural map, as the record's keys have it
PENETRATION = "0.001"  # [m], of a pile at rest
# settings whose times over the fastest one are told, by what they show
SETTINGS = {
    "`adaptive`": "adaptive",
    "plain Gauss-Seidel": "plain",
    "Aitken": "aitken",
    "NNCG": "nncg",
    "SOR": "sor",
    "Jacobi with `adaptive`": "jacobi adaptive",
    "the scalar rows of the GPU's schedule": "adaptive, scalar",
    "ContactNet with `adaptive`": "adaptive, ContactNet",
}
FIGURES = ("thesis_100", "thesis_1000", "thesis_10000", "mixed", "pyramid", "mixed_masses", "heavy_on_light")


def setting(entry: dict[str, Any] | None) -> str:
    """Write the milliseconds to a level, and in brackets how many states were missed."""
    return f"{figure(1e3 * entry['seconds'])} ({entry['missed']})" if entry else "-"


def resting(run: dict[str, Any] | float | None) -> str:
    """Write seconds per simulated second, with the setting where there is one; "never" where none keeps the level."""
    if run is None:
        return "never"
    return figure(run) if isinstance(run, float) else f"{figure(run['seconds'])} ({run['setting']})"


def over_front(record: Record, label: str) -> list[float]:
    """Return the time of a setting over the fastest setting's, for each scene where it gets to the level."""
    races = [scene["residual"][LEVEL] for scene in record["scenes"].values()]
    ratios = [race[label]["over_front"] for race in races if label in race]
    return [ratio for ratio in ratios if ratio is not None]


def _race(race: dict[str, Any], states: int) -> tuple[str, ...]:
    """Write how many states reach the level, and the times of the default, the fastest and the plain setting."""
    if not race:
        return f"0 of {states}", *3 * ("-",)
    label, best = next(iter(race.items()))
    ours, plain = setting(race["adaptive"]), setting(race["plain"])
    return f"{best['states']} of {states}", ours, f"{setting(best)}, {label}", plain


def error_time(record: Record) -> str:
    """Show times to a level of one solve, of a pile at rest and of motions, beside the peers."""
    solves, piles = [], []
    for scene in record["scenes"].values():
        solves.append((scene["title"], *_race(scene["residual"][LEVEL], scene["states"])))
        runs = scene["runs"]["penetration"][PENETRATION]
        piles.append(
            (
                scene["title"],
                *map(resting, (runs["default"], *(runs[name] for name in ("deep-contact", "pymunk", "pybox2d")))),
            )
        )
    fronts = [(text, span(over_front(record, label))) for text, label in SETTINGS.items()]
    motions = [
        (name, level, *(times[series][level] for series in times))
        for name, times in record["motions"].items()
        for level in next(iter(times.values()))
    ]
    pictures = "\n".join(
        f"- [{record['scenes'][name]['title']}](../bench/results/error_time_{name}.png)"
        for name in FIGURES
        if name in record["scenes"]
    )
    return paragraphs(
        "Steps recorded from impact to rest, solved by every setting, against float64 references solved to 1e-12; "
        "piles at rest in closed loop, and motions with a closed form, beside pymunk and pybox2d.",
        "![300 mixed bodies: natural map, velocity, impulse, change, penetration, drift over wall time]"
        "(../bench/results/error_time_mixed.png)",
        "Milliseconds to a relative natural map of 1e-4; in brackets the states in which a setting does not get "
        "there, of those where any does:",
        table(("scene", "states", "`adaptive` (default)", "fastest setting", "plain Gauss-Seidel"), solves),
        "Time to that level over the fastest setting's in the same state, over the scenes:",
        table(("setting", "times the fastest"), fronts),
        "Seconds per simulated second of a pile at rest. The columns of pymunk and pybox2d hold their fastest setting "
        "that keeps overlaps below 1 mm in the mean, with its iterations and dt:",
        table(("scene", "default", "our fastest", "pymunk", "pybox2d"), piles),
        "Seconds per simulated second to an error [m] of one moving body at 1.6 s:",
        table(("motion", "error", *next(iter(record["motions"].values()))), motions),
        f"Orders in dt: {', '.join(f'{name} {figure(order)}' for name, order in record['orders'].items())}.",
        "![errors of four motions over wall time](../bench/results/error_time_motions.png)",
        "The figures of all scenes:",
        pictures,
    )


def fc2d(record: Record) -> str:
    """Show the problems solved to 1e-4 and 1e-8 by each solver, and its times on the largest file."""
    total = len({row["file"] for row in record["rows"]}) + record["states"]
    counts = record["solved"]
    largest = max(record["rows"], key=lambda row: row["contacts"])["file"]
    files = dict.fromkeys(row["file"] for row in record["rows"])
    rows = [row for row in record["rows"] if row["file"] == largest]
    cells = [
        (
            f"`{row['solver']}`",
            counts["1e4"][row["solver"]],
            counts["1e8"][row["solver"]],
            row["sweeps_1e4"],
            row["seconds_1e4"] and 1e3 * row["seconds_1e4"],
            row["sweeps_1e8"],
            row["seconds_1e8"] and 1e3 * row["seconds_1e8"],
        )
        for row in rows
    ]
    first_order = [count for name, count in counts["1e8"].items() if name not in ("newton", "auto")]
    header = ("solver", "solved to 1e-4", "to 1e-8", "sweeps to 1e-4", "ms", "sweeps to 1e-8", "ms")
    return paragraphs(
        f"{total} problems in Delassus form, {total - record['states']} of other simulators and {record['states']} "
        "states of our scenes, from zero to a relative natural map. The columns to the right are of the largest of "
        f"the others' problems, {largest} with {figure(rows[0]['contacts'])} contacts.",
        f"The problems of others are the files {', '.join(files)} from the test data of the Siconos project, in the "
        "layout of FCLIB, its collection of contact problems.",
        table(header, cells),
        f"To 1e-8 `auto` solves {counts['1e8']['auto']} of {total}, Newton's method {counts['1e8']['newton']}, "
        f"first-order methods {min(first_order)} to {max(first_order)}.",
        "![performance profiles of eight solvers to natural maps of 1e-4 and 1e-8](../bench/results/fc2d.png)",
    )


def failures(record: Record) -> str:
    """Say how many cases failed, and which."""
    return f"{record['failed']} failed: {', '.join(record['failures'])}" if record["failures"] else "none failed"


def closest(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Find the check that came closest to its limit."""
    return max(
        rows, key=lambda row: row["value"] / row["limit"] if row["limit"] and row["value"] is not None else -math.inf
    )


def accuracy(record: Record) -> str:
    """Show how many closed forms were checked, and of each the check that came closest to its limit."""
    cases = dict.fromkeys(row["case"] for row in record["rows"])
    rows = []
    for case in cases:
        row = closest([row for row in record["rows"] if row["case"] == case])
        rows.append((case.replace("_", " "), row["criterion"], row["value"], row["limit"]))
    return paragraphs(
        f"{record['cases']} cases, {figure(record['checks'])} checks, {failures(record)}.",
        "The checks ask that what is exact in steps agrees to rounding, in float64 and float32, and that orders in "
        "dt, over at least four steps, are 1 (falls, friction, impacts) or 2 (periods of pendula). They ask that "
        "oblique hits of discs, and elastic ones of boxes, keep their angular momentum, that an elastic ball "
        "returns to its height, and that touching balls of a cradle end at (-1/3, 2/3, 2/3) v (Newton's law, all "
        "contacts at once), with gaps between them at (0, 0, v). Formula and source stand in the docstring of each "
        "case in [bench/accuracy](../bench/accuracy). Of each case the check that came closest to its limit:",
        table(("case", "check", "value", "limit"), rows),
    )


def stability(record: Record) -> str:
    """Show how many scenes that break solvers were checked, and of each the check closest to its limit."""
    cases = dict.fromkeys(row["case"] for row in record["rows"])
    rows = []
    for case in cases:
        row = closest([row for row in record["rows"] if row["case"] == case])
        rows.append((case.replace("_", " "), row["criterion"], row["value"], row["limit"]))
    return paragraphs(
        f"{record['scenes']} scenes, {figure(len(record['rows']))} checks, {failures(record)}.",
        "The checks ask that stacks of 10, 50 and 100 boxes and a pyramid of 5 050 stand for 60 s within 1 % of a "
        "width, that arches and overhangs stand and fall within 10 % and 1 % of their limits, that discs stop at "
        "walls 2 cm thin at up to 1e6 m/s, that overlaps part without a speed, that 1 000 discs in a tumbler gain "
        "no energy in an hour, and that 300 random whole scenes keep the laws in each step. The settings of each "
        "scene stand in its docstring in [bench/stability](../bench/stability). Of each scene the check that came "
        "closest to its limit:",
        table(("scene", "check", "value", "limit"), rows),
    )


def faults(record: Record) -> str:
    """What was tried to crash it or to go wrong unseen, beside the bars of the full form."""
    rows = [(LABELS[key], record[key], f"{sign} {bar:g}") for key, (sign, bar) in BARS.items()]
    return paragraphs(
        "Calls with bad arguments, hostile files, kills, threads and forks, each in processes of their own.",
        table(("", "found", "bar"), rows),
    )
