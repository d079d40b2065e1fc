"""Bad calls: every public function and every setting, every argument, every value that this argument must refuse.

Each group of calls runs in a process of its own. A call is clear where it raises a TypeError, ValueError or
OverflowError whose message names the argument; else it is unclear, as it is where it crashes the process or takes too
long. What is accepted is silent.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import io
import itertools
import json
import os
import pkgutil
import queue
import re
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from bench.faults.targets.learning import pipeline_targets, torch_targets
from bench.faults.targets.scenes import event_targets, joint_targets, population_targets, query_targets
from bench.faults.targets.simulations import (
    Target,
    always,
    builder_targets,
    delassus_targets,
    grid_targets,
    point_targets,
    simulation_targets,
)
from bench.faults.targets.stages import driving_targets, solver_targets, stage_targets
from bench.faults.values import bad_values, cases, required, subclasses
from dc_kernels.model.settings import shown

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 60.0  # seconds without an answer after which a call counts as hung
WORKERS = 2
NAMED = 40  # faults that are named
QUICK = 11  # of so many calls the quick form makes one
MARK = "\x1e"  # begins the lines that are answers: libraries print what they like
SETTINGS = 4  # processes that the settings are shared among


def together(*parts: Callable[[], Iterator[Target]]) -> Callable[[], Iterator[Target]]:
    """All targets of several functions."""
    return lambda: itertools.chain.from_iterable(part() for part in parts)


TARGETS: dict[str, Callable[[], Iterator[Target]]] = {
    "builder": together(builder_targets, joint_targets),
    "simulation": simulation_targets,
    "grid": grid_targets,
    "points": point_targets,
    "delassus": delassus_targets,
    "stages": stage_targets,
    "solver": solver_targets,
    "driving": together(driving_targets, event_targets),
    "population": together(population_targets, query_targets),
    "torch": torch_targets,
    "pipeline": pipeline_targets,
}
"""Groups of functions, each of which is tried in a process of its own."""


class Call(NamedTuple):
    """One bad call."""

    name: str
    """What is called, and the argument and its value."""
    names: tuple[str, ...]
    """What the error may call the argument."""
    make: Callable[[], Callable[..., Any]]
    """Makes the function anew."""
    arguments: Callable[[], dict[str, Any]]
    """Makes its arguments, the bad one among them."""


def examples() -> dict[str, dict[str, Any]]:
    """Fields without a default of the dataclasses of settings, by name of the class."""
    import dc_kernels as dc
    from pipeline.commands.fclib import Solve
    from pipeline.scenes import scene

    incline = {"scene": scene("incline")}
    return {
        "Grid": {"rows": 8, "columns": 8, "spacing": 1.0},
        "ImageSpec": {"grid": dc.Grid(rows=8, columns=8, spacing=1.0)},
        "Crowd": {"bodies": 1, "worlds": 1, "acceleration": "none", "steps": (1,)},
        "Simulate": incline,
        "Explain": incline,
        "Export": incline,
        "Solve": {"path": Path("x")},
        "Fclib": {"action": Solve(path=Path("x"))},
        "Figures": {"figure": "kernels"},
        "Train": {"network": "unet"},
    }


def all_settings() -> list[type]:
    """Every dataclass of settings of the project, but those that need an extra which is not installed."""
    for package in ("dc_kernels", "pipeline"):
        for info in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if "._warp" not in info.name and "._numpy" not in info.name:
                with contextlib.suppress(ImportError):
                    importlib.import_module(info.name)
    return sorted(set(subclasses()), key=lambda one: (one.__module__, one.__name__))


def of_settings(number: int) -> Iterator[Call]:
    """Calls that make settings with a bad field, for one of ``SETTINGS`` processes."""
    known = examples()
    for settings in all_settings()[number::SETTINGS]:
        good = settings(**{name: known[settings.__name__][name] for name in required(settings)})
        for name, value in cases(settings):
            label = f"{settings.__name__}({name}={shown(value)})"
            yield Call(label, (name,), always(functools.partial(replace, good)), always({name: value}))


def of_target(target: Target) -> Iterator[Call]:
    """Calls of a function with a bad argument."""
    for name, hint in target.hints.items():
        for value in bad_values(hint):
            label = f"{target.name}({name}={shown(value)})"

            def arguments(name: str = name, value: Any = value) -> dict[str, Any]:
                return {**target.good(), name: value}

            yield Call(label, (name, *target.called.get(name, ())), target.make, arguments)


def calls_of(group: str) -> Iterator[Call]:
    """All calls of a group."""
    kind, _, number = group.partition(":")
    if kind == "settings":
        yield from of_settings(int(number))
        return
    for target in TARGETS[group]():
        target.make()(**target.good())  # what is right must be right
        yield from of_target(target)


def judge(call: Call) -> tuple[str, str]:
    """Make a call; return "clear", "unclear" or "silent", and what happened."""
    function, arguments = call.make(), call.arguments()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            function(**arguments)
    except (TypeError, ValueError, OverflowError) as error:
        text = str(error)
        clear = any(re.search(rf"\b{re.escape(name)}\b", text) for name in call.names) and "\n" not in text.strip()
        return "clear" if clear else "unclear", f"{type(error).__name__}: {text}"
    except Exception as error:
        return "unclear", f"{type(error).__name__}: {error}"
    return "silent", "accepted"


def serve(group: str, first: int, stride: int) -> None:
    """Make the calls of a group from the first on, and say of each when it begins and how it ended."""

    def answer(*values: Any) -> None:
        print(MARK + json.dumps(values), flush=True)

    for number, call in enumerate(calls_of(group)):
        if number >= first and number % stride == 0:
            answer("begin", number, call.name)
            answer("end", number, *judge(call))


def run_group(
    group: str, stride: int, program: Sequence[str] = ("-m", "bench.faults.calls")
) -> list[tuple[str, str, str]]:
    """Run a group of calls in processes, each of which begins behind the call that ended the one before.

    Args:
        group: key of ``TARGETS``, or "settings:0" and so on.
        stride: one of so many calls is made.
        program: arguments of Python for what serves the calls.

    Returns:
        Name, outcome and what happened of each call.

    Raises:
        RuntimeError: where a process ends and no call is to blame.
    """
    found: list[tuple[str, str, str]] = []
    first, ended = 0, False
    while not ended:
        arguments = [sys.executable, *program, group, str(first), str(stride)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
        with subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=ROOT
        ) as child:
            lines: queue.Queue[str | None] = queue.Queue()
            threading.Thread(target=_read, args=(child.stdout, lines), daemon=True).start()
            errors: queue.Queue[str | None] = queue.Queue()
            threading.Thread(target=_read, args=(child.stderr, errors), daemon=True).start()
            begun, name, hung = -1, "", False
            while True:
                try:
                    line = lines.get(timeout=LIMIT)
                except queue.Empty:
                    hung = True
                    child.kill()
                    break
                if line is None:
                    break
                if line.startswith(MARK):
                    what, number, *rest = json.loads(line[1:])
                    if what == "begin":
                        begun, name = number, rest[0]
                    else:
                        found.append((name, *rest))
                        begun = -1
            child.wait()
        ended = begun < 0
        if ended and (child.returncode or hung):
            raise RuntimeError(f"{group} ended between calls: {''.join(iter(errors.get, None))[-2000:]}")
        if not ended:
            found.append((name, "unclear", "hung" if hung else f"crashed with {child.returncode}"))
            first = begun + 1
    return found


def _read(stream: Any, lines: queue.Queue[str | None]) -> None:
    """Hand on lines as they come, then None."""
    for line in stream:
        lines.put(line)
    lines.put(None)


def measure(quick: bool) -> dict[str, Any]:
    """Count calls, those refused without a name, and those accepted; in the quick form one call of eleven is made."""
    groups = [*TARGETS, *(f"settings:{i}" for i in range(SETTINGS))]
    with ThreadPoolExecutor(WORKERS) as pool:
        parts = pool.map(lambda group: run_group(group, QUICK if quick else 1), groups)
        found = [one for part in parts for one in part]
    wrong = {kind: [f"{name}: {text}" for name, what, text in found if what == kind] for kind in ("unclear", "silent")}
    return {
        "bad_calls": len(found),
        **{kind: len(lines) for kind, lines in wrong.items()},
        "call_faults": {kind: lines[:NAMED] for kind, lines in wrong.items() if lines},
    }


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
