"""Signals as numbers in memory, where work that holds the interpreter's lock can see them.

Python's handler of a signal runs between two of its instructions, and so never while compiled work holds the lock. What
C does at once is to write the signal's number to a descriptor (``signal.set_wakeup_fd``), here one end of a pair of
sockets. At the other a thread waits in the C library, without the lock, for more bytes than will come, and the library
puts each that comes into the memory that the work looks at.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np

from dc_kernels.runtime.threads import in_main_thread, uninterrupted

# what each word of an int32 array is for, which kernels look at after each sweep
ASKED = 0
"""Not 0: all sweeping ends."""
SWEPT = 1
"""Rows swept since an interrupt was seen."""
PATIENCE = 2
"""Rows that may be swept from then on."""
NUMBERS = 4
"""From here on a byte for each signal, its number; the first is ``LISTENING``, and 0 where nobody listens."""
WORDS = 64
LISTENING = 0xFF
POLL = 2e-5  # between two looks whether the thread listens [s]


@contextlib.contextmanager
def signals_in(words: np.ndarray, patience: int) -> Iterator[None]:
    """Have the numbers of signals in ``words`` while the block runs.

    Nothing is done outside of the main thread, which alone gets signals; nor where Ctrl-C has another handler than
    Python's own, which may not raise, so that nothing must end early; nor where the system lacks what it takes.

    Args:
        words: ``WORDS`` int32, zero from ``SWEPT`` on.
        patience: rows that may be swept after an interrupt.
    """
    if not in_main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    listener = None
    try:
        with uninterrupted():
            listener = _Listener.start(words, patience)
        yield
    finally:
        with uninterrupted():
            if listener is not None:
                listener.stop()


class _Listener:
    """A thread that waits for signals' numbers."""

    def __init__(self, words: np.ndarray, patience: int) -> None:
        self.words = words
        self.bytes = words[NUMBERS:].view(np.uint8)
        self.ours, self.theirs = socket.socketpair()
        self.ours.setblocking(True)
        self.theirs.setblocking(False)
        receive = ctypes.CDLL(None).recv
        receive.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        where = (self.ours.fileno(), self.bytes.ctypes.data, self.bytes.size, socket.MSG_WAITALL)

        def listen() -> None:
            # a signal that came to this thread would end its wait
            signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
            receive(*where)

        self.thread = threading.Thread(target=listen, name="dc_kernels signals", daemon=True)
        words[PATIENCE] = patience

    @classmethod
    def start(cls, words: np.ndarray, patience: int) -> _Listener | None:
        """Listen; None where that cannot be."""
        if os.name != "posix":
            return None
        try:
            made = cls(words, patience)
            made.thread.start()
        except (OSError, RuntimeError):  # too many files or threads
            return None
        made.theirs.send(bytes([LISTENING]))
        # the thread must get as far as there before the lock is held for long; it may also have failed to
        while made.bytes[0] != LISTENING and made.thread.is_alive():
            time.sleep(POLL)
        made.before = signal.set_wakeup_fd(made.theirs.fileno(), warn_on_full_buffer=False)
        return made

    def stop(self) -> None:
        """Listen no more; who listened before gets what came."""
        signal.set_wakeup_fd(self.before)
        with contextlib.suppress(OSError):
            self.theirs.shutdown(socket.SHUT_RDWR)  # a process forked meanwhile holds it open, and the wait goes on
        self.theirs.close()
        self.thread.join()
        self.ours.close()
        came = self.bytes[1 : self.bytes.tobytes().index(0, 1)].tobytes() if not self.bytes.all() else b""
        if came and self.before >= 0:
            with contextlib.suppress(OSError):
                os.write(self.before, came)
        if self.words[SWEPT] > self.words[PATIENCE]:
            self.words[ASKED] = 1
        self.words[SWEPT:] = 0
