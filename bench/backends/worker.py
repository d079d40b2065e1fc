"""One engine in a process of its own: ``python -m bench.backends.worker ENGINE FOLDER`` does what lines of JSON say.

``{"do": "prepare", "case": 3}`` makes a job and calls it once, which compiles; ``{"do": "time"}`` times it. Each is
answered by a line. So engines take turns, and two compilers that cannot live in one process are measured in one run.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.backends.jobs import CASES, Job, make

ROOT = Path(__file__).resolve().parents[2]
VARIABLE = "DEEP_CONTACT_TAICHI"


class Worker:
    """The process of an engine, as the bench sees it; what goes wrong there is the reason of an empty cell."""

    def __init__(self, engine: str, folder: Path) -> None:
        """Start it; it keeps results below a folder."""
        environment = dict(os.environ)
        if engine in ("taichi", "quadrants"):
            environment[VARIABLE] = engine
        self.engine = engine
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.backends.worker", engine, str(folder)],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def ask(self, **order: Any) -> None:
        """Give an order; ``answer`` waits for what it answers."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it may have ended, which the answer says
            self._process.stdin.write(json.dumps(order) + "\n")
            self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Wait for the answer to the last order: what was measured, or ``error``."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        return json.loads(line) if line else {"error": f"the process ended with {self._process.wait()}"}

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        self._process.wait()


def obey(order: dict[str, Any], engine: str, folder: Path, jobs: list[Job]) -> dict[str, Any]:
    """Do what an order says; ``jobs`` holds the present one."""
    if order["do"] == "time":
        return {"seconds": jobs[0].once()}
    jobs.clear()  # its memory goes before that of the next
    begin = time.perf_counter()
    jobs.append(make(CASES[order["case"]], engine, folder))
    np.save(folder / f"{engine}_{order['case']}.npy", jobs[0].result())
    spent = time.perf_counter() - begin
    if engine != "numpy":
        jobs[0].once()
    # in KiB, but on macOS in bytes
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    return {"first_s": spent, "memory_mb": peak}


def main(engine: str, folder: Path) -> None:
    """Obey until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what others print is no answer
    jobs: list[Job] = []
    for line in sys.stdin:
        try:
            told = obey(json.loads(line), engine, folder, jobs)
        except Exception as error:  # the cell stays empty, and says why
            told = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(told), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
