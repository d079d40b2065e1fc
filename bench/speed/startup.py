"""How long a newcomer waits: from the start of the process to the end of the first step.

Each measurement is a fresh Python process that imports the package, builds one thesis world and takes one step, with
Warp's kernel cache full (warm) or in a new, empty folder (cold, everything is compiled).
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench import timing

SUMMARY = "process start to first step done: warm and cold kernel cache [s]"
KEYS = ("warm_s", "cold_s")
THREADS = 1

ROOT = Path(__file__).resolve().parents[2]
CHILD = """
import time
from bench import cases
simulation = cases.simulation(cases.scenes.Thesis())
simulation.step(cases.DT)
print("done", time.time())
"""


def first_step(cache: str | None = None, code: str = CHILD, variables: Mapping[str, str] | None = None) -> float:
    """Seconds from the start of a new process to the end of its first step.

    Args:
        cache: where compiled kernels are; None: where they are for everybody.
        code: what the process runs; the last word that it prints is the time of the system when it has ended.
        variables: of its environment, beside those of this process.

    Raises:
        RuntimeError: with the process's error output, when it fails.
    """
    environment = {**os.environ, **(variables or {})}
    if cache is not None:
        environment["WARP_CACHE_PATH"] = cache
    begin = time.time()  # of the system, since two processes take it
    child = subprocess.run(
        [sys.executable, "-c", code], check=False, cwd=ROOT, env=environment, capture_output=True, text=True
    )
    if child.returncode != 0:
        raise RuntimeError(f"the child process failed:\n{child.stderr}")
    return float(child.stdout.split()[-1]) - begin


def cold_step() -> float:
    """``first_step`` with an empty kernel cache.

    Raises:
        RuntimeError: when Warp left the folder empty, so that another cache was used.
    """
    with tempfile.TemporaryDirectory(prefix="deep-contact-cache-") as folder:
        elapsed = first_step(folder)
        if not any(path.is_file() for path in Path(folder).rglob("*")):
            raise RuntimeError("nothing was compiled into the new kernel cache: WARP_CACHE_PATH had no effect")
        return elapsed


def measure(quick: bool) -> dict[str, Any]:
    """Median of several warm starts, and of one (quick) or two cold ones."""
    timing.progress("cold starts")
    cold = [cold_step() for _ in range(1 if quick else 2)]
    timing.progress("warm starts")
    first_step()  # fills the user's cache
    warm = [first_step() for _ in range(3 if quick else 7)]
    return {
        "warm_s": statistics.median(warm),
        "cold_s": statistics.median(cold),
        "warm_all_s": warm,
        "cold_all_s": cold,
    }


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = [
        ("warm kernel cache", values["warm_s"], min(values["warm_all_s"]), max(values["warm_all_s"])),
        ("cold kernel cache", values["cold_s"], min(values["cold_all_s"]), max(values["cold_all_s"])),
    ]
    return timing.table(("process start to first step [s]", "median", "lowest", "highest"), rows)
