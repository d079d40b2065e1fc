"""Files that are whole or not there, and what is written into them."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary name in the folder of ``path``, renamed to it when the block ends, removed when it raises."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a whole file in one go, and wait until it is on the disk.

    Raises:
        OSError: naming the file, when the disk is full or does not take it.
    """
    try:
        with atomic_path(path) as partial, open(partial, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        text = f"{path} was not written: {error.strerror or error}; what was there before is whole"
        raise OSError(error.errno, text) from error


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one go (``atomic_path``)."""
    with atomic_path(path) as partial:
        partial.write_text(json.dumps(content, indent=2) + "\n")


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
