"""Work of several threads: one pool that all calls share, worlds divided among them.

The thread that calls works too, so a task never waits for another one, and a call ends whatever else the pool does.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import statistics
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

import numpy as np

from dc_kernels.runtime.capture import recording

Given = TypeVar("Given")
Result = TypeVar("Result")
_pool: ThreadPoolExecutor | None = None
_room = 0  # threads that the pool may have
_making = threading.Lock()

SLICE = 1e8  # units of work that take 0.1 to 0.3 s together
LOOK = 0.2
"""Longest that a thread waits for another without a look whether it was interrupted [s]: a real signal ends a wait, but
``_thread.interrupt_main``, and Ctrl-C under Windows, only set a flag, which a thread that waits for good never sees."""
FIRST_TRIES, TRIES = 3, 3
"""Times that each of two ways is tried at most in the first trial, and in later ones."""
SURE_TRIES = 2
"""Tries of each after which a trial ends where all of one way were faster than all of the other."""
LEAST_TAKES, MOST_TAKES = 96, 1024
"""Takes of the chosen way between two trials, the more the more often it has won in a row."""
CLEARLY = 0.97
"""Of the time of the other: a change of ways that gains less is not made."""
GPU_CALLS = threading.RLock()
"""What calls that work on a GPU hold: Warp copies from there on another stream, which it makes current for all threads,
so that of two at once one may leave it so."""


class OneCaller:
    """What the calls of an object hold that serves one thread at a time: a second thread gets an error and never waits.

    Calls of the thread that holds it may nest. ``begin`` and ``end`` are what ``with`` does, without its cost.
    """

    def __init__(self, what: str, then: Any = None) -> None:
        """Make it free.

        Args:
            what: the object, as the error names it.
            then: a lock that is waited for, once no other thread holds this one.
        """
        self.what, self._then = what, then
        self._lock = threading.RLock()
        self.end: Callable[[], None] = self._lock.release if then is None else self._release_both

    def begin(self) -> None:
        """Take it.

        Raises:
            RuntimeError: at once, while a call of another thread holds it.
        """
        if not self._lock.acquire(False):
            raise RuntimeError(
                f"{self.what} is at work in a call of another thread, and nothing of this call was done: let its calls "
                "follow each other, by a lock around them, or give each thread an object of its own"
            )
        if self._then is not None:
            try:
                self._then.acquire()
            except BaseException:
                self._lock.release()
                raise

    def _release_both(self) -> None:
        self._then.release()
        self._lock.release()

    def __enter__(self) -> None:
        self.begin()

    def __exit__(self, *_: object) -> None:
        self.end()


def in_main_thread() -> bool:
    """Tell whether the caller runs on the one thread that Python interrupts."""
    return threading.get_ident() == threading.main_thread().ident


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold back an interrupt (Ctrl-C, SIGINT) until the block has ended: for work that must not be left half done."""
    handler = signal.getsignal(signal.SIGINT)
    if not in_main_thread() or not callable(handler):
        yield  # Python interrupts the main thread alone, and only by a handler of its own
        return
    held: list[tuple[Any, Any]] = []
    signal.signal(signal.SIGINT, lambda *what: held.append(what))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if held:
            handler(*held[0])


def thread_pool(threads: int) -> ThreadPoolExecutor:
    """The pool that all calls share, with room for so many threads at once."""
    global _pool, _room
    with _making:
        if _pool is None or _room < threads:
            _room = max(threads, os.cpu_count() or 1)
            # threads of a smaller one end with its last task
            _pool = ThreadPoolExecutor(_room, thread_name_prefix="dc_kernels")
        return _pool


def _forget_pool() -> None:
    """A forked child has none of its parent's threads."""
    global _pool, _making
    _pool, _making = None, threading.Lock()


os.register_at_fork(after_in_child=_forget_pool)


def run_together(work: Callable[[], Any], threads: int, stop: Callable[[], Any] | None = None) -> None:
    """Call ``work`` on so many threads at once, one of them the present one, and wait for all.

    Args:
        work: what each does.
        threads: how many.
        stop: called when the present thread is interrupted while it waits; it makes the others end soon.

    Raises:
        BaseException: the first that a call raises, after all have ended.
    """
    others: list[Future[Any]] = []
    try:
        others = [thread_pool(threads - 1).submit(work) for _ in range(threads - 1)]
        work()
    finally:
        # what has not begun finds nothing left to do; a cancelled task is not waited for, as it only counts as done
        # when a thread takes it up, and all may be waiting here
        begun = [other for other in others if not other.cancel()]
        try:
            while wait(begun, LOOK).not_done:
                pass
        except BaseException:
            if stop is not None:
                stop()
            wait(begun)  # none is left at work when the caller goes on
            raise
    for other in begun:
        other.result()


def run_helped(work: Callable[[], Any], help_out: Callable[[], Any], helpers: int, end: Callable[[], Any]) -> None:
    """Call ``work`` on the present thread while free ones call ``help_out``; it never waits for one to begin.

    Args:
        work: what is done, also if nobody helps.
        help_out: what a helper does, which ends soon after ``end``, and in the end even without.
        helpers: at most so many.
        end: tells helpers to leave.

    Raises:
        BaseException: what ``work`` raises.
    """
    others: list[Future[Any]] = []
    try:
        with contextlib.suppress(RuntimeError):  # no more threads, or an interpreter that ends: nobody helps
            for _ in range(helpers):
                others.append(thread_pool(helpers).submit(help_out))
        work()
    finally:
        end()
        begun = [other for other in others if not other.cancel()]
        try:
            wait(begun)
        except BaseException:
            wait(begun)  # none is left at work when the caller goes on
            raise


def usable_cores() -> int:
    """Count the cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Trial:
    """A choice between two ways to one result, the usual and another, by which is the faster here and now.

    In a trial both ways are tried in turn, so that work which grows or shrinks meanwhile counts for both, and their
    medians are compared, so that what else the machine does now and then counts for neither. A try is two takes, of
    which the first is not counted: it finds the caches as the other way has left them. A trial costs the difference of
    ``2 * TRIES`` takes in ``LEAST_TAKES`` at most.

    Attributes:
        other: whether the other way is to be taken next.
    """

    def __init__(self) -> None:
        """Begin with a trial, the other way first."""
        self.other = self._chosen = True
        self._spent: tuple[list[float], list[float]] = (
            [],
            [],
        )  # in the trial under way, in the usual way and the other
        self._left = 4 * FIRST_TRIES  # takes of the trial, or of the chosen way before the next one
        self._wait = LEAST_TAKES
        self._trying = True

    def took(self, seconds: float) -> None:
        """Count a take of the way that ``other`` says, and choose the next."""
        self._left -= 1
        if self._trying:
            if self._left % 2 == 1:
                return
            self._spent[self.other].append(seconds)
            if self._left and not self._is_sure():
                self.other = not self.other
                return
            self._choose()
        elif self._left == 0:
            self._spent = ([], [])
            self._trying, self._left, self.other = True, 4 * TRIES, not self._chosen

    def _is_sure(self) -> bool:
        one, other = self._spent
        return len(one) == len(other) >= SURE_TRIES and (max(one) < min(other) or max(other) < min(one))

    def _choose(self) -> None:
        now, instead = (statistics.median(self._spent[way]) for way in (self._chosen, not self._chosen))
        if instead < CLEARLY * now:
            self._chosen, self._wait = not self._chosen, LEAST_TAKES
        else:
            self._wait = min(2 * self._wait, MOST_TAKES)
        self._trying, self._left, self.other = False, self._wait, self._chosen


def run_apart(work: Callable[[], Any], interrupted: Callable[[threading.Event], Any]) -> None:
    """Call ``work``, which may take long without Python, on a thread of its own: an interrupt is not kept waiting.

    Args:
        work: what is done.
        interrupted: called when the present thread is interrupted, with an event that is set when ``work`` has ended.

    Raises:
        BaseException: what ``work`` raises, or the interrupt after ``interrupted`` has returned.
    """
    ended, failed, begun = threading.Event(), [], False

    def call() -> None:
        try:
            work()
        except BaseException as error:
            failed.append(error)
        finally:
            ended.set()

    try:
        with uninterrupted():
            threading.Thread(target=call, name="dc_kernels apart", daemon=True).start()
            begun = True
        while not ended.wait(LOOK):
            pass
    except BaseException:
        if begun:
            interrupted(ended)
        raise
    if failed:
        raise failed[0]


def map_threads(function: Callable[[Given], Result], items: Iterable[Given], threads: int) -> list[Result]:
    """Results of a function in the items' order, computed by so many threads; by the present one in a recording."""
    given = list(items)
    if threads == 1 or len(given) < 2 or recording():
        return [function(item) for item in given]
    results: list[Any] = [None] * len(given)
    left = iter(range(len(given)))  # next() of a range is one step of the interpreter

    def leave() -> None:
        """Let no thread begin with another item."""
        for _ in left:
            pass

    def work() -> None:
        try:
            for i in left:
                results[i] = function(given[i])
        except BaseException:
            leave()
            raise

    run_together(work, min(threads, len(given)), leave)
    return results


def slices_of(work: float) -> int:
    """Parts of so much work, in units that take some nanoseconds, between which an interrupt may arrive."""
    return int(work / SLICE) + 1


def run_shards(launches: Sequence[Callable[[], Any]], threads: int) -> None:
    """Run launches that write disjoint memory, on several threads if there are several of both."""
    map_threads(lambda launch: launch(), launches, threads)


def shard_worlds(worlds: int, threads: int) -> list[tuple[int, int]]:
    """First world and number of worlds of each thread's share."""
    edges = np.linspace(0, worlds, min(max(threads, 1), max(worlds, 1)) + 1).astype(int)
    return [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]
