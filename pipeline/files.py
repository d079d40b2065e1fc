"""Files that are whole or not there, and what is written into them."""

from __future__ import annotations

import json
import os
import platform
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.runtime.files import replacing, target_of, write_whole


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary name (``runtime.files.replacing``) for a file whose folder is made if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        yield partial


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file in one go, into a folder that is made if it is missing, and wait until it is on the disk.

    Raises:
        OSError: naming the file, when the disk is full or does not take it, or it is no regular file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one go (``write_bytes``)."""
    write_bytes(path, (json.dumps(content, indent=2) + "\n").encode())


LOCK = ".lock"
"""Name of the file in a folder that only one process writes into at a time."""


@contextmanager
def sole_writer(folder: Path) -> Iterator[bool]:
    """Be the only process, and the only call in it, that writes into a folder, which is made if it is missing.

    The lock is the system's, on the file ``.lock``: a process that is killed does not hold it any longer.

    Yields:
        Whether that is certain: not every system and file system has such locks.

    Raises:
        OSError: another one is writing, or the folder is a file, or cannot be written into.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder} is a file; it must be a folder, or not there yet")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    try:
        import fcntl
    except ImportError:
        yield False
        return
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                    break
            os.close(descriptor)  # of a file that its owner removed in this very moment
        except BlockingIOError as error:
            owner = os.read(descriptor, 200).decode(errors="replace").strip()
            os.close(descriptor)
            raise OSError(
                f"{folder}: {owner or 'another process'} is writing into it; wait, or take another"
            ) from error
        except OSError:  # no locks here
            os.close(descriptor)
            yield False
            return
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {platform.node()}".encode())
        yield True
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def check_writable(folder: Path, *names: str) -> None:
    """Raise ``OSError`` unless a folder takes files, these among them; nothing is made, also where it is missing.

    For commands that compute before they write.

    Raises:
        OSError: naming the folder or the file.
    """
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise OSError(error.errno, f"{folder} cannot be written into: {error.strerror or error}") from error
    for name in names:
        target_of(folder / name)


def versions() -> dict[str, str]:
    """Return the versions of Python, of this project and of the libraries that compute, by name."""
    found = {"python": platform.python_version()}
    for name in ("deep-contact", "warp-lang", "numpy", "h5py"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def plain(value: Any) -> Any:
    """Return nested dicts and lists with Python's own numbers, for JSON."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
