"""What a command does to its own process: signals, threads, and the bars that it shows."""

from __future__ import annotations

import functools
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from dc_kernels.runtime.imports import require

PATIENCE = 0.25
"""Time that a loop has to end by itself after Ctrl-C, before what is urgent in it is interrupted [s]."""


def progress_bar(items: Iterable[Any] | None = None, *, show: bool = True, **options: Any) -> Any:
    """Make a progress bar on stderr, over ``items`` if given; ``options`` are those of tqdm.

    Raises:
        ImportError: naming the extra, without tqdm.
    """
    return require("tqdm", "pipeline").tqdm(items, disable=not show, **options)


def cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def interrupt(handler: Any, frame: FrameType | None) -> None:
    """Do what Ctrl-C does by a handler; what ignores it, as in the background of a shell, raises KeyboardInterrupt."""
    (handler if callable(handler) else signal.default_int_handler)(signal.SIGINT, frame)


class Stop:
    """Whether a first Ctrl-C asks a loop to end; ``interruptible`` makes it."""

    def __init__(self) -> None:
        """Begin without one."""
        self._asked = threading.Event()
        self._urgent = self._late = False
        self._timer: threading.Timer | None = None

    def is_set(self) -> bool:
        """Tell whether there was a Ctrl-C."""
        return self._asked.is_set()

    @contextmanager
    def urgent(self) -> Iterator[None]:
        """Let a Ctrl-C that waits for longer than ``PATIENCE`` raise KeyboardInterrupt within the block."""
        self._urgent = True
        try:
            yield
        finally:
            self._urgent = False

    def handle(self, previous: Any, number: int, frame: FrameType | None) -> None:
        """Take a signal: the first sets this, a late one interrupts what is urgent, another one does as ever."""
        if not self._asked.is_set():
            self._asked.set()
            self._timer = threading.Timer(PATIENCE, self._remind)
            self._timer.daemon = True
            self._timer.start()
            return
        late, self._late = self._late, False
        if self._urgent or not late:
            interrupt(previous, frame)

    def close(self) -> None:
        """End the wait for a late signal."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()

    def _remind(self) -> None:
        """Signal the main thread again."""
        self._late = True
        ident = threading.main_thread().ident
        if ident is not None:
            signal.pthread_kill(ident, signal.SIGINT)


@contextmanager
def interruptible() -> Iterator[Stop]:
    """Give what the first Ctrl-C sets; the second one interrupts as usual.

    Signals reach the main thread alone: in others it is never set.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    previous = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, functools.partial(stop.handle, previous))
    try:
        yield stop
    finally:
        stop.close()
        signal.signal(signal.SIGINT, previous)


class Ending:
    """How a process is asked to end.

    Attributes:
        number: of the signal that asked last; that of Ctrl-C before any.
    """

    def __init__(self) -> None:
        """Begin without a signal."""
        self.number = int(signal.SIGINT)

    @property
    def code(self) -> int:
        """Exit code of a process that a signal ends: 128 and its number, as shells have it."""
        return 128 + self.number

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Do what Ctrl-C does at this moment."""
        self.number = number
        interrupt(signal.getsignal(signal.SIGINT), frame)


@contextmanager
def terminable() -> Iterator[Ending]:
    """Let SIGTERM do what Ctrl-C does, and tell which of them it was.

    Signals reach the main thread alone: in others nothing changes.
    """
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return
    previous = signal.signal(signal.SIGTERM, ending.handle)
    try:
        yield ending
    finally:
        signal.signal(signal.SIGTERM, previous)


@contextmanager
def torch_threads(threads: int) -> Iterator[None]:
    """Let networks use as many threads as worlds do, where torch is loaded: more than are free wait for each other."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
