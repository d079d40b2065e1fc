"""Ctrl-C from outside, for work that may hold the interpreter's lock."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator

import pytest

DELAY = 0.1


@contextlib.contextmanager
def sent(name: str = "INT") -> Iterator[None]:
    """Let another process signal this one while the block is at work."""
    sender = subprocess.Popen(["sh", "-c", f"sleep {DELAY}; kill -{name} {os.getpid()}"])
    try:
        yield
    finally:
        sender.wait()


@contextlib.contextmanager
def interrupted(within: float = 1.0) -> Iterator[None]:
    """Interrupt the block, which must end by KeyboardInterrupt within that many seconds of work [s]."""
    # tests in the background of a shell would ignore Ctrl-C
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        begun, worked = time.perf_counter(), time.process_time()
        with sent(), pytest.raises(KeyboardInterrupt):
            yield
        # on a busy machine the process itself works for less time than passes, with several threads for more
        assert min(time.perf_counter() - begun - DELAY, time.process_time() - worked) < within
    finally:
        signal.signal(signal.SIGINT, before)
