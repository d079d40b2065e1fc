"""Ctrl-C from outside, for work that may hold the interpreter's lock."""

import contextlib
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

DELAY = 0.1
TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100
# what a process has worked in ticks of the system: a busy machine may not let it begin for longer than any delay
SEND = """
worked() { read -r line < /proc/PID/stat && set -- ${line##*) } && worked=$((${12} + ${13})); }
worked && end=$((worked + TICKS)) && while worked && [ $worked -lt $end ]; do sleep 0.005; done || sleep DELAY
echo $worked
kill -NAME PID
"""


@contextlib.contextmanager
def sent(name: str = "INT") -> Iterator[list[float]]:
    """Let another process signal this one when it has worked on the block for a moment.

    Yields what holds, after the block, how long this process had worked before it was signalled [s].
    """
    given = {"PID": os.getpid(), "TICKS": round(DELAY * TICKS), "DELAY": DELAY, "NAME": name}
    script = SEND
    for word, value in given.items():
        script = script.replace(word, str(value))
    worked: list[float] = []
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(["sh", "-c", script], text=True, **pipe) as sender:
        try:
            yield worked
        except KeyboardInterrupt:
            text = sender.stdout.read().strip()
            worked.append(int(text) / TICKS if text else time.process_time())
            raise
        finally:
            sender.kill()  # where the block has ended by itself


@contextlib.contextmanager
def interrupted(within: float = 1.0) -> Iterator[None]:
    """Interrupt the block, which must end by KeyboardInterrupt within that many seconds of work [s].

    It has to go on until then: ``work_on`` at its end makes it do so.
    """
    # tests in the background of a shell would ignore Ctrl-C
    before, hook = signal.signal(signal.SIGINT, signal.default_int_handler), sys.unraisablehook
    collects = gc.isenabled()
    gc.disable()  # what other tests have left is not deleted here

    def again(ignored: Any) -> None:
        """Python ignores an interrupt that falls into ``__del__``."""
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
        else:
            hook(ignored)

    sys.unraisablehook = again
    try:
        with pytest.raises(KeyboardInterrupt), sent() as worked:
            yield
        # several threads may have worked meanwhile; how much time passed says nothing on a busy machine
        assert time.process_time() - worked[0] < within
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, before)
        if collects:
            gc.enable()


def work_on(seconds: float = 10.0) -> None:
    """Work for so long that an interrupt comes late, if it has not come before [s]."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
