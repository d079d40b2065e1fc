"""Processes of the bench: what one printed and how it ended, and children that answer one question after the other."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
MARK = "\x1e"  # begins the lines that are answers: libraries print what they like
CORES = 2


class Ended(NamedTuple):
    """How a process ended."""

    code: int | None
    """Exit code, negative for a signal; None: it was killed when its time was up."""
    output: str
    """What it printed."""
    error: str
    """What it printed on the error stream."""


def environment(**changed: str) -> dict[str, str]:
    """Variables of a child that imports this checkout from any folder."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **changed}


def run(arguments: Sequence[str], seconds: float, **variables: str) -> Ended:
    """Run Python with arguments in a process of its own, at the root of this checkout; its children end with it."""
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=environment(**variables),
        start_new_session=True,
    )
    try:
        output, error = process.communicate(timeout=seconds)
        code: int | None = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, error = process.communicate()
        code = None
    return Ended(code, output, error)


class Child:
    """A process that answers JSON by JSON; it is started anew when it has crashed or hung."""

    def __init__(self, module: str, seconds: float) -> None:
        """Choose what answers.

        Args:
            module: started with ``python -m``; it calls ``answer``.
            seconds: time for an answer, after which it counts as hung.
        """
        self.command, self.seconds = [sys.executable, "-m", module], seconds
        self._process: subprocess.Popen[str] | None = None

    def ask(self, question: Any) -> Any:
        """Its answer, or "crashed" or "hung"."""
        if self._process is None:
            self._process = subprocess.Popen(
                self.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                cwd=ROOT,
                env=environment(),
            )
            if self._read(120.0) != "ready":
                self.close()
                raise RuntimeError(f"{' '.join(self.command)} did not start")
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(question) + "\n")
            self._process.stdin.flush()
        found = self._read(self.seconds)
        if found in ("crashed", "hung"):
            self.close()
        return found

    def _read(self, seconds: float) -> Any:
        assert self._process is not None and self._process.stdout is not None
        process, late = self._process, threading.Event()

        def kill() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(seconds, kill)
        timer.start()
        try:
            for line in self._process.stdout:
                if line.startswith(MARK):
                    return json.loads(line[1:])
        finally:
            timer.cancel()
        return "hung" if late.is_set() else "crashed"

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def answer(reply: Callable[[Any], Any]) -> None:
    """Answer the questions of the process that started this one, until it ends."""
    print(MARK + json.dumps("ready"), flush=True)
    for line in sys.stdin:
        print(MARK + json.dumps(reply(json.loads(line))), flush=True)


def ask_all(module: str, questions: Iterable[Any], seconds: float, done: Callable[[], Any]) -> list[tuple[Any, Any]]:
    """Ask as many children as there are cores; questions and answers, in any order.

    Args:
        module: see ``Child``.
        questions: what to ask.
        seconds: see ``Child``.
        done: called after each answer.
    """
    left, found, lock = iter(questions), [], threading.Lock()

    def work(_: int) -> None:
        child = Child(module, seconds)
        try:
            while True:
                with lock:
                    question = next(left, None)
                if question is None:
                    return
                reply = child.ask(question)
                with lock:
                    found.append((question, reply))
                    done()
        finally:
            child.close()

    with ThreadPoolExecutor(CORES) as pool:
        list(pool.map(work, range(CORES)))
    return found


def thinned(items: Sequence[Any], most: int) -> list[Any]:
    """At most so many items, evenly spread."""
    step = max(len(items) / most, 1.0)
    return [items[int(i * step)] for i in range(min(most, len(items)))]
