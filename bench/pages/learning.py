"""Sections of starts and networks: the theses' protocol, and networks in closed loop."""

from __future__ import annotations

from typing import Any

from bench.learning.protocol import STUDY, prefix
from bench.learning.stepper import BATCH, METHODS
from bench.pages.markdown import Record, figure, paragraphs, table

NETWORKS = {
    "convfc": "ConvFC",
    "unet": "UNet",
    "contactnet": "**ContactNet**, start and every 12 or 15 sweeps",
    "even share": "even share: ContactNet's calls without a network",
    "contactnet start": "**ContactNet**, start only",
}


def beside(ours: float, theirs: float | None, text: str) -> str:
    """Write our figure, and the study's in brackets where it gives one."""
    return text.format(ours) if theirs is None else f"{text.format(ours)} ({text.format(theirs)})"


def protocol(record: Record) -> str:
    """Show the sweeps of starts beside those of the study of 2026."""
    rows = []
    for (start, acceleration), (mean, median, done) in STUDY.items():
        key = prefix(start, acceleration)
        text = f"{start.capitalize()}, {'plain PGS' if acceleration == 'none' else acceleration.capitalize()}"
        cells = [
            (record[f"{key}_{name}"], theirs, form)
            for name, theirs, form in (
                ("median", median, "{:.0f}"),
                ("mean", mean, "{:.0f}"),
                ("done_10", done, "{:.2f}"),
            )
        ]
        rows.append((text, *(beside(*cell) for cell in cells)))
    return paragraphs(
        f"Sweeps until the largest impulse change is below 1e-4 N s, {record['worlds']} held-out worlds, cap 1000, "
        "the theses' slop of 5 mm and no look-ahead. None starts from zero, Builtin from the cached impulses, Copy "
        "from the impulses of a solve of that very step. A study of 2026 with another engine found the figures in "
        "brackets.",
        table(("start, solver", "median", "mean", "done in 10 sweeps"), rows),
    )


def start_name(start: str) -> str:
    """Return the name that people know a start by."""
    return NETWORKS.get(start.lower(), start[:1].upper() + start[1:])


def learning(record: Record) -> str:
    """Show the sweeps from every start, with plain Gauss-Seidel and Aitken, and wall times."""
    starts = dict.fromkeys(row["start"] for row in record["rows"])

    def cell(start: str, accelerated: bool) -> str:
        found: list[dict[str, Any]] = [
            row for row in record["rows"] if row["start"] == start and ("+" in row["solver"]) == accelerated
        ]
        return f"{found[0]['mean_sweeps']:.0f} / {found[0]['median_sweeps']:.0f}" if found else ""

    rows = [(start_name(start), cell(start, False), cell(start, True)) for start in starts]
    batch, parts, sweeps = record["batch_s"], record["batch_parts_s"], record["sweeps_1000"]
    split = ", ".join(f"{seconds:.1f} s {name}" for name, seconds in parts.items())
    return paragraphs(
        f"{record['worlds']} held-out worlds in closed loop, sweeps to 1e-4 N s as in the protocol. The networks of "
        "2018 were trained here on 60 worlds; ContactNet is the one in the package. Even share makes ContactNet's "
        "calls without a network: every contact moves by 1 + r / (1 - r) times its last step, r taken over some 6 "
        "diameters.",
        table(("start", "plain PGS: mean / median", "Aitken: mean / median"), rows),
        f"ContactNet takes {record['pgs_ratio']:.2f} times Builtin's sweeps on plain Gauss-Seidel, fewer in "
        f"{record['worlds_better']} of {record['worlds']} worlds, and {record['accelerated_ratio']:.2f} times with "
        f"Aitken, fewer in {record['accelerated_worlds_better']}. At 1 000 discs with Aitken it takes "
        f"{record['accelerated_ratio_1000']:.2f}{spread(record)} times ({sweeps['contactnet']:.0f} sweeps in place of "
        f"{sweeps['builtin']:.0f}), over {record['states_1000']} states that converge without it. The even share "
        f"reaches {record['even_ratio']:.2f}, {record['even_accelerated_ratio']:.2f} and "
        f"{record['even_ratio_1000']:.2f}: most of the gain is Aitken's step made at the right places, not the "
        "network.",
        f"In wall time {record['batch']} worlds take {record['wall_ratio']:.1f} times as long as from the cache "
        f"({batch['learned']:.1f} s in place of {batch['builtin']:.1f} s, of which {split}), and one thesis world "
        f"{record['world_s']:.1f} s (from the cache {figure(record['world_builtin_s'])} s; 1 to 2 minutes in 2018). "
        f"{even_times(record)}For speed start from the cache, without a network.",
    )


def spread(record: Record) -> str:
    """Say by how much the ratio at 1 000 discs scatters; nothing of a record that has not taken it."""
    error = record.get("accelerated_ratio_1000_error")
    return "" if error is None else f" (standard error over worlds {error:.2f})"


def even_times(record: Record) -> str:
    """Say what an even share takes; nothing of a record that has not timed it."""
    if "even_wall_ratio" not in record:
        return ""
    return (
        f"With an even share in all calls it is {record['even_wall_ratio']:.1f} times ({record['batch_s']['even']:.1f} "
        f"s), and {figure(record['world_even_s'])} s. "
    )


def stepper(record: Record) -> str:
    """Show errors, piles and times of a network in the solver's place, beside sweeps of the solver."""
    runs, times, over = record["runs"], record["us_per_step"], record["over_solver_10_sweeps"]
    dts, batch = list(runs), str(BATCH)
    at = record["steps"].index(50)
    rows = [
        (
            method.name,
            *(figure(runs[dt][method.key]["position_mm"][at]) for dt in dts),
            *(figure(runs[dts[0]][method.key][name]) for name in ("overlap_mean_mm", "overlap_max_mm", "kinetic_J")),
            figure(runs[dts[0]][method.key]["creep_mm_s"]),
            figure(times[batch][method.key]),
        )
        for method in METHODS
    ]
    header = (
        "velocities by",
        *(f"50 steps of {dt} s [mm]" for dt in dts),
        "overlap, mean [mm]",
        "max",
        "kinetic [J]",
        "creep [mm/s]",
        f"us a step, batch of {batch}",
    )
    errors = ", ".join(f"{value:.2f} at dt {dt} s" for dt, value in record["velocity_error"].items())
    large = record["large"]
    last = record["large_steps"][-1]
    return paragraphs(
        f"{record['worlds']} held-out worlds of 100 discs, from the moment in which these meet: mean distance of the "
        "bodies to those of the solver at 1e-8 in float64 with the same dt, then the piles "
        f"{record['steps'][-1]} steps of {dts[0]} s later, and what a step of a world takes on one thread.",
        table(header, rows),
        f"One answer alone leaves, of the error that no contacts at all make in the velocities, {errors}. A step of "
        f"one world by itself takes {figure(times['1']['0'])} us by the network, {figure(times['1']['solver_10'])} by "
        f"ten sweeps; in a batch of {batch} the network takes {figure(over[batch]['0'])} times as long as ten sweeps. "
        f"In a world of 1 000 discs bodies are {figure(large['0']['position_mm'][-1])} mm off after {last} steps by "
        f"the network, {figure(large['3']['position_mm'][-1])} with three sweeps after it, and "
        f"{figure(large['solver_10']['position_mm'][-1])} by ten sweeps alone.",
        f"![time of a step against error and overlap](../bench/results/{record['figure']})"
        if not record["quick"]
        else "",
    )
