"""Threads and processes at once: each scenario of ``scenarios`` in processes of their own, some with an empty cache."""

from __future__ import annotations

import tempfile
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

from bench.faults.common import CORES, run

SECONDS = 90.0
COLD_SECONDS = 400.0  # with an empty kernel cache
SEEDS = 6
NAMES = (
    "first_use",
    "one_kind",
    "makers",
    "shards",
    "one_simulation",
    "comings",
    "records",
    "refused_records",
    "forks",
    "spawns",
    "interrupts",
)
QUICK = ("first_use", "one_simulation", "records", "forks", "interrupts")


class Run(NamedTuple):
    """A process."""

    name: str
    """Of the scenario."""
    seed: int
    """Of what it draws."""
    cold: bool = False
    """Whether no kernel has been compiled yet."""


def fault(given: Run) -> str | None:
    """Run one; what went wrong, or None."""
    arguments = ["-m", "bench.faults.scenarios", given.name, str(given.seed)]
    with tempfile.TemporaryDirectory() as folder:
        cache = {"WARP_CACHE_PATH": folder} if given.cold else {}
        done = run(arguments, COLD_SECONDS if given.cold else SECONDS, **cache)
    if done.code == 0 and done.output.endswith("done\n"):
        return None
    last = (done.error.strip().splitlines() or [""])[-1]
    fate = "hung" if done.code is None else f"ended with {done.code}"
    return f"{given.name}, seed {given.seed}{', empty cache' * given.cold}: {fate} {last}".strip()


def measure(quick: bool) -> dict[str, Any]:
    """Count the runs and those that failed; ``thread_faults`` says how."""
    from tqdm import tqdm

    if quick:
        runs = [Run(name, 0) for name in QUICK]
    else:
        runs = [Run("first_use", 100, cold=True), *(Run(name, seed) for seed in range(SEEDS) for name in NAMES)]
    with (
        ThreadPoolExecutor(CORES) as pool,
        tqdm(total=len(runs), unit="run", desc="threads", dynamic_ncols=True) as bar,
    ):
        faults = []
        for found in pool.map(fault, runs):
            bar.update()
            faults += [found] if found else []
    return {"thread_runs": len(runs), "thread_failures": len(faults), "thread_faults": faults}
