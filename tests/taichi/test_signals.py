"""Signals are seen in memory while a block runs, and go on to whom they are for; nothing is left of it afterwards."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from dc_kernels._taichi.runtime.signals import ASKED, LISTENING, NUMBERS, PATIENCE, SWEPT, WORDS, signals_in


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Python's own handler of Ctrl-C, which the background of a shell has not, and a harmless one of another signal.

    Nobody listens, whatever a loop of asyncio before may have left.
    """
    listened = signal.set_wakeup_fd(-1)
    numbers = (signal.SIGINT, signal.SIGUSR1)
    before = [signal.signal(n, handler) for n, handler in zip(numbers, (signal.default_int_handler, lambda *_: None))]
    yield
    for number, handler in zip(numbers, before):
        signal.signal(number, handler)
    with contextlib.suppress(OSError, ValueError):  # it may be closed
        signal.set_wakeup_fd(listened)


def numbers_in(words: np.ndarray, count: int) -> list[int]:
    """The numbers that have come, once there are so many; the thread that brings them needs a moment."""
    found = words[NUMBERS:].view(np.uint8)
    ends = time.monotonic() + 60.0
    while np.count_nonzero(found) < 1 + count and time.monotonic() < ends:
        time.sleep(1e-3)
    assert found[0] == LISTENING
    return found[1 : np.count_nonzero(found)].tolist()


def test_numbers_of_signals_come_in_order_and_the_interrupt_is_raised() -> None:
    words, threads = np.zeros(WORDS, np.int32), threading.active_count()
    seen = []
    with pytest.raises(KeyboardInterrupt), signals_in(words, 7):
        assert words[PATIENCE] == 7 and numbers_in(words, 0) == []
        os.kill(os.getpid(), signal.SIGUSR1)
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60.0)
        except KeyboardInterrupt:
            seen = numbers_in(words, 2)
            raise
    assert seen == [signal.SIGUSR1, signal.SIGINT]
    assert not words.any() and threading.active_count() == threads
    assert signal.set_wakeup_fd(-1) == -1


def test_work_that_lost_patience_leaves_the_flag() -> None:
    words = np.zeros(WORDS, np.int32)
    for swept in (7, 8):
        with signals_in(words, 7):
            words[SWEPT] = swept
        assert words.nonzero()[0].tolist() == ([ASKED] if swept > 7 else [])


def test_who_listened_before_gets_what_came() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.setblocking(False)
        signal.set_wakeup_fd(theirs.fileno())
        try:
            words = np.zeros(WORDS, np.int32)
            with signals_in(words, 7):
                os.kill(os.getpid(), signal.SIGUSR1)
                assert numbers_in(words, 1) == [signal.SIGUSR1]
            assert ours.recv(9) == bytes([signal.SIGUSR1])
            os.kill(os.getpid(), signal.SIGUSR1)
            assert ours.recv(9) == bytes([signal.SIGUSR1])
        finally:
            assert signal.set_wakeup_fd(-1) == theirs.fileno()


def test_a_process_forked_meanwhile_holds_nothing_up() -> None:
    """It has a copy of the descriptor that signals are written to, so that closing ours alone ends nobody's wait."""
    words, threads = np.zeros(WORDS, np.int32), threading.active_count()
    with signals_in(words, 7):
        theirs = signal.set_wakeup_fd(-1)
        copy = os.dup(theirs)
        signal.set_wakeup_fd(theirs)
    os.close(copy)
    assert threading.active_count() == threads


def test_nothing_is_done_for_another_handler_and_in_another_thread() -> None:
    words = np.zeros(WORDS, np.int32)

    def look() -> None:
        with signals_in(words, 7):
            found.append(words.any())

    found: list[bool] = []
    other = threading.Thread(target=look)
    other.start()
    other.join()
    signal.signal(signal.SIGINT, lambda *_: None)
    look()
    assert found == [False, False]
