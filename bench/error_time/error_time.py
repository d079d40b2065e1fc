"""Run time against error: work-precision diagrams of every solver setting, of whole runs, and of motions known exactly.

One step's contact problems (recorded from impact to rest) are solved by every setting, with more and more sweeps; piles
at rest are run on in closed loop; single bodies move along trajectories with a closed form. pymunk and pybox2d run the
same piles and motions. Every point is a line of ``results/error_time.jsonl``, every scene a figure beside it; with
``--quick`` both go to ``out/error_time``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench import timing

SUMMARY = "wall time against error: solver settings, closed loops, closed forms, peers; figures, Pareto fronts"
KEYS = (
    "best_1e4",
    "default_over_front",
    "plain_over_front",
    "default_missed",
    "left_out",
    "not_unique",
    "orders",
    "scenes",
    "points",
)
THREADS = 1

LEVELS = (1e-2, 1e-4, 1e-6)  # errors in velocity
RESIDUALS = (1e-4, 1e-6)  # relative natural maps
RUN_LEVELS = {"penetration": (1e-3, 1e-5), "drift": (1e-3, 1e-5)}  # [m], [m/s]
TRAJECTORIES = (1e-2, 1e-3)  # [m]
HEADLINE = 1e-4
UNIQUE = 1e-6  # two references that differ by more in velocity are two solutions
RESULTS = Path(__file__).resolve().parents[1] / "results"
QUICK_RESULTS = Path("out/error_time")


def measure(quick: bool) -> dict[str, Any]:
    """All scenes and motions; files are written scene by scene."""
    from tqdm import tqdm

    from bench.error_time import figures as error_time_figures
    from bench.error_time import motion as error_time_motion
    from bench.error_time import points as error_time_points
    from bench.error_time import scenes as error_time_scenes

    cases = error_time_scenes.QUICK if quick else error_time_scenes.CASES
    folder = QUICK_RESULTS if quick else RESULTS
    values: dict[str, Any] = {"scenes": {}, "left_out": {}, "not_unique": {}}
    lines: list[dict[str, Any]] = []
    bar = tqdm(unit="", dynamic_ncols=True, bar_format="{elapsed} {postfix}")

    def advance(text: str) -> None:
        bar.set_postfix_str(text)

    for name, case in cases.items():
        summary, points = measure_case(case, quick, lambda text, name=name: advance(f"{name}: {text}"))  # type: ignore[misc]
        points = [{"scene": name, **point} for point in points]
        values["scenes"][name] = summary
        for key in ("left_out", "not_unique"):
            values[key][name] = summary[key]
        lines += points
        error_time_figures.scene_figure(_title(case, summary), points, folder / f"error_time_{name}.png")
        error_time_points.write(lines, folder / "error_time.jsonl")
    points = error_time_motion.points(quick, lambda text: advance(f"motions: {text}"))
    for name in error_time_motion.MOTIONS:
        error_time_points.mark([p for p in points if p["scene"] == name], ("trajectory",))
    lines += points
    error_time_figures.motion_figure(points, folder / "error_time_motions.png")
    error_time_points.write(lines, folder / "error_time.jsonl")
    bar.close()
    values |= {"points": len(lines), **headline(values["scenes"])}
    values["orders"], values["motions"] = _motions(points)
    return values


def measure_case(case: Any, quick: bool, advance: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """One scene: its summary, and its points."""
    from bench.error_time import points as error_time_points
    from bench.error_time import references as error_time_references
    from bench.error_time import runs as error_time_runs
    from bench.error_time import scenes as error_time_scenes
    from bench.error_time import solve as error_time_solve

    advance("recording states")
    states = error_time_scenes.record(case)
    references: list[Any] = []
    spreads, contacts = [], []
    for state in states:
        sim = state.simulation("float64")
        sim.collide(error_time_runs.DT)
        contacts.append(int(sim.contacts.numpy("contact_count")[0]))
        found = []
        for start in ("cache", "zero"):
            advance(f"reference of step {state.step} from {start}")
            if start == "zero":
                sim.contacts.numpy("impulse")[:] = 0.0
            found.append(error_time_references.solve(sim, case.most))
        references.append([reference for reference in found if reference.reached])
        spreads.append(error_time_references.spread(sim, references[-1]))
    chosen = error_time_solve.settings(case.learned, quick)
    curves = [
        error_time_solve.curves(case, state, found, chosen, advance)
        for state, found in zip(states, references, strict=True)
    ]
    points = error_time_points.mean_points(curves, case.ladder)
    error_time_points.mark(points, error_time_solve.ERRORS)
    default = list(error_time_solve.default_points(states, references, case.repeats))
    runs = error_time_runs.points(case, states[-1], error_time_runs.runs(quick), advance)
    error_time_points.mark(runs, error_time_runs.ERRORS)
    mean: dict[str, Any] = {"kind": "solve_default", "setting": "default"}
    mean["sweeps"] = sum(point["sweeps"] for point in default) / len(default)
    mean["seconds"] = error_time_points.geometric_mean(point["seconds"] for point in default)
    for name in error_time_solve.ERRORS:
        mean[name] = error_time_points.geometric_mean(point["errors"][name] for point in default)
    summary = {
        "title": case.title,
        "states": len(states),
        "contacts": sum(contacts) / len(contacts),
        "left_out": sum(not found for found in references),
        "not_unique": sum(spread > UNIQUE for spread in spreads),
        "spread": max(spreads),
        "velocity": {f"{level:g}": error_time_points.race(curves, level) for level in LEVELS},
        "residual": {f"{level:g}": error_time_points.race(curves, level, "residual") for level in RESIDUALS},
        "default": {name: mean[name] for name in ("sweeps", "seconds", *error_time_solve.ERRORS)},
        "runs": {
            error: {f"{level:g}": _fastest_runs(runs, error, level) for level in levels}
            for error, levels in RUN_LEVELS.items()
        },
    }
    return summary, [*points, mean, *runs]


def _title(case: Any, summary: dict[str, Any]) -> str:
    out = summary["left_out"]
    return (
        f"{case.title}: {summary['states']} states, {summary['contacts']:,.0f} contacts in the mean"
        f"{f'; {out} without a reference' if out else ''}; points of solves: geometric means over the states"
    )


def _fastest_runs(runs: list[dict[str, Any]], error: str, level: float) -> dict[str, Any]:
    """The fastest run of each engine whose error is at most ``level``, the default's and plain Gauss-Seidel's."""
    good = [run for run in runs if run[error] is not None and run[error] <= level]
    found: dict[str, Any] = {}
    for engine in ("deep-contact", "pymunk", "pybox2d"):
        mine = [run for run in good if run["engine"] == engine]
        best = min(mine, key=lambda run: run["seconds"], default=None)
        found[engine] = best and {"setting": best["setting"], "seconds": best["seconds"]}
    for name in ("default", "plain"):
        found[name] = next((run["seconds"] for run in good if run["setting"] == name), None)
    return found


def headline(scenes: dict[str, Any]) -> dict[str, Any]:
    """To ``HEADLINE`` in velocity (the natural map where no reference was reached) by scene: the best setting, ratios.

    A ratio is that to the fastest setting of each state, over the states in which it gets there at all.
    """
    from bench.error_time.solve import DEFAULT

    found: dict[str, Any] = {"best_1e4": {}, "default_over_front": {}, "plain_over_front": {}, "default_missed": {}}
    for name, summary in scenes.items():
        race = summary["velocity"][f"{HEADLINE:g}"] or summary["residual"][f"{HEADLINE:g}"]
        if not race:
            continue
        label, best = next(iter(race.items()))
        found["default_missed"][name] = race[DEFAULT.label]["missed"]
        found["best_1e4"][name] = {"setting": label, **best}
        for key, setting in (("default_over_front", DEFAULT.label), ("plain_over_front", "plain")):
            found[key][name] = race[setting]["over_front"]
    return found


def _motions(points: list[dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Orders of convergence of ours in float64, and by motion and engine the times to ``TRAJECTORIES``."""
    from bench.error_time import figures as error_time_figures
    from bench.error_time import motion as error_time_motion
    from bench.error_time import points as error_time_points

    orders: dict[str, Any] = {}
    times: dict[str, Any] = {}
    for name in error_time_motion.MOTIONS:
        here = [p for p in points if p["scene"] == name]
        times[name] = {}
        for series in error_time_motion.SERIES:
            curve = error_time_figures.series_points(here, series)
            errors, seconds = [p["trajectory"] for p in curve], [p["seconds"] for p in curve]
            if series.endswith("float64"):
                orders[name] = error_time_motion.order([p["dt"] for p in curve], errors)
            times[name][series] = {
                f"{level:g}": error_time_points.time_to(level, seconds, errors) for level in TRAJECTORIES
            }
    return orders, times


def _milliseconds(entry: dict[str, Any] | None) -> str:
    if entry is None:
        return "-"
    missed = f" ({entry['missed']} missed)" if entry["missed"] else ""
    return f"{timing.number(1e3 * entry['seconds'])}{missed}"


def report(values: dict[str, Any]) -> str:
    """Tables for people."""
    from bench.error_time.solve import DEFAULT

    solves, runs = [], []
    for name, scene in values["scenes"].items():
        for what, levels in (("velocity", scene["velocity"]), ("natural map", scene["residual"])):
            for level, race in levels.items():
                if not race:
                    continue
                label, best = next(iter(race.items()))
                entries = [race.get(DEFAULT.label), race.get("plain")]
                states = f"{best['states']}/{scene['states']}"
                ratios = [entry and entry["over_front"] for entry in entries]
                solves.append((name, what, level, states, label, *map(_milliseconds, (best, *entries)), *ratios))
        for what, levels in scene["runs"].items():
            for level, found in levels.items():
                ours = found["deep-contact"]
                row = [found[engine] and found[engine]["seconds"] for engine in ("deep-contact", "pymunk", "pybox2d")]
                peers = [found[engine] and found[engine]["setting"] for engine in ("pymunk", "pybox2d")]
                cells = [row[0], found["default"], found["plain"]]
                text = [f"{timing.number(s)} ({t})" if t else "-" for s, t in zip(row[1:], peers, strict=True)]
                runs.append((name, what, level, ours["setting"] if ours else "-", *cells, *text))
    motions = [
        (name, level, *(times[series][level] for series in times))
        for name, times in values["motions"].items()
        for level in next(iter(times.values()))
    ]
    left = ", ".join(
        f"{name} {scene['left_out']} of {scene['states']}"
        for name, scene in values["scenes"].items()
        if scene["left_out"]
    )
    several = ", ".join(
        f"{name} {scene['not_unique']} of {scene['states']} (up to {timing.number(scene['spread'])} apart)"
        for name, scene in values["scenes"].items()
        if scene["not_unique"]
    )
    orders = ", ".join(f"{name} {timing.number(order)}" for name, order in values["orders"].items())
    return "\n".join(
        [
            "One solve: time until an error stays below a level [ms], mean of the states where any setting gets there",
            timing.table(
                (
                    "scene",
                    "error",
                    "level",
                    "states",
                    "fastest",
                    "ms",
                    "default",
                    "plain PGS",
                    "default/front",
                    "plain/front",
                ),
                solves,
            ),
            f"without a reference to 1e-12, left out of the errors in velocity: {left or 'none'}; two starts, two "
            f"velocities: {several or 'none'}",
            "",
            "Piles at rest: wall time per simulated second [s] of the fastest run that keeps the level",
            timing.table(
                ("scene", "error", "level", "fastest of ours", "s", "default", "plain", "pymunk", "pybox2d"), runs
            ),
            "",
            "Motions: wall time per simulated second [s] to an error at 1.6 s",
            timing.table(("motion", "level", *next(iter(values["motions"].values()))), motions),
            f"order in dt, float64: {orders}",
        ]
    )
