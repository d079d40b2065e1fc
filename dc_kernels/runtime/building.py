"""Making kernels, one thread at a time: starting Warp, defining, hashing, compiling and loading.

Warp does none of this safely on several threads. All of it happens here, under one re-entrant lock, which what is made
already never takes. A fork waits until no other thread makes a kernel, so that the child finds none half made.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

BLOCK = 16
"""Threads of a block on a GPU. Most kernels run a thread a world, which waits for memory: 4096 worlds of 100 discs in
blocks of 256 take twice as long, on 16 of an H200's 132 processors; with 4 to 16 they differ by a third at most [1]."""

_lock = threading.RLock()
_loaded: set[tuple[Any, str]] = set()  # kernels and devices
_started = False

os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release)


@contextlib.contextmanager
def building() -> Iterator[None]:
    """Hold the lock under which kernels are made; Warp is started when it is entered.

    Raises:
        OSError: naming the folder and ``WARP_CACHE_PATH``, when compiled kernels cannot be written.
    """
    with _lock:
        if not _started:
            _start()
        yield


def start_warp() -> None:
    """Start Warp, if it is not: its first arrays and kernels need that.

    Raises:
        OSError: see ``building``.
    """
    if not _started:
        with building():
            pass


def block_size(device: str) -> int:
    """Threads of a block; on the CPU a block is one."""
    return 1 if device == "cpu" else BLOCK


def load(kernel: Any, device: str) -> None:
    """Compile and load the module of a Warp kernel, with a line on the error stream while that takes long.

    Raises:
        OSError: see ``building``.
    """
    if (kernel, device) in _loaded:
        return
    import warp as wp

    with building(), _writable_cache(), _quiet() as shown:
        if shown:
            _progress(f"loading kernels: {kernel.module.name.removeprefix('dc_kernels.')}")
        try:
            # the variant that a launch takes
            kernel.module.load(wp.get_device(device), block_size(device))
        finally:
            if shown:
                _progress("")
        _loaded.add((kernel, device))


def _start() -> None:
    global _started
    import warp as wp

    cache = wp.config.kernel_cache_dir
    try:
        with _writable_cache(), _quiet():
            wp.init()
    except OSError:
        wp.config.kernel_cache_dir = cache  # where Warp puts a folder of its version into at each try
        raise
    _started = True


@contextlib.contextmanager
def _quiet() -> Iterator[bool]:
    """Keep Warp's lines for information off the output; whether to show progress in their place."""
    import warp as wp

    level = wp.config.log_level
    if level != wp.LOG_INFO:
        yield False
        return
    wp.config.log_level = wp.LOG_WARNING
    try:
        yield sys.stderr is not None and sys.stderr.isatty()
    finally:
        wp.config.log_level = level


def _progress(text: str) -> None:
    """Write over the one line of progress on the terminal."""
    sys.stderr.write(f"\r\x1b[K{text}")
    sys.stderr.flush()


@contextlib.contextmanager
def _writable_cache() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        import warp as wp

        folder = wp.config.kernel_cache_dir or error.filename
        raise OSError(
            f"Warp cannot write its compiled kernels to {folder} ({error}); "
            "set the environment variable WARP_CACHE_PATH to a folder that can be written"
        ) from error
