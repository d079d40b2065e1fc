"""Contact problems of simulated scenes as FCLIB files, and FCLIB files solved: ``deep-contact fclib export|solve``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dc_kernels.delassus import Method, from_world, read_impulses, solve, warmup
from dc_kernels.model.settings import Positive, Settings, Whole
from pipeline.fclib.files import FclibProblem, problem_files, read_fclib, write_fclib
from pipeline.files import check_writable, versions
from pipeline.options import RunOptions, SolverOptions
from pipeline.process import interruptible, progress_bar
from pipeline.scenes import Scene

FIELDS = ("scene", "step", "world")
SUFFIXES = (".hdf5", ".h5")


@dataclass(frozen=True, kw_only=True)
class ExportOptions(Settings):
    """Options of an export: which contact problems are written, and where to."""

    step: tuple[str, ...] = ("100",)
    """Steps whose problems are written, counted from 1: numbers, or FIRST:LAST:STRIDE with both ends."""
    world: tuple[Whole, ...] = (0,)
    """Worlds among those of the run [1]."""
    out: str = "out/fclib/{scene}_{step:05d}_{world}.hdf5"
    """Files; {scene}, {step} and {world} are replaced, and needed where there are several."""

    def steps(self) -> list[int]:
        """Return the steps in order.

        Raises:
            ValueError: naming what is no step or range.
        """
        found: set[int] = set()
        for text in self.step:
            try:
                parts = [int(part) for part in text.split(":")]
                first, last, stride = (*parts, *(parts[0], 1)[len(parts) - 1 :])
                chosen = range(first, last + 1, stride)
            except ValueError:
                raise ValueError(f"step is {text!r}; it must be a number, FIRST:LAST or FIRST:LAST:STRIDE") from None
            if first < 1 or not len(chosen):
                raise ValueError(f"step is {text!r}; steps begin at 1, and FIRST:LAST:STRIDE must ascend")
            found.update(chosen)
        return sorted(found)

    def path(self, scene: str, step: int, world: int) -> Path:
        """Return the path of a problem's file.

        Raises:
            ValueError: for a pattern with other fields.
        """
        try:
            return Path(self.out.format(scene=scene, step=step, world=world))
        except (KeyError, ValueError, IndexError) as error:
            raise ValueError(f"out is {self.out!r}; its fields may be {FIELDS} ({error})") from None


def export(
    scene: Scene, run: RunOptions, solver: SolverOptions, options: ExportOptions, progress: bool = True
) -> dict[str, Any]:
    """Simulate a scene and write the contact problems of some steps, with the cached impulses as a guess.

    Args:
        scene: what is run.
        run: worlds, time step, dtype.
        solver: settings of the solver; what it finds goes into the files as their solution.
        options: which steps and worlds, and the files.
        progress: show a bar on stderr.

    Returns:
        ``files``: path, step, world, contacts and residuals of each; ``empty``: (step, world) without contacts;
        ``complete``: False where Ctrl-C ended it early.

    Raises:
        ValueError: for an option out of its range, or a pattern that gives one name to several problems.
        OSError: a file cannot be written; those before it are whole.
    """
    if solver.sleep:
        raise ValueError("sleep is True; the contacts of what sleeps are in no problem")
    steps = options.steps()
    for world in options.world:
        if not 0 <= world < run.worlds:
            raise ValueError(f"world is {world}; it must lie in [0, {run.worlds}), the worlds of the run")
    wanted = [(step, world) for step in steps for world in dict.fromkeys(options.world)]
    paths = [options.path(scene.name, step, world) for step, world in wanted]
    if len(set(paths)) < len(paths):
        raise ValueError(f"out is {options.out!r}, one name for several problems; use {{step}} and {{world}}")
    sim = run.simulation(scene, solver.config())
    for path in paths:
        check_writable(path.parent, path.name)
    text = f"deep-contact {versions()['deep-contact']}: {asdict(scene)}, dt {run.dt:g} s, seed {run.seed}, {run.dtype}"
    files, empty, done = [], [], 0
    by_step: dict[int, list[tuple[int, Path]]] = {}
    for (step, world), path in zip(wanted, paths, strict=True):
        by_step.setdefault(step, []).append((world, path))
    with interruptible() as stop:
        for step in progress_bar(range(1, steps[-1] + 1), desc=f"export {scene.name}", unit="step", show=progress):
            if stop.is_set():
                break
            sim.collide(run.dt)
            made = []
            for world, path in by_step.get(step, ()):
                problem = from_world(sim, world)
                if problem.count - int(problem.bilateral.sum()):
                    made.append((world, path, problem, read_impulses(sim, problem)))
                else:
                    empty.append([step, world])
            try:
                with stop.urgent():
                    sim.solve()
            except KeyboardInterrupt:
                if not stop.is_set():
                    raise
                break
            for world, path, problem, guess in made:
                found = read_impulses(sim, problem)
                title = {"title": f"{scene.name}, step {step}, world {world}", "description": text, "math_info": ""}
                write_fclib(path, FclibProblem(problem=problem, info=title, solution=found, guesses=[guess]))
                files.append(
                    {"path": str(path), "step": step, "world": world, "contacts": problem.count}
                    | {"residual": problem.natural_map(found), "scaled_residual": problem.scaled_map(found)}
                )
            sim.advance()
            done = step
    return {"scene": scene.name, "complete": done == steps[-1], "files": files, "empty": empty}


@dataclass(frozen=True, kw_only=True)
class SolveOptions(Settings):
    """Options of the solves of FCLIB problems."""

    method: Method = "auto"
    """Method: auto takes sweeps and, where they stall, pivots and Newton steps; or one of them."""
    tolerance: Positive = 1e-8
    """Relative natural map at which a solve ends [1]."""
    max_sweeps: Whole = 100_000
    """Largest number of sweeps [1]."""
    scaled: bool = True
    """Hold the natural map of scaled impulses to the tolerance, too, so that units do not matter."""
    start: str = "zero"
    """Start: zero, guess (the file's first) or solution (the file's)."""
    out: Path | None = None
    """Folder, or file of a single problem, of the problems with their solutions; None: nothing is written."""


def solve_files(path: Path, options: SolveOptions, progress: bool = True) -> dict[str, Any]:
    """Solve a file, or all files of a folder.

    Returns:
        ``method``, ``tolerance``, ``converged`` (of all), ``complete``: False where Ctrl-C ended it early, and
        ``files``: for each name contacts, converged, residual, scaled_residual, sweeps, pivotings, factorizations,
        seconds.

    Raises:
        ValueError: naming the file, for one that cannot be read; an option out of its range.
        OSError: a file cannot be opened or written.
    """
    if options.start not in ("zero", "guess", "solution"):
        raise ValueError(f"start is {options.start!r}; it must be zero, guess or solution")
    paths = problem_files(path)
    contents = [read_fclib(file) for file in paths]
    targets = [options.out if options.out is None or single(options.out) else options.out / p.name for p in paths]
    if options.out is not None:
        if single(options.out) and len(paths) > 1:
            raise ValueError(f"out is {options.out}, one file for {len(paths)} problems; give a folder")
        for planned in filter(None, targets):
            check_writable(planned.parent, planned.name)
    results: dict[str, dict[str, Any]] = {}
    warmup()
    bar = progress_bar(paths, desc="solve", unit="file", show=progress)
    for file, content, target in zip(bar, contents, targets, strict=True):
        start = {"zero": None, "guess": next(iter(content.guesses), None), "solution": content.solution}[options.start]
        if start is None and options.start != "zero":
            raise ValueError(f"{file}: there is no {options.start} in it to start from")
        began = time.perf_counter()
        try:
            solution = solve(
                content.problem,
                options.method,
                tolerance=options.tolerance,
                max_sweeps=options.max_sweeps,
                scaled=options.scaled,
                start=start,
            )
        except KeyboardInterrupt:
            break
        results[file.name] = {
            "contacts": content.problem.count,
            "converged": solution.converged,
            "residual": solution.residual,
            "scaled_residual": solution.scaled_residual,
            "sweeps": solution.sweeps,
            "pivotings": solution.pivotings,
            "factorizations": solution.factorizations,
            "seconds": time.perf_counter() - began,
        }
        if target is not None:
            write_fclib(target, replace(content, solution=solution.impulses))
    return {
        "method": options.method,
        "tolerance": options.tolerance,
        "converged": all(row["converged"] for row in results.values()),
        "complete": len(results) == len(paths),
        "files": results,
    }


def single(path: Path) -> bool:
    """Tell whether a path is that of one file, by its suffix."""
    return path.suffix in SUFFIXES


def describe_export(result: dict[str, Any]) -> str:
    """Name the files with their contacts, and what was not written."""
    lines = [f"{row['path']}: {row['contacts']} contacts, residual {row['residual']:.2e}" for row in result["files"]]
    return "\n".join([*lines, *(f"step {step}, world {world}: no contacts" for step, world in result["empty"])])


def describe_solve(result: dict[str, Any]) -> str:
    """Write a line for each file."""
    width = max(map(len, result["files"]), default=0)
    lines = [f"{'file'.ljust(width)}  contacts  sweeps  pivotings   LU  natural map   scaled       ms"]
    for name, row in result["files"].items():
        lines.append(
            f"{name.ljust(width)}  {row['contacts']:8d}  {row['sweeps']:6d}  {row['pivotings']:9d}  "
            f"{row['factorizations']:3d}  {row['residual']:11.2e}  {row['scaled_residual']:7.1e}  "
            f"{1e3 * row['seconds']:7.1f}" + ("" if row["converged"] else f"  not below {result['tolerance']:g}")
        )
    return "\n".join(lines)
