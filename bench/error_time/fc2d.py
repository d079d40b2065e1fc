"""Real frictional contact problems in Delassus form (FCLIB files): sweeps and time of every solver, from zero.

``python -m bench fc2d [FOLDER]``. The error is the field's relative natural map. Performance profiles (Dolan and More
2002) over these files and over states of our own scenes are drawn to ``bench/results/fc2d.png``; with ``--quick`` or
another folder to ``out/fc2d``.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "frictional contact problems of others (FCLIB files in FOLDER): sweeps and time to 1e-4 and 1e-8, by solver"
KEYS = ("sweeps_1e4", "sweeps_1e8", "seconds_1e8")
THREADS = 1
TAKES = "FOLDER"  # more arguments than the name

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT.parent.parent / "shared" / "data" / "fc2d"
FIGURE = ROOT / "results" / "fc2d.png"  # of the full bench on the default folder
OTHER_FIGURE = Path("out/fc2d/fc2d.png")
SOLVERS = ("pgs", "sor", "aitken", "nncg", "anderson", "hybrid", "newton", "auto")
TOLERANCES = {"1e4": 1e-4, "1e8": 1e-8}
CAP, CAP_QUICK = 20_000, 3_000  # sweeps of first-order methods
CAP_NEWTON = 100_000
ROUNDS, ROUNDS_QUICK = 7, 3
RATIOS = np.geomspace(1.0, 1000.0, 400)


def measure(quick: bool, folder: str | None = None) -> dict[str, Any]:
    """All solvers on all files; the keys by the files' stems: of the solver with the fewest sweeps, the fastest one.

    Raises:
        SystemExit: with 2 and a message, where there is no folder or nothing in it.
    """
    from dc_kernels import delassus
    from pipeline.fclib.files import problem_files, read_fclib

    path = FOLDER if folder is None else Path(folder)
    problems, refused = {}, {}
    try:
        if folder is None and not path.is_dir():
            raise ValueError(f"there is no folder {path}: python -m bench fc2d FOLDER, with FCLIB's .hdf5 files in it")
        for file in problem_files(path):
            try:
                problems[file.stem] = read_fclib(file).problem
            except ValueError as error:  # another file's problem is solved all the same
                refused[file.stem] = str(error)
                timing.progress(f"refused: {error}")
        if not problems:
            raise ValueError(f"no file in {path} holds a problem that can be read")
    except ValueError as error:
        import sys

        print(error, file=sys.stderr)
        raise SystemExit(2) from None
    delassus.warmup()
    cap, rounds = (CAP_QUICK, ROUNDS_QUICK) if quick else (CAP, ROUNDS)
    rows = []
    for name, problem in problems.items():
        timing.progress(f"{name}, {problem.count} contacts")
        rows += [{"file": name, "contacts": problem.count, **row} for row in measure_problem(problem, cap, rounds)]
    values: dict[str, Any] = {"rows": rows, "sweep": sweep_cost(problems), "refused": refused}
    for key in KEYS:
        values[key], values[f"{key}_by"] = {}, {}
        for name in problems:
            own = [row for row in rows if row["file"] == name and row[key] is not None]
            best = min(own, key=lambda row: row[key], default=None)
            values[key][name] = best and best[key]
            values[f"{key}_by"][name] = best and best["solver"]
    ours = dict(our_problems(quick))
    timing.progress(f"{len(ours)} states of our own scenes")
    times: dict[str, dict[str, list[float | None]]] = {tag: {solver: [] for solver in SOLVERS} for tag in TOLERANCES}
    for name in problems:
        for row in rows:
            if row["file"] == name:
                for tag in TOLERANCES:
                    times[tag][row["solver"]].append(row[f"seconds_{tag}"])
    for problem in ours.values():
        for row in measure_problem(problem, cap, 1):
            for tag in TOLERANCES:
                times[tag][row["solver"]].append(row[f"seconds_{tag}"])
    values["states"] = len(ours)
    values["solved"] = {
        tag: {solver: sum(t is not None for t in times[tag][solver]) for solver in SOLVERS} for tag in TOLERANCES
    }
    figure = OTHER_FIGURE if quick or folder is not None else FIGURE
    draw(times, len(problems), len(ours), figure)
    values["figure"] = str(figure.relative_to(ROOT.parent) if figure.is_absolute() else figure)
    return values


def measure_problem(problem: Any, cap: int, rounds: int) -> list[dict[str, Any]]:
    """What each solver takes to each tolerance; no sweeps and seconds where it is not reached."""
    from dc_kernels.delassus import METHODS, solve

    rows = []
    for solver in SOLVERS:
        row: dict[str, Any] = {"solver": solver}
        sweeps = cap if solver in METHODS else CAP_NEWTON
        for tag, tolerance in TOLERANCES.items():
            options: dict[str, Any] = {
                "method": solver, "tolerance": tolerance, "max_sweeps": sweeps, "scaled": False
            }  # fmt: skip
            # every sweep is looked at to count them; for the time every fifth, the default
            counted = solve(problem, every=1, **options) if rounds > 1 else None
            seconds = []
            for _ in range(rounds):
                found: list[Any] = []
                seconds.append(timing.seconds(lambda: found.append(solve(problem, **options))))  # noqa: B023
                if not found[0].converged:
                    break
            counted = counted or found[0]
            row[f"sweeps_{tag}"] = counted.sweeps if counted.converged else None
            row[f"factorizations_{tag}"] = counted.factorizations
            row[f"pivotings_{tag}"] = counted.pivotings
            row[f"seconds_{tag}"] = statistics.median(seconds) if found[0].converged else None
        rows.append(row)
    return rows


def sweep_cost(problems: Mapping[str, Any]) -> dict[str, Any]:
    """Nanoseconds of a plain sweep for each contact and block of W of the largest problem, in both dtypes."""
    from dc_kernels.delassus import solve

    name, problem = max(problems.items(), key=lambda item: item[1].count)
    values: dict[str, Any] = {"file": name, "contacts": problem.count, "blocks": len(problem.column)}
    sweeps = max(100, 10_000_000 // max(1, len(problem.column)))
    for dtype in ("float32", "float64"):

        def run(sweeps: int, dtype: str = dtype) -> None:
            solve(problem, "pgs", tolerance=1e-30, max_sweeps=sweeps, every=sweeps, dtype=dtype)  # type: ignore[arg-type]

        times = timing.interleave({"short": lambda: run(sweeps // 4), "long": lambda: run(sweeps + sweeps // 4)}, 5)
        per_sweep = (min(times["long"]) - min(times["short"])) / sweeps
        values[f"ns_contact_{dtype}"] = 1e9 * per_sweep / problem.count
        values[f"ns_block_{dtype}"] = 1e9 * per_sweep / len(problem.column)
    return values


def our_problems(quick: bool) -> Iterator[tuple[str, Any]]:
    """States of discs, polygons, stacks and mass ratios, from impact to rest: some 60, a third with ``quick``."""
    import dc_kernels as dc
    from dc_kernels.delassus import from_world
    from pipeline import scenes

    runs = {
        "thesis": (scenes.Thesis(), (60, 90, 120, 160, 250)),
        "thesis-300": (scenes.Thesis(bodies=300), (110, 180, 250)),
        "mixed": (scenes.Mixed(), (80, 120, 200)),
        "mixed-rough": (scenes.Mixed(friction=1.5), (100, 200)),
        "bounce": (scenes.Mixed(restitution=0.5, friction=0.3), (100, 200)),
        "smooth": (scenes.Mixed(friction=0.0), (100, 200)),
        "pyramid": (scenes.Pyramid(rows=15), (1, 20, 100)),
        "stack": (scenes.Stack(bodies=20), (1, 30, 100)),
    }
    for seed in range(1 if quick else 3):
        for name, (scene, steps) in runs.items():
            sim = dc.Simulation(*scene.build(1, seed).finalize("float64"))
            for step in range(1, steps[-1] + 1):
                sim.collide(0.01)
                if step in steps:
                    yield f"{name}-{seed}-{step}", from_world(sim)
                sim.solve()
                sim.advance()
    for ratio in (1e2, 1e4) if quick else (1e1, 1e2, 1e3, 1e4, 1e5):
        yield f"ratio-{ratio:g}", heavy_on_light(ratio)


def heavy_on_light(ratio: float) -> Any:
    """Nine boxes at rest, and on them one so many times heavier."""
    import dc_kernels as dc
    from dc_kernels.delassus import from_world

    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    for i in range(10):
        body = builder.add_body(position=(0.02 * (i % 3), 0.5 + i))
        builder.add_box(body, 0.5, 0.5, density=ratio if i == 9 else 1.0)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.collide(0.01)
    return from_world(sim)


def profile(times: Mapping[str, list[float | None]]) -> dict[str, np.ndarray]:
    """Share of the problems that a solver solves within each of ``RATIOS`` times the fastest one's time."""
    table = np.array([[np.inf if t is None else t for t in times[solver]] for solver in SOLVERS])
    best = table.min(axis=0)
    ratio = np.where(np.isfinite(table), table / np.where(np.isfinite(best), best, 1.0), np.inf)
    return {solver: (ratio[i][:, None] <= RATIOS).mean(axis=0) for i, solver in enumerate(SOLVERS)}


def draw(times: Mapping[str, Mapping[str, list[float | None]]], files: int, states: int, path: Path) -> None:
    """The profiles as a figure."""
    from pipeline.plots import style

    with style.figure(9.6, 3.9) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for axis, (tag, tolerance) in zip(axes, TOLERANCES.items(), strict=True):
            for i, (solver, share) in enumerate(profile(times[tag]).items()):
                width = 2.6 if solver == "auto" else 1.6
                every = (0.02 * i, 0.16)
                axis.plot(RATIOS, share, label=solver, linewidth=width, markevery=every, **style.SOLVERS[solver])
            axis.set(xscale="log", xlim=(1, RATIOS[-1]), ylim=(0, 1.02), xlabel="time over the fastest solver's")
            axis.set_title(f"relative natural map {tolerance:g}")
        axes[0].set_ylabel(f"share solved of {files} files and {states} states of our scenes")
        handles, labels = axes[1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), handlelength=3.0)
        style.save_figure(figure, path)


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    header = ("file, contacts", "solver", "sweeps 1e-4", "ms", "sweeps 1e-8", "ms", "LU", "patches")
    cells, before = [], None
    for row in values["rows"]:
        name = f"{row['file']}, {row['contacts']}" if row["file"] != before else ""
        before = row["file"]
        ms = {tag: row[f"seconds_{tag}"] and 1e3 * row[f"seconds_{tag}"] for tag in TOLERANCES}
        beside: list[Any] = ["", ""]
        if row["solver"] in ("newton", "auto") and row["sweeps_1e8"] is not None:
            beside = [row["factorizations_1e8"], row["pivotings_1e8"]]
        cells.append((name, row["solver"], row["sweeps_1e4"], ms["1e4"], row["sweeps_1e8"], ms["1e8"], *beside))
    cost, solved = values["sweep"], values["solved"]
    total = len({row["file"] for row in values["rows"]}) + values["states"]
    return "\n".join(
        [
            timing.table(header, cells),
            f"\na plain sweep of {cost['file']}: "
            + ", ".join(
                f"{dtype} {timing.number(cost[f'ns_contact_{dtype}'])} ns per contact, "
                f"{timing.number(cost[f'ns_block_{dtype}'])} per block"
                for dtype in ("float32", "float64")
            ),
            *(
                f"solved to {TOLERANCES[tag]:g} of {total} files and states: "
                + ", ".join(f"{solver} {count}" for solver, count in solved[tag].items())
                for tag in TOLERANCES
            ),
            f"{values['figure']}: performance profiles",
            *(f"refused: {why}" for why in values["refused"].values()),
        ]
    )
