"""Warp, Taichi, Quadrants and the oracle on the same things: time, first call, memory, bits, error.

Every engine has a process of its own, and they take turns, round after round, each from the same snapshot. A first call
of each makes the numbers that are compared: with Warp's bit for bit, and with a reference in float64, which is the
oracle's where it ends within seconds and else Warp's.
"""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import tempfile
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from bench import timing
from bench.backends import jobs
from bench.backends.jobs import CASES, ENGINES, UNITS, Case
from bench.backends.worker import VARIABLE, Worker
from bench.speed.startup import first_step

SUMMARY = "warp, taichi, quadrants, numpy, torch and SciPy side by side: stages, steps, sweeps, splats, searches"
# of Taichi; values hold those of Quadrants with "quadrants_" before them. None: not measured
RATIOS = {
    "step_64_worlds_over_warp": ("step, 64 worlds", 1),
    "step_64_worlds_over_warp_2_threads": ("step, 64 worlds", 2),
    "step_1_world_over_warp": ("step, 1 world", 1),
    "step_10000_over_warp": ("step, 10000 discs", 1),
    "sweep_over_warp_float32": ("sweep of a contact, float32", 1),
    "sweep_over_warp_float64": ("sweep of a contact, float64", 1),
    "splat_over_warp": ("splat, 100000 particles", 1),
    "gather_over_warp": ("gather, 100000 particles", 1),
    "neighbors_over_warp": ("neighbors, 100000 points", 1),
}
STARTS = ("cold_s", "warm_s")
KEYS = (*RATIOS, "threads_ratio", "rows_filled", "bits_equal", *STARTS)
THREADS = 2
KEPT = "DEEP_CONTACT_BENCH_FOLDER"
COMPILERS = ("taichi", "quadrants")
LEFT_OUT = ("quadrants",)  # of the quick form: loading its kernels too takes longer than that may
NAMES = {"warp": "Warp", "taichi": "Taichi", "quadrants": "Quadrants", "numpy": "numpy", "peer": "torch, SciPy"}

ROUNDS, ROUNDS_QUICK, ROUNDS_NUMPY = 9, 3, 1
SCALE = {"us": 1e6, "ns": 1e9}
# kernels of Taichi need a source that is a file: those of the package have one, whatever runs them
FIRST_STEP = """
import time
import dc_kernels as dc
from bench import cases
model, state, joints = cases.scenes.Thesis().build(1, 0).finalize(backend="taichi")
dc.Simulation(model, state, joints).step(cases.DT)
print("done", time.time())
"""

Row = dict[str, Any]
"""``row``, ``threads``, ``unit``; by engine ``times`` in that unit (median), ``over_warp`` (median of the rounds'
ratios), ``equal`` (bits), ``error``, ``first_s``, ``memory_mb``, ``empty`` (why a cell is)."""


def rows_of(case: Case, parts: Sequence[str], found: dict[str, dict[str, Any]]) -> list[Row]:
    """Rows of the table from what the engines measured of a case.

    Args:
        case: what was timed.
        parts: names of its rows.
        found: of each engine: ``rounds`` (seconds by part, one dictionary a round), and what its first call told; or
            ``error``.
    """
    rows = []
    for part in parts:
        unit = UNITS[case.kind]
        row: Row = {"row": part, "threads": case.threads, "unit": unit, "kind": case.kind, "times": {}, "over_warp": {}}
        for key in ("equal", "error", "first_s", "memory_mb", "empty"):
            row[key] = {}
        for engine, told in found.items():
            if "error" in told:
                row["empty"][engine] = told["error"]
                continue
            spent = [times[part] for times in told["rounds"]]
            row["times"][engine] = SCALE[unit] * statistics.median(spent)
            if "rounds" in found["warp"]:
                theirs = [times[part] for times in found["warp"]["rounds"]]
                row["over_warp"][engine] = statistics.median(a / b for a, b in zip(spent, theirs))  # numpy has fewer
            for key in ("first_s", "memory_mb"):
                row[key][engine] = told[key]
            for key, name in (("equal", "equal"), ("difference", "error")):
                if told.get(key) is not None:
                    row[name][engine] = told[key]
        rows.append(row)
    return rows


def compare(case: Case, number: int, found: dict[str, dict[str, Any]], folder: Path) -> None:
    """Add to what each engine told of its first call whether its bits are Warp's, and its error to the reference."""
    given = {engine: np.load(folder / f"{engine}_{number}.npy") for engine, told in found.items() if "rounds" in told}
    exact = None
    if case.kind not in ("neighbors", "stages"):  # pairs have no error; a step has it in its own row
        exact = jobs.make(case, "numpy" if case.oracle else "warp", folder, "float64").result()
    for name, values in given.items():
        if name != "peer" and "warp" in given:
            found[name]["equal"] = values.tobytes() == given["warp"].tobytes()
        if exact is not None and case.dtype == "float32" and values.shape == exact.shape:
            found[name]["difference"] = float(np.abs(values - exact).max(initial=0.0))


def measure_case(number: int, workers: dict[str, Worker], rounds: int, folder: Path) -> list[Row]:
    """Let the engines make the case, then take turns."""
    case = CASES[number]
    timing.progress(case.name)
    engines = [engine for engine in case.engines() if engine in workers]
    found: dict[str, dict[str, Any]] = {}
    for engine in engines:
        workers[engine].ask(do="prepare", case=number)
    for engine in engines:
        found[engine] = workers[engine].answer()
    for turn in range(rounds):
        for engine, told in found.items():
            if "error" in told or (engine == "numpy" and turn >= ROUNDS_NUMPY):
                continue
            workers[engine].ask(do="time")
            answer = workers[engine].answer()
            if "error" in answer:
                told |= answer
            else:
                told.setdefault("rounds", []).append(answer["seconds"])
    compare(case, number, found, folder)
    parts = next((list(told["rounds"][0]) for told in found.values() if "rounds" in told), [case.name])
    return rows_of(case, parts, found)


def save_scenes(folder: Path, cases: Sequence[Case]) -> None:
    """Write a snapshot of each scene in both scalars, which all engines start from."""
    for what in dict.fromkeys(case.what for case in cases if case.kind in ("step", "stages", "sweep")):
        narrow, wide = (jobs.snapshot(folder, what, dtype) for dtype in ("float32", "float64"))
        if wide.exists():
            continue  # of a run that was cut short
        timing.progress(f"settling: {what}")
        jobs.settle(what).save(narrow)
        widen(narrow, wide.with_suffix(".part"))
        wide.with_suffix(".part").rename(wide)


def widen(narrow: Path, wide: Path) -> None:
    """Write a snapshot of float32 again as one of float64 with the same numbers."""
    import h5py

    with h5py.File(narrow) as old, h5py.File(wide, "w") as new:

        def copy(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                values = item[()]
                new[name] = values.astype(np.float64) if item.dtype == np.float32 else values
            else:
                new.require_group(name)
            new[name].attrs.update(item.attrs)

        old.visititems(copy)
        new.attrs.update({key: "float64" if value == "float32" else value for key, value in old.attrs.items()})


def starts(quick: bool) -> dict[str, float | None]:
    """Seconds to a first step with an empty cache and with a full one; the quick form takes no empty one."""
    found: dict[str, float | None] = {}
    for compiler in COMPILERS:
        prefix = "" if compiler == "taichi" else f"{compiler}_"
        found |= {f"{prefix}{key}": None for key in STARTS}
        if version_of(compiler) is None or (quick and compiler != "taichi"):
            continue
        timing.progress(f"first step of a process, {compiler}")
        if not quick:
            with tempfile.TemporaryDirectory(prefix="deep-contact-cache-") as folder:
                found[f"{prefix}cold_s"] = first_step(folder, FIRST_STEP, {VARIABLE: compiler})
            first_step(None, FIRST_STEP, {VARIABLE: compiler})  # fills the user's cache
        times = [first_step(None, FIRST_STEP, {VARIABLE: compiler}) for _ in range(1 if quick else 5)]
        found[f"{prefix}warm_s"] = statistics.median(times)
    return found


def version_of(package: str) -> str | None:
    """Version of a package; None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def measure(quick: bool) -> dict[str, Any]:
    """All rows of the table, and the keys from them.

    Where the environment variable ``KEPT`` names a folder, scenes and the rows of each case are kept there, and those
    that are there already are not measured again: a run that was cut short goes on.
    """
    cases = [case for case in CASES if case.quick or not quick]
    rows: list[Row] = []
    with contextlib.ExitStack() as stack:
        kept = os.environ.get(KEPT)
        folder = Path(kept or stack.enter_context(tempfile.TemporaryDirectory(prefix="deep-contact-backends-")))
        folder.mkdir(parents=True, exist_ok=True)
        files = {case: folder / f"rows_{CASES.index(case)}_{'quick' if quick else 'full'}.json" for case in cases}
        missing = [case for case in cases if not files[case].exists()]
        save_scenes(folder, missing)
        engines = [engine for engine in ENGINES if engine not in (LEFT_OUT if quick else ()) and missing]
        workers = {engine: Worker(engine, folder) for engine in engines}
        try:
            for case in missing:
                found = measure_case(CASES.index(case), workers, ROUNDS_QUICK if quick else ROUNDS, folder)
                files[case].with_suffix(".part").write_text(json.dumps(found), encoding="utf-8")
                files[case].with_suffix(".part").rename(files[case])
        finally:
            for worker in workers.values():
                worker.close()
        for file in files.values():
            rows += json.loads(file.read_text(encoding="utf-8"))
    return {**summary(rows), **starts(quick), "rows": rows, "compilers": {c: version_of(c) for c in COMPILERS}}


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """The keys of both compilers from the rows: ratios to Warp, shares of cells filled, and of rows with equal bits."""
    table = {(row["row"], row["threads"]): row for row in rows}
    values: dict[str, Any] = {}
    for compiler in COMPILERS:
        prefix = "" if compiler == "taichi" else f"{compiler}_"
        for key, place in RATIOS.items():
            values[prefix + key] = table.get(place, {}).get("over_warp", {}).get(compiler)
        one, two = (table.get(("step, 64 worlds", n), {}).get("times", {}).get(compiler) for n in (1, 2))
        values[f"{prefix}threads_ratio"] = one / two if one and two else None
        equal = [row["equal"][compiler] for row in rows if compiler in row["equal"]]
        values[f"{prefix}bits_equal"] = sum(equal) / len(equal) if equal else None
    cells = [(row, engine) for row in rows for engine in (*row["times"], *row["empty"])]
    values["cells"] = len(cells)
    values["rows_filled"] = sum(engine in row["times"] for row, engine in cells) / len(cells) if cells else None
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    header = ("what", "threads", "unit", *NAMES.values(), "Taichi/Warp", "Quadrants/Warp", "bits", "error", "first [s]")
    body = [
        (
            row["row"],
            row["threads"],
            row["unit"],
            *(row["times"].get(engine) for engine in NAMES),
            *(row["over_warp"].get(compiler) for compiler in COMPILERS),
            equality(row),
            row["error"].get("taichi"),
            row["first_s"].get("taichi"),
        )
        for row in values["rows"]
    ]
    reasons = {f"{row['row']}, {engine}: {why}" for row in values["rows"] for engine, why in row["empty"].items()}
    keys = [(key, values[key], values.get(f"quadrants_{key}")) for key in KEYS]
    return "\n\n".join(
        [
            timing.table(header, body),
            timing.table(("key", "Taichi", "Quadrants"), keys),
            *(["empty cells:\n" + "\n".join(sorted(reasons))] if reasons else []),
        ]
    )


def equality(row: Row) -> str | None:
    """Say whether both compilers left Warp's bits; None where none was compared."""
    equal = [row["equal"][compiler] for compiler in COMPILERS if compiler in row["equal"]]
    if not equal:
        return None
    return "equal" if all(equal) else "differ"
